"""Frames as hypothesis makes them, and what counts as the same frame."""

import time
from collections.abc import Callable
from typing import Any

import can
import pytest
from can.util import CAN_FD_DLC
from hypothesis import strategies as st

from harness.can.transport import WAITING_FRAMES

IDENTIFIERS = {False: st.integers(0, (1 << 11) - 1), True: st.integers(0, (1 << 29) - 1)}
LENGTHS = {False: st.integers(0, 8), True: st.sampled_from(CAN_FD_DLC)}


@st.composite
def frames(draw: Any, fd: bool = True, esi: bool = True) -> can.Message:
    """Any frame that a bus can carry; error frames have a strategy of their own."""
    extended = draw(st.booleans())
    is_fd = fd and draw(st.booleans())
    remote = not is_fd and draw(st.booleans())
    length = draw(LENGTHS[is_fd])
    return can.Message(
        arbitration_id=draw(IDENTIFIERS[extended]),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_fd=is_fd,
        bitrate_switch=is_fd and draw(st.booleans()),
        error_state_indicator=esi and is_fd and draw(st.booleans()),
        dlc=length,
        data=None if remote else draw(st.binary(min_size=length, max_size=length)),
    )


def sample(number: int, identifier: int = 0x110) -> can.Message:
    """A frame that carries its number."""
    return can.Message(
        arbitration_id=identifier, is_extended_id=False, data=number.to_bytes(8, "little")
    )


def number(message: can.Message) -> int:
    return int.from_bytes(message.data, "little")


def same(got: can.Message | None, sent: can.Message) -> bool:
    """All that is on the wire; not time, channel and direction."""
    return got is not None and got.equals(
        sent, timestamp_delta=None, check_channel=False, check_direction=False
    )


def fill(bus: can.BusABC) -> int:
    """Send until it is refused; how many frames were taken."""
    taken = 0

    def send_on() -> None:
        nonlocal taken
        while taken < 20 * WAITING_FRAMES:
            bus.send(sample(taken))
            taken += 1

    with pytest.raises(can.CanOperationError, match=r"does not read, .* frame 0x110 is lost"):
        send_on()
    assert bus.state is can.BusState.ACTIVE
    return taken


def pump(bus: can.BusABC, condition: Callable[[], object], timeout: float = 3.0) -> None:
    """Let a bus read until something holds; nothing but commands and answers may come."""
    ending = time.monotonic() + timeout
    while not condition() and time.monotonic() < ending:
        assert bus.recv(0.01) is None
    assert condition()
