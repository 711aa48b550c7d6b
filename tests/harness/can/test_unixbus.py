"""The bus on Unix sockets: many nodes, layout on the wire, nodes that come, go and die."""

import contextlib
import select
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import can
import pytest
from can.interfaces.socketcan import socketcan
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.can.transport import bus_off_frame
from harness.can.unixbus import UnixBus
from tests.harness.can.frames import fill, frames, number, same, sample

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs Unix sockets")


@pytest.fixture
def join(tmp_path):
    """Makes nodes of one bus."""
    with contextlib.ExitStack() as stack:
        yield lambda **options: stack.enter_context(UnixBus(tmp_path / "bus", **options))


@pytest.fixture(scope="module")
def tap(tmp_path_factory):
    """A node, and a plain socket that hears it and can send it anything."""
    folder = tmp_path_factory.mktemp("tap")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as plain:
        plain.bind(str(folder / "0-plain.can"))
        plain.settimeout(1.0)
        with UnixBus(folder) as node:
            yield node, plain, node._path


def test_three_nodes_hear_the_others_and_not_themselves(join) -> None:
    nodes = [join() for _ in range(3)]
    for k, node in enumerate(nodes):
        node.send(sample(k))
    for k, node in enumerate(nodes):
        got = [node.recv(2.0) for _ in range(2)]
        assert [number(message) for message in got] == [m for m in range(3) if m != k]
        assert node.recv(0) is None


def test_all_receivers_have_the_same_time_of_a_frame(join) -> None:
    nodes = [join() for _ in range(3)]
    nodes[0].send(sample(1))
    stamps = {node.recv(2.0).timestamp for node in nodes[1:]}
    assert len(stamps) == 1


def test_a_node_may_hear_itself(join) -> None:
    one, other = join(receive_own_messages=True), join()
    one.send(sample(1))
    other.send(sample(2))
    got = [one.recv(2.0) for _ in range(2)]
    assert [(number(message), message.is_rx) for message in got] == [(1, False), (2, True)]
    assert other.recv(2.0).is_rx


def test_the_first_frame_after_a_node_has_joined_reaches_it(join) -> None:
    """Nodes come and go a hundred times; none misses a frame that is sent while it is there."""
    sender, listener = join(), join()
    for k in range(100):
        with UnixBus(sender.channel) as guest:
            sender.send(sample(k))
            assert number(guest.recv(2.0)) == k
            assert guest.recv(0) is None
        assert number(listener.recv(2.0)) == k
    assert len(list(Path(sender.channel).iterdir())) == 3  # two sockets and the mark


def test_one_node_that_stalls_does_not_hold_up_the_others(join) -> None:
    sender, stalled, reader = join(), join(), join()
    for k in range(1000):
        sender.send(sample(k))
        assert number(reader.recv(2.0)) == k
    got = []
    while len(got) < 1000 and (message := stalled.recv(2.0)) is not None:
        got.append(number(message))
        sender.recv(0)
    assert got == list(range(1000))


def test_reconnecting_gives_up_what_waits_for_a_node_that_does_not_read(join) -> None:
    sender, stalled = join(), join()
    fill(sender)
    assert sender.reconnect() is True
    sender.send(sample(1))
    assert sender.state is can.BusState.ACTIVE
    got = []
    while (message := stalled.recv(0.05)) is not None:
        got.append(number(message))
        sender.recv(0)
    assert got[-1] == 1
    assert len(got) < 100


@given(message=frames())
@settings(max_examples=150)
def test_the_layout_is_that_of_socketcan(tap, message) -> None:
    """Witness: python-can's own packing, which fills a field more (the raw dlc) and FDF."""
    node, plain, address = tap
    before = time.time_ns()
    node.send(message)
    datagram = plain.recv(200)
    (stamp,) = struct.unpack_from("=Q", datagram)
    assert before <= stamp <= time.time_ns()
    frame = bytearray(socketcan.build_can_frame(message))
    frame[7] = 0
    assert datagram[8:] == frame

    plain.sendto(datagram, address)
    got = node.recv(2.0)
    assert same(got, message)
    assert got.timestamp == pytest.approx(1e-9 * stamp, abs=1e-6)


