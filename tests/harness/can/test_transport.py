"""What both interfaces of ours must do: python-can's rules, nothing lost, unplug and return."""

import asyncio
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.can.transport import WAITING_FRAMES, Transport, bus_off_frame, is_bus_off
from tests.harness.can.frames import fill, frames, number, pump, same, sample
from tests.waiting import wait_until

KINDS = ["unixbus", "slcanbulk"]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs Unix sockets and ptys")


def board_end(kind: str, folder: Path, **options) -> Transport:
    if kind == "slcanbulk":
        options |= {"channel": f"pty:{folder / 'tty'}", "device": True, "fd": True}
    return can.Bus(interface=kind, **{"channel": str(folder), **options})


def computer_end(kind: str, folder: Path, **options) -> Transport:
    if kind == "slcanbulk":
        options |= {"channel": str(folder / "tty"), "bitrate": 1_000_000, "fd": True}
    return can.Bus(interface=kind, **{"channel": str(folder), **options})


@contextlib.contextmanager
def ends(kind: str, folder: Path):
    """Computer and board, the channel open."""
    with board_end(kind, folder) as board, computer_end(kind, folder) as computer:
        if kind == "slcanbulk":
            pump(board, lambda: board.opened)
        yield computer, board


@pytest.fixture(scope="module", params=KINDS)
def both(request, tmp_path_factory):
    """Computer and board, for tests that leave nothing behind."""
    with ends(request.param, tmp_path_factory.mktemp(request.param)) as both:
        yield both


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    return request.param


@pytest.fixture
def pair(kind, tmp_path):
    with ends(kind, tmp_path) as pair:
        yield pair


def drain(bus: can.BusABC, timeout: float = 0.0) -> list[can.Message]:
    return list(iter(lambda: bus.recv(timeout), None))


@given(sent=st.lists(frames(esi=False), min_size=1, max_size=8), to_board=st.booleans())
@settings(max_examples=80)
def test_every_frame_arrives_as_it_was_sent_and_in_order(both, sent, to_board) -> None:
    here, there = both if to_board else both[::-1]
    for message in sent:
        here.send(message)
    for message in sent:
        got = there.recv(2.0)
        assert same(got, message), (str(got), str(message))
        assert got.is_rx
    assert there.recv(0) is None


def test_time_and_channel_of_a_message(both) -> None:
    computer, board = both
    before = time.time()
    board.send(sample(1))
    got = computer.recv(2.0)
    assert before - 1e-3 <= got.timestamp <= time.time() + 1e-3
    assert got.channel == computer.channel
    assert type(computer).__name__ in str(computer)


def test_a_filter_passes_what_matches_and_error_frames(pair) -> None:
    computer, board = pair
    computer.set_filters([{"can_id": 0x111, "can_mask": 0x7FF, "extended": False}])
    for identifier in (0x110, 0x111, 0x112, 0x111):
        board.send(sample(identifier, identifier))
    board.send(bus_off_frame())
    got = [computer.recv(2.0) for _ in range(3)]
    assert [number(message) for message in got[:2]] == [0x111, 0x111]
    assert is_bus_off(got[2])
    computer.set_filters(None)
    board.send(sample(1))
    assert same(computer.recv(2.0), sample(1))


def bytes_waiting(handle: int) -> int:
    import fcntl
    import termios

    return int.from_bytes(fcntl.ioctl(handle, termios.FIONREAD, bytes(4)), sys.byteorder)


def test_polling_does_not_end_at_a_frame_that_is_filtered_out(pair, kind) -> None:
    computer, board = pair
    computer.set_filters([{"can_id": 0x111, "can_mask": 0x7FF}])
    board.send(sample(1))
    board.send(sample(2, 0x111))
    if kind == "slcanbulk":  # a socket hands on at once, a terminal somewhat later
        size = len(board._line(sample(1)) + board._line(sample(2, 0x111)))
        handle = computer._port.handle
        wait_until(lambda: bytes_waiting(handle) >= size, what="the arrival of both frames")
    assert same(computer.recv(0), sample(2, 0x111))


