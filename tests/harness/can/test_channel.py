"""Troubles of a bus are states, not exceptions."""

import can
import pytest

from harness.can import channel as media
from harness.can.channel import TRIES, Address, CanChannel, ChannelState
from harness.can.database import load
from harness.can.transport import bus_off_frame
from harness.common.errors import FaultError

DATABASE = load("instrument")


class Clock:
    """Stands in for the time of the machine [us]."""

    def __init__(self) -> None:
        self.time = 10_000_000

    def __call__(self) -> int:
        return self.time


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(media, "now", clock)
    monkeypatch.setattr(media.time, "sleep", lambda seconds: None)
    return clock


@pytest.fixture
def pair(clock, request):
    """A channel and a bus at the other end of it."""
    name = request.node.name
    channel = CanChannel(Address("virtual", name, reconnect_timeout=1.0), DATABASE)
    other = can.Bus(interface="virtual", channel=name)
    yield channel, other
    other.shutdown()
    channel.close()


def bus_off(other) -> None:
    other.send(bus_off_frame())


def test_frames_come_and_go(pair) -> None:
    channel, other = pair
    other.send(can.Message(arbitration_id=0x110, is_extended_id=False, data=b"abc"))
    message = channel.receive(0.1)
    assert (message.arbitration_id, bytes(message.data)) == (0x110, b"abc")
    assert channel.receive(0.0) is None
    channel.send(0xA0, bytes(8), False)
    assert other.recv(0.1).arbitration_id == 0xA0


def test_a_stamp_by_another_clock_is_replaced_by_the_arrival(pair, clock) -> None:
    channel, other = pair
    other.send(can.Message(arbitration_id=1, is_extended_id=False))
    assert channel.receive(0.1).timestamp == clock.time


def test_off_the_bus_it_is_silent_for_a_tenth_of_a_second_and_begins_anew(pair, clock) -> None:
    channel, other = pair
    bus_off(other)
    assert channel.receive(0.1) is None
    assert channel.state is ChannelState.BUS_OFF
    assert channel.send(0xA0, bytes(8), False) is None
    clock.time += 99_000
    assert channel.receive(0.0) is None
    assert channel.state is ChannelState.BUS_OFF
    clock.time += 1_000
    channel.receive(0.0)
    assert channel.state is ChannelState.OPEN


def test_three_restarts_in_vain_are_a_failure(pair, clock) -> None:
    channel, other = pair
    for _ in range(TRIES):
        bus_off(other)
        channel.receive(0.1)
        assert channel.state is ChannelState.BUS_OFF
        clock.time += 100_000
        channel.receive(0.0)
        assert channel.state is ChannelState.OPEN
        other.shutdown()
        other = can.Bus(interface="virtual", channel=channel._address.channel)
    bus_off(other)
    channel.receive(0.1)
    other.shutdown()
    assert channel.state is ChannelState.FAILED
    assert "after 3 restarts without a whole sample" in channel.reason


def test_a_sample_in_between_makes_the_tries_count_anew(pair, clock) -> None:
    channel, other = pair
    for _ in range(2 * TRIES):
        bus_off(other)
        channel.receive(0.1)
        clock.time += 100_000
        channel.receive(0.0)
        channel.recovered()
        assert channel.state is ChannelState.OPEN
        other.shutdown()
        other = can.Bus(interface="virtual", channel=channel._address.channel)
    other.shutdown()


def test_a_channel_that_fails_is_tried_again_until_its_reconnect_timeout(
    pair, clock, monkeypatch
) -> None:
    channel, _ = pair

    def fails(*_: object, **__: object) -> None:
        raise can.CanOperationError("unplugged")

    monkeypatch.setattr(channel._bus, "recv", fails)
    monkeypatch.setattr(channel, "_open", fails)
    assert channel.receive(0.0) is None
    assert channel.state is ChannelState.UNPLUGGED
    assert "unplugged" in channel.reason
    for _ in range(12):
        clock.time += 100_000
        channel.receive(0.0)
    assert channel.state is ChannelState.FAILED
    assert "did not come back within 1 s" in channel.reason


def test_one_that_comes_back_is_open_again(pair, clock, monkeypatch) -> None:
    channel, _ = pair

    def fails(*_: object) -> None:
        raise can.CanOperationError("unplugged")

    monkeypatch.setattr(channel._bus, "send", fails)
    assert channel.send(0xA0, bytes(8), False) is None
    assert channel.state is ChannelState.UNPLUGGED
    clock.time += 100_000
    channel.receive(0.0)
    assert channel.state is ChannelState.OPEN


def test_one_that_does_not_open_says_what_was_tried() -> None:
    with pytest.raises(FaultError) as raised:
        CanChannel(Address("slcanbulk", "/dev/no-such-tty"), DATABASE)
    assert "slcanbulk, channel /dev/no-such-tty" in str(raised.value)


def test_an_interface_that_python_can_does_not_know() -> None:
    with pytest.raises(FaultError, match="slkan"):
        CanChannel(Address("slkan", "x"), DATABASE)