@given(rubbish=st.binary(max_size=120))
@settings(max_examples=150)
def test_rubbish_is_counted_and_never_a_frame_that_no_bus_carries(tap, rubbish) -> None:
    node, plain, address = tap
    plain.sendto(rubbish, address)
    plain.sendto(socket_frame(sample(1)), address)
    before = node.malformed
    got = [node.recv(2.0)]
    if not same(got[0], sample(1)):
        got[0]._check()  # a frame by chance: then one that can be
        got.append(node.recv(2.0))
    assert same(got[-1], sample(1))
    assert node.malformed - before == 2 - len(got)


def socket_frame(message: can.Message) -> bytes:
    return struct.pack("=Q", time.time_ns()) + socketcan.build_can_frame(message)


@given(
    can_id=st.integers(0, 2**32 - 1),
    length=st.integers(0, 255),
    flags=st.integers(0, 255),
    size=st.sampled_from([8, 64]),
)
@settings(max_examples=300)
def test_any_header_makes_a_frame_that_can_be_or_none(tap, can_id, length, flags, size) -> None:
    node, plain, address = tap
    before = node.malformed
    plain.sendto(struct.pack("=QIBB2x", 1, can_id, length, flags) + bytes(size), address)
    got = node.recv(0)
    if got is None:
        assert node.malformed == before + 1
        return
    error = got.is_error_frame
    assert error == bool(can_id & 1 << 29)
    if error:  # python-can's check knows no error frames; they are as wide as extended ones
        got.is_extended_id = True
    got._check()
    assert got.arbitration_id == can_id & (1 << 29) - 1
    assert got.dlc == length


def test_sockets_of_dead_nodes_are_removed_and_other_files_left(join) -> None:
    node = join()
    folder = Path(node.channel)
    code = (
        "import os, sys; from harness.can.unixbus import UnixBus;"
        "bus = UnixBus(sys.argv[1]); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", code, folder], check=True)
    for name in ("notes.can", "notes.txt"):
        (folder / name).write_text("not a socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as foreign:
        foreign.bind(str(folder / "foreign.socket"))
    before = set(folder.iterdir())
    node.send(sample(1))
    gone = before - set(folder.iterdir())
    assert len(gone) == 1
    assert gone.pop().suffix == ".can"


def test_a_node_that_leaves_takes_its_waiting_frames_along(join) -> None:
    sender, listener = join(), join()
    with UnixBus(sender.channel):
        for k in range(100):
            sender.send(sample(k))
            listener.recv(2.0)
    sender.send(bus_off_frame())
    assert listener.recv(2.0).is_error_frame
    assert sender.state is can.BusState.ACTIVE


def test_a_readable_handle(join) -> None:
    sender, node = join(), join()
    assert select.select([node.fileno()], [], [], 0)[0] == []
    sender.send(sample(1))
    assert select.select([node.fileno()], [], [], 0.5)[0] == [node.fileno()]


def test_a_folder_whose_path_is_too_long(tmp_path) -> None:
    folder = tmp_path / ("long" * 30)
    with pytest.raises(can.CanInitializationError, match=r"takes 10[37]. Choose .* shorter by \d+"):
        UnixBus(folder)
    assert list(folder.iterdir()) == []


def test_the_longest_path_that_works(tmp_path, monkeypatch) -> None:
    """What the text asks for is enough."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(can.CanInitializationError) as caught:
        UnixBus("x" * 200)
    excess = int(str(caught.value).split("shorter by ")[1].split()[0])
    with UnixBus("x" * (200 - excess)) as one, UnixBus("x" * (200 - excess)) as other:
        one.send(sample(1))
        assert same(other.recv(2.0), sample(1))
    with pytest.raises(can.CanInitializationError, match="shorter by 1 bytes"):
        UnixBus("x" * (201 - excess))


def test_a_file_in_the_place_of_the_folder(tmp_path) -> None:
    (tmp_path / "bus").write_text("")
    with pytest.raises(
        can.CanInitializationError, match=r"bus: cannot make the folder: File exists"
    ):
        UnixBus(tmp_path / "bus")


def test_a_system_without_unix_sockets(tmp_path, monkeypatch) -> None:
    monkeypatch.delattr(socket, "AF_UNIX")
    with pytest.raises(can.CanInterfaceNotImplementedError, match="Use the interface 'virtual'"):
        UnixBus(tmp_path)


def test_the_state_cannot_be_set(join) -> None:
    with pytest.raises(NotImplementedError, match="it cannot be set"):
        join().state = can.BusState.PASSIVE