@pytest.mark.parametrize("timeout", [0, 0.03, 0.12])
def test_a_wait_for_nothing_takes_as_long_as_asked(both, timeout) -> None:
    computer, _ = both
    begun = time.monotonic()
    assert computer.recv(timeout) is None
    assert timeout - 1e-3 <= time.monotonic() - begun < timeout + 1.0


def test_bus_off_is_told_apart_from_other_error_frames(pair) -> None:
    computer, board = pair
    passive = can.Message(
        arbitration_id=4,
        is_extended_id=False,
        is_error_frame=True,
        data=[0, 0x30, 0, 0, 0, 0, 129, 131],
    )
    board.send(passive)
    board.send(bus_off_frame())
    got = [computer.recv(2.0) for _ in range(2)]
    assert same(got[0], passive)
    assert same(got[1], bus_off_frame())
    assert [is_bus_off(message) for message in got] == [False, True]
    assert not is_bus_off(sample(0, 0x40))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"arbitration_id": 0x800, "is_extended_id": False}, "0x800 .* 0..0x7ff"),
        ({"arbitration_id": 1 << 29}, "0x20000000 of an extended|extended .* 0..0x1fffffff"),
        ({"arbitration_id": -1}, "must be in 0"),
        ({"data": bytes(9)}, "dlc 9 of a classic frame must be in 0..8"),
        ({"data": bytes(9), "is_fd": True}, "dlc 9 of an FD frame must be one of"),
        ({"data": bytes(3), "dlc": 4}, "dlc 4, but 3 bytes"),
        ({"bitrate_switch": True}, "need is_fd"),
        ({"is_fd": True, "is_remote_frame": True}, "no FD frame is a remote"),
        ({"is_error_frame": True, "is_remote_frame": True}, "remote and error frame at once"),
    ],
)
def test_what_no_bus_could_carry_is_refused(both, fields, text) -> None:
    computer, board = both
    with pytest.raises(ValueError, match=text):
        computer.send(can.Message(**fields))
    assert board.recv(0.01) is None
    assert computer.state is can.BusState.ACTIVE


def test_a_notifier_passes_on_all_frames(pair) -> None:
    computer, board = pair
    reader = can.BufferedReader()
    notifier = can.Notifier(computer, [reader], timeout=0.05)
    try:
        for k in range(200):
            board.send(sample(k))
        board.recv(0.1)  # meanwhile what waits in the sender leaves
        got = list(iter(lambda: reader.get_message(0.5), None))
    finally:
        notifier.stop()
    assert [number(message) for message in got] == list(range(200))


def test_a_notifier_in_an_event_loop_passes_on_all_frames(pair) -> None:
    computer, board = pair

    async def listen() -> list[int]:
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(computer, [reader], timeout=0.05, loop=asyncio.get_running_loop())
        try:
            for k in range(50):
                board.send(sample(k))
                if k % 8 == 0:  # more than the system keeps waits in the sender
                    await asyncio.sleep(1e-3)
            board.recv(0)
            async with asyncio.timeout(5):
                return [number(await reader.get_message()) for _ in range(50)]
        finally:
            notifier.stop()

    assert asyncio.run(listen()) == list(range(50))


def test_sending_in_one_thread_and_receiving_in_another(pair) -> None:
    """Periodic tasks send from threads of their own while both ends receive."""
    computer, board = pair
    task = computer.send_periodic(sample(7, 0x0A0), 1e-3)
    for k in range(300):
        board.send(sample(k))
    got, heard = [], []
    while len(got) < 300 and (message := computer.recv(2.0)) is not None:
        got.append(number(message))
        heard += drain(board)
    task.stop()
    assert got == list(range(300))
    heard += drain(board, 0.05)
    assert heard
    assert all(same(message, sample(7, 0x0A0)) for message in heard)


def test_shutdown_twice_and_use_after_it(kind, tmp_path) -> None:
    board = board_end(kind, tmp_path)
    computer = computer_end(kind, tmp_path)
    for bus in (computer, board):
        bus.shutdown()
        bus.shutdown()
        with pytest.raises(can.CanOperationError, match="is shut down; make a new bus"):
            bus.recv(0)
        with pytest.raises(can.CanOperationError, match="is shut down"):
            bus.send(sample(0))
        assert bus.reconnect() is False
        assert bus.state is can.BusState.ERROR
    assert not list(tmp_path.glob("*.can"))
    assert not (tmp_path / "tty").is_symlink()


@pytest.mark.parametrize("sender_goes_on", ["receiving", "sending"])
def test_a_reader_that_stalls_loses_nothing(pair, sender_goes_on) -> None:
    computer, board = pair
    count = 3000
    for k in range(count):
        board.send(sample(k))
    got = []
    while len(got) < count:
        if sender_goes_on == "receiving":
            assert board.recv(0) is None
        else:
            board.send(sample(count))
        message = computer.recv(2.0)
        assert message is not None, f"only {len(got)} of {count} arrived"
        got.append(number(message))
    assert got == list(range(count))


def test_what_waits_leaves_while_its_sender_only_waits_for_an_answer(pair) -> None:
    computer, board = pair
    count = 2000
    for k in range(count):
        board.send(sample(k))
    answer = threading.Thread(target=lambda: board.recv(5.0))
    answer.start()
    try:
        got = [number(computer.recv(2.0)) for _ in range(count)]
    finally:
        computer.send(sample(0))
        answer.join()
    assert got == list(range(count))


def test_shutdown_sends_what_waits(kind, tmp_path) -> None:
    """From the computer's end; a device that closes is a cable that is pulled."""
    with board_end(kind, tmp_path) as board:
        computer = computer_end(kind, tmp_path)
        board.recv(0)
        for k in range(100):
            computer.send(sample(k))
        ending = threading.Thread(target=computer.shutdown)
        ending.start()
        got = [number(board.recv(2.0)) for _ in range(100)]
        ending.join()
    assert got == list(range(100))


def test_beyond_the_bound_a_frame_is_refused_and_those_before_arrive(pair) -> None:
    computer, board = pair
    count = fill(board)
    assert count >= WAITING_FRAMES
    got = []
    while len(got) < count:
        board.recv(0)
        message = computer.recv(2.0)
        assert message is not None, f"only {len(got)} of {count} arrived"
        got.append(number(message))
    assert got == list(range(count))
    board.send(sample(count))
    assert number(computer.recv(2.0)) == count


def test_a_send_may_wait_for_room(pair) -> None:
    computer, board = pair
    count, waited = fill(board), []

    def send_all() -> None:
        while True:  # a busy system still makes room for some
            waited.append(time.monotonic())
            board.send(sample(0), timeout=0.05)

    with pytest.raises(can.CanOperationError, match="does not read"):
        send_all()
    assert time.monotonic() - waited[-1] > 0.04

    reading = threading.Timer(0.05, lambda: drain(computer, 0.1))
    reading.start()
    board.send(sample(count), timeout=5.0)
    reading.join()


def test_the_medium_goes_and_comes_back(kind, tmp_path) -> None:
    """Adapter unplugged, folder removed: an error with words, then `reconnect` until it is back."""
    folder = tmp_path / "bus"
    folder.mkdir()
    with ends(kind, folder) as (computer, board):
        board.send(sample(1))
        assert computer.recv(2.0) is not None
        assert computer.state is can.BusState.ACTIVE
        assert computer.reconnect() is True  # nothing to do

        board.unplug()
        assert board.state is can.BusState.ERROR
        with pytest.raises(can.CanOperationError, match="unplugged"):
            board.send(sample(2))
        if kind == "unixbus":
            shutil.rmtree(folder)
        for action in (lambda: computer.recv(2.0), lambda: computer.send(sample(3))):
            with pytest.raises(can.CanOperationError, match=rf"{folder}.* is gone: \w+"):
                action()
        assert computer.state is can.BusState.ERROR
        assert computer.reconnect() is False
        if kind == "unixbus":
            assert board.reconnect() is False
            folder.mkdir()
        assert board.reconnect() is True
        assert computer.reconnect() is True
        assert computer.state is can.BusState.ACTIVE
        if kind == "slcanbulk":
            pump(board, lambda: board.opened)
        for here, there in ((board, computer), (computer, board)):
            here.send(sample(4))
            assert same(there.recv(2.0), sample(4))


def test_a_wait_ends_when_the_medium_goes(kind, tmp_path) -> None:
    folder = tmp_path / "bus"
    folder.mkdir()
    with ends(kind, folder) as (computer, board):

        def go() -> None:
            board.unplug()
            if kind == "unixbus":
                shutil.rmtree(folder)

        threading.Timer(0.05, go).start()
        begun = time.monotonic()
        with pytest.raises(can.CanOperationError, match="is gone"):
            computer.recv(5.0)
        assert time.monotonic() - begun < 3.0


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts handles in /proc")
def test_no_handle_is_left_open(kind, tmp_path) -> None:
    def handles() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    before = handles()
    for _ in range(3):
        with ends(kind, tmp_path) as (computer, board):
            board.send(sample(1))
            assert same(computer.recv(2.0), sample(1))
            board.unplug()
            board.reconnect()
            if kind == "slcanbulk":
                with pytest.raises(can.CanInitializationError):
                    board_end(kind, tmp_path)
    assert handles() == before


ECHO = """
import sys
import can
interface, channel, device = sys.argv[1:]
options = {"device": True} if device == "device" else {}
with can.Bus(interface=interface, channel=channel, **options) as bus:
    print("ready", flush=True)
    while (message := bus.recv(10.0)) is not None and message.arbitration_id != 0x7FF:
        bus.send(message)
"""


@pytest.fixture
def echo(kind, tmp_path):
    """A board in a process of its own that sends back what it hears; killed at the end."""
    channel = f"pty:{tmp_path / 'tty'}" if kind == "slcanbulk" else str(tmp_path)
    role = "device" if kind == "slcanbulk" else "node"
    command = [sys.executable, "-c", ECHO, kind, channel, role]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def test_two_processes(kind, tmp_path, echo) -> None:
    count = 2000
    with computer_end(kind, tmp_path) as computer:
        got = []
        for k in range(count):
            computer.send(sample(k))
            got += iter(lambda: computer.recv(0), None)
        while len(got) < count and (message := computer.recv(2.0)) is not None:
            got.append(message)
        assert [number(message) for message in got] == list(range(count))
        computer.send(sample(0, 0x7FF))
        assert echo.wait(5) == 0


def test_a_process_that_was_killed(kind, tmp_path, echo) -> None:
    """On a wire that is an unplugged adapter; on a bus of many nodes one falls silent."""
    with computer_end(kind, tmp_path) as computer:
        computer.send(sample(1))
        assert same(computer.recv(2.0), sample(1))
        os.kill(echo.pid, signal.SIGKILL)
        echo.wait()
        if kind == "unixbus":
            assert len(list(tmp_path.glob("*.can"))) == 2
            computer.send(sample(2))
            assert computer.recv(0.05) is None
            assert len(list(tmp_path.glob("*.can"))) == 1
            board = board_end(kind, tmp_path)
        else:
            with pytest.raises(can.CanOperationError, match="is gone"):
                computer.recv(2.0)
            assert computer.reconnect() is False
            board = board_end(kind, tmp_path)  # the link left behind is no hindrance
            assert computer.reconnect() is True
        with board:
            computer.send(sample(3))
            assert same(board.recv(2.0), sample(3))
