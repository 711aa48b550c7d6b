"""slcan: lines against a grammar of their own, damaged input, the device, python-can's slcan."""

import contextlib
import os
import re
import select
import socket
import sys
import threading
import time
from itertools import pairwise

import can
import pytest
from can.interfaces.slcan import slcanBus
from can.util import CAN_FD_DLC
from hypothesis import example, given, settings
from hypothesis import strategies as st

from harness.can.slcanbulk import BITRATES, LineStatus, Pty, SlcanBulkBus
from tests.harness.can.frames import frames, number, pump, same, sample
from tests.waiting import wait_until

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs ptys")

LINES = {
    "t1230": can.Message(arbitration_id=0x123, is_extended_id=False),
    "t7FF3A1b2C3": can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\xa1\xb2\xc3"),
    "T1FFFFFFF100": can.Message(arbitration_id=0x1FFFFFFF, data=b"\0"),
    "r0018": can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True, dlc=8),
    "R000000010": can.Message(arbitration_id=1, is_remote_frame=True, dlc=0),
    "d0019" + 12 * "0F": can.Message(
        arbitration_id=1, is_extended_id=False, is_fd=True, data=12 * b"\x0f"
    ),
    "B00000002F" + 64 * "55": can.Message(
        arbitration_id=2, is_fd=True, bitrate_switch=True, data=64 * b"\x55"
    ),
}


class Feed:
    """A port that gives what it was given, in pieces, and remembers what was written."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.written = b""
        self.first = 0.0
        self.waited = 0.0

    def read(self) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""

    def write(self, data: bytes) -> int:
        self.written += data
        self.first = self.first or time.monotonic()
        return len(data)

    def wait(self, seconds: float, to_write: bool) -> None:
        self.waited += seconds
        time.sleep(seconds)

    def close(self) -> None:
        pass


class Fed(SlcanBulkBus):
    """A bus on a `Feed`."""

    def _open_port(self) -> Feed:
        return Feed()

    def take(self, *pieces: bytes) -> list[can.Message]:
        self._port.pieces += pieces
        got = []
        while self._port.pieces or self._frames:
            got += [message for message in [self.recv(0)] if message is not None]
        return got


@pytest.fixture
def fed():
    with contextlib.ExitStack() as stack:
        yield lambda **options: stack.enter_context(Fed("feed", **options))


@pytest.fixture(scope="module")
def classic():
    with Fed("feed") as bus:
        yield bus


@pytest.fixture(scope="module")
def flexible():
    with Fed("feed", fd=True) as bus:
        yield bus


@pytest.fixture
def pair(tmp_path):
    """Computer and device over a pty, the channel open."""
    link = tmp_path / "tty"
    with SlcanBulkBus(f"pty:{link}") as device, SlcanBulkBus(str(link)) as computer:
        pump(device, lambda: device.opened)
        yield computer, device


def cut(data: bytes, places: list[int]) -> list[bytes]:
    """Pieces as a serial port may give them."""
    edges = sorted({0, len(data), *(place % (len(data) + 1) for place in places)})
    return [data[a:b] for a, b in pairwise(edges)]


def clean(bus: SlcanBulkBus) -> None:
    """End what an example before may have left unfinished; count anew."""
    bus.take(b"\r")
    bus.malformed = bus.refused = 0


PLACES = st.lists(st.integers(0, 2000), max_size=6)


@pytest.mark.parametrize("line", LINES)
def test_lines_by_the_manual(flexible, line) -> None:
    clean(flexible)
    (got,) = flexible.take(line.encode() + b"\r")
    assert same(got, LINES[line])
    flexible._port.written = b""
    flexible.send(LINES[line])
    assert (
        flexible._port.written == line.upper().replace(line[0].upper(), line[0], 1).encode() + b"\r"
    )


@given(sent=st.lists(frames(esi=False), min_size=1, max_size=6), places=PLACES)
@settings(max_examples=150)
def test_lines_survive_any_way_of_being_read(flexible, sent, places) -> None:
    clean(flexible)
    data = b"".join(flexible._line(message) for message in sent)
    got = flexible.take(*cut(data, places))
    assert len(got) == len(sent)
    assert all(same(a, b) for a, b in zip(got, sent, strict=True))
    assert flexible.malformed == 0


def by_the_grammar(piece: str, fd: bool) -> can.Message | None:
    """Witness: the format as regular expressions, read digit by digit."""
    found = re.fullmatch(
        r"([tr])([0-7][0-9a-f]{2})([0-8])((?:[0-9a-f]{2})*)"
        r"|([TR])([01][0-9a-f]{7})([0-8])((?:[0-9a-f]{2})*)"
        r"|([db])([0-7][0-9a-f]{2})([0-9a-f])((?:[0-9a-f]{2})*)"
        r"|([DB])([01][0-9a-f]{7})([0-9a-f])((?:[0-9a-f]{2})*)",
        piece[:1] + piece[1:].lower(),
    )
    if found is None:
        return None
    letter, identifier, code, data = (field for field in found.groups() if field is not None)
    is_fd, remote = letter in "dDbB", letter in "rR"
    length = CAN_FD_DLC[int(code, 16)]
    if len(data) // 2 != (0 if remote else length) or (is_fd and not fd):
        return None
    return can.Message(
        arbitration_id=int(identifier, 16),
        is_extended_id=letter.isupper(),
        is_remote_frame=remote,
        is_fd=is_fd,
        bitrate_switch=letter in "bB",
        dlc=length,
        data=None if remote else bytes(int(data[k : k + 2], 16) for k in range(0, len(data), 2)),
    )


ANSWERS = re.compile(rb"|z|Z|s[abwp]\d{6}")


@st.composite
def damaged(draw, fd):
    """Good lines, then bytes lost, changed, put in between; or anything at all."""
    sent = draw(st.lists(frames(fd=fd, esi=False), max_size=5))
    with Fed("feed", fd=True) as writer:
        data = bytearray(b"".join(writer._line(message) for message in sent))
    for _ in range(draw(st.integers(0, 5))):
        place = draw(st.integers(0, len(data)))
        kind = draw(st.sampled_from(["lose", "change", "insert"]))
        if kind == "lose":
            del data[place : place + draw(st.integers(1, 40))]
        elif kind == "insert":
            data[place:place] = draw(
                st.one_of(
                    st.binary(min_size=1, max_size=8),
                    st.sampled_from(
                        [b"\r", b"\a", b"\n", b" ", b"t", b"_", b"0x", b"d1230\r", b"F00\r"]
                    ),
                )
            )
        elif place < len(data):
            data[place] = draw(st.integers(0, 255))
    return bytes(data)


def check_against_the_grammar(bus: Fed, data: bytes, places: list[int]) -> None:
    clean(bus)
    got = [m for m in bus.take(*cut(data + b"\r", places)) if not m.is_error_frame]
    pieces = (data + b"\r").replace(b"\a", b"\a\r").split(b"\r")[:-1]
    wanted = [by_the_grammar(piece.decode("latin-1"), bus._fd) for piece in pieces]
    frames_wanted = [message for message in wanted if message is not None]
    assert len(got) == len(frames_wanted)
    assert all(same(a, b) for a, b in zip(got, frames_wanted, strict=True))
    bad = sum(
        message is None and not ANSWERS.fullmatch(piece) and piece != b"\a"
        for message, piece in zip(wanted, pieces, strict=True)
    )
    assert bus.malformed == bad
    assert bus.refused == data.count(b"\a")


@given(data=damaged(fd=False), places=PLACES)
@example(data=b"t11_2AABB", places=[])
@example(data=b"t 111AA\rt+111AA\rt0x111A", places=[])
@example(data=b"t1112A B\rt1111 A\rt1111A\n", places=[])
@example(data=b"t8001AA\rT20000000100\rt1109AABBCCDDEEFF001122", places=[])
@example(data=b"d1230\rF00\rr1101AA\rt111", places=[])
@settings(max_examples=200)
def test_damaged_classic_input(classic, data, places) -> None:
    """A frame for each line that is one by the grammar, and none else; never an exception."""
    check_against_the_grammar(classic, data, places)


@given(data=damaged(fd=True), places=PLACES)
@settings(max_examples=200)
def test_damaged_flexible_input(flexible, data, places) -> None:
    check_against_the_grammar(flexible, data, places)


@given(data=st.binary(max_size=300), places=PLACES)
@settings(max_examples=150)
def test_any_bytes(flexible, data, places) -> None:
    check_against_the_grammar(flexible, data, places)


@given(
    sent=st.lists(frames(fd=False), min_size=1, max_size=6),
    which=st.integers(0, 5),
    at=st.integers(1, 40),
    end=st.sampled_from(["head", "tail", "line end"]),
)
@settings(max_examples=200)
def test_a_cut_line_is_lost_and_never_another_frame(classic, sent, which, at, end) -> None:
    """Head or tail of a line missing, or its line end: the other frames arrive, and only they."""
    clean(classic)
    lines = [classic._line(message) for message in sent]
    which %= len(lines)
    at = 1 + at % (len(lines[which]) - 1)
    rest = [message for k, message in enumerate(sent) if k != which]
    if end == "head":
        lines[which] = lines[which][at:]
    elif end == "tail":
        lines[which] = lines[which][: len(lines[which]) - 1 - at] + b"\r"
    else:
        lines[which] = lines[which][:-1]
        rest = [message for k, message in enumerate(sent) if k not in (which, which + 1)]
        if which == len(lines) - 1:  # its end comes later, then it is whole
            rest.append(sent[which])
    got = classic.take(b"".join(lines) + b"\r")
    assert len(got) == len(rest)
    assert all(same(a, b) for a, b in zip(got, rest, strict=True))


def test_a_line_without_end_takes_no_memory_and_is_dropped(fed) -> None:
    bus = fed()
    for _ in range(100):
        assert bus.take(b"t110" + 5000 * b"A") == []
        assert len(bus._incomplete) < 200
    assert bus.malformed == 0
    assert [number(message) for message in bus.take(b"\r", bus._line(sample(5)))] == [5]
    assert bus.malformed == 1


@pytest.mark.parametrize("timeout", [0, 0.02])
def test_a_flood_that_no_filter_passes_ends_with_the_timeout(fed, timeout) -> None:
    """A node babbles faster than anybody can read."""
    bus = fed(can_filters=[{"can_id": 0x111, "can_mask": 0x7FF}])
    bus._port.read = lambda: 10 * bus._line(sample(1))
    stop = threading.Timer(5.0, setattr, (bus._port, "read", lambda: b""))
    stop.start()
    begun = time.monotonic()
    assert bus.recv(timeout) is None
    assert time.monotonic() - begun >= timeout
    assert not stop.finished.is_set(), "it ended with the flood, not before it"
    stop.cancel()


def test_a_device_that_refuses(fed) -> None:
    bus = fed()
    assert bus.take(b"\r\r\a", bus._line(sample(1)) + b"\az\r" + bus._line(sample(2)))[1:] != []
    assert (bus.refused, bus.malformed) == (2, 0)


def test_status_is_taken_only_when_it_was_asked_for(pair) -> None:
    computer, device = pair
    device._write(b"F08\r")
    pump(computer, lambda: computer.malformed == 1)
    assert computer.status == LineStatus(0)
    device.status = LineStatus.ERROR_PASSIVE | LineStatus.BUS_ERROR
    computer.ask_status()
    computer.ask_version()
    for _ in range(100):
        device.recv(0.01)
        computer.recv(0.01)
        if computer.version is not None:
            break
    assert computer.version == "1013"
    assert computer.status is LineStatus.ERROR_PASSIVE | LineStatus.BUS_ERROR
    assert computer.malformed == 1
    device._write(b"F00\rV2000\r")
    pump(computer, lambda: computer.malformed == 3)
    assert computer.version == "1013"
    assert computer.status is LineStatus.ERROR_PASSIVE | LineStatus.BUS_ERROR


@pytest.mark.parametrize(
    ("options", "commands"),
    [
        ({}, "C O"),
        ({"bitrate": 1_000_000}, "C S8 O"),
        ({"bitrate": 800_000, "listen_only": True}, "C S7 L"),
        ({"btr": "001C", "timestamps": True}, "C s001C Z1 O"),
        ({"bitrate": 500_000, "data_bitrate": 5_000_000, "fd": True}, "C S6 Y5 O"),
    ],
)
def test_opening_and_closing_commands(options, commands) -> None:
    bus = Fed("feed", **options)
    assert bus._port.written == commands.replace(" ", "\r").encode() + b"\r"
    assert bus.state is (can.BusState.PASSIVE if "listen_only" in options else can.BusState.ACTIVE)
    assert (bus.protocol is can.CanProtocol.CAN_FD) == ("fd" in options)
    bus._port.written = b""
    bus.shutdown()
    assert bus._port.written == b"C\r"


def test_a_device_that_needs_time_holds_up_nobody(fed) -> None:
    begun = time.monotonic()
    bus = fed(sleep_after_open=1.0)
    bus.send(sample(1))
    bus.send(sample(2))
    assert bus.recv(0) is None
    assert bus._port.waited == 0.0
    assert bus._port.written == b""
    assert bus.recv(1.1) is None
    assert bus._port.written == b"C\rO\r" + bus._line(sample(1)) + bus._line(sample(2))
    assert bus._port.first - begun >= 1.0


def test_all_bit_rates_are_known(fed) -> None:
    assert {fed(bitrate=rate)._port.written for rate in BITRATES} == {
        b"C\rS%d\rO\r" % code for code in range(9)
    }


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"bitrate": 123}, "bitrate 123 must be one of 10000, 20000"),
        ({"data_bitrate": 1}, "data_bitrate 1 must be one of 2000000, 5000000 bit/s"),
        ({"btr": "xyz"}, "btr 'xyz' must be four hexadecimal digits"),
        ({"bitrate": 10_000, "btr": "001C"}, "exclude each other"),
    ],
)
def test_settings_that_cannot_be(options, text) -> None:
    with pytest.raises(ValueError, match=text):
        Fed("feed", **options)


def test_frames_that_cannot_go_out(fed) -> None:
    with pytest.raises(ValueError, match="make the bus with fd=True"):
        fed().send(can.Message(is_fd=True))
    with pytest.raises(ValueError, match="only a device"):
        fed().send(can.Message(is_error_frame=True, arbitration_id=0x40))
    with pytest.raises(ValueError, match="0x1: slcan can tell bus-off"):
        fed(device=True).send(can.Message(is_error_frame=True, arbitration_id=1))


def stamped(message: can.Message, bus: SlcanBulkBus, milliseconds: int) -> bytes:
    return bus._line(message)[:-1] + b"%04X\r" % (milliseconds % 60_000)


def test_stamps_of_the_device(fed, monkeypatch) -> None:
    """Its clock goes on over each minute, also when nothing came for several of them."""
    bus = fed(timestamps=True)
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    device, first = 59_990, None
    for passed in (0.0, 0.003, 0.02, 30.0, 45.0, 59.999, 60.0, 200.5, 0.001):
        now += passed + 1e-3 * (-1) ** int(1e3 * passed)  # a reader's delay varies
        device += round(1e3 * passed)
        (got,) = bus.take(stamped(sample(1), bus, device))
        first = first or got.timestamp
        assert got.timestamp - first == pytest.approx(1e-3 * (device - 59_990), abs=1e-6)
    assert bus.take(bus._line(sample(1)), stamped(sample(1), bus, 0)[:-5] + b"EA60\r") == []
    assert bus.malformed == 2
    without = fed()
    assert without.take(stamped(sample(1), bus, 1)) == []
    assert without.malformed == 1


def test_stamps_between_device_and_computer(tmp_path) -> None:
    link = tmp_path / "tty"
    with (
        SlcanBulkBus(f"pty:{link}") as device,
        SlcanBulkBus(str(link), timestamps=True) as computer,
    ):
        pump(device, lambda: device.opened)
        got = []
        for k in range(5):
            device.send(sample(k))
            time.sleep(0.01)
            got.append(computer.recv(2.0))
        spans = [b.timestamp - a.timestamp for a, b in pairwise(got)]
        assert all(0.009 <= span < 0.5 for span in spans)
        computer.send(sample(9))
        assert same(device.recv(2.0), sample(9))  # a computer stamps nothing
    assert computer.malformed == device.malformed == 0


def test_a_device_is_heard_only_while_its_channel_is_open(tmp_path) -> None:
    link = tmp_path / "tty"
    with SlcanBulkBus(f"pty:{link}") as device:
        device.send(sample(1))
        assert (device.opened, device.unheard) == (False, 1)
        for k in range(2):
            with SlcanBulkBus(str(link)) as computer:
                pump(device, lambda: device.opened)
                device.send(sample(k))
                assert number(computer.recv(2.0)) == k
                assert computer.refused == 0
            pump(device, lambda: not device.opened)
        device.send(sample(3))
        assert device.unheard == 2
        listener = SlcanBulkBus(str(link), listen_only=True)
        pump(device, lambda: device.opened)
        listener.send(sample(4))
        assert device.recv(0.2) is None
        pump(listener, lambda: listener.refused == 1)
        assert device.malformed == 0
        listener.unplug()  # without a word to the device
        pump(device, lambda: not device.opened)
        device.send(sample(5))
        assert (device.opened, device.unheard) == (False, 3)


def test_the_device_refuses_what_it_does_not_know(fed) -> None:
    device = fed(device=True)
    frame = device._line(sample(1))
    steps = [
        (frame, b"\a", 0),  # closed
        (b"hello\r", b"\a", 1),
        (b"S6\rO\r", b"\r\r", 1),
        (b"O\rS6\rZ1\r", b"\a\a\a", 1),  # open already
        (b"\r", b"", 1),
        (b"N\rF\r", b"N0001\rF00\r", 1),
        (b"t11\r", b"\a", 2),
    ]
    for data, answer, malformed in steps:
        device._port.written = b""
        assert device.take(data) == []
        assert (device._port.written, device.malformed) == (answer, malformed), data
    assert [number(message) for message in device.take(frame)] == [1]


@pytest.fixture
def other(tmp_path):
    """python-can's own slcan at the other end of a pty that a device of ours has made."""
    link = tmp_path / "tty"
    with SlcanBulkBus(f"pty:{link}", fd=True) as device:
        opening = threading.Thread(target=pump, args=(device, lambda: device.opened))
        opening.start()
        theirs = slcanBus(str(link), bitrate=1_000_000, sleep_after_open=0)
        opening.join()
        assert device.opened
        yield device, theirs
        theirs.shutdown()


def test_against_the_slcan_of_python_can(other) -> None:
    device, theirs = other

    @given(message=frames(esi=False), to_device=st.booleans())
    @settings(max_examples=60)
    def check(message, to_device) -> None:
        here, there = (theirs, device) if to_device else (device, theirs)
        here.send(message)
        assert same(there.recv(2.0), message)

    check()
    assert device.malformed == 0


def test_a_stream_to_the_slcan_of_python_can_and_back(other) -> None:
    device, theirs = other
    for k in range(50):
        device.send(sample(k))
        theirs.send(sample(k))
    assert [number(theirs.recv(2.0)) for _ in range(50)] == list(range(50))
    assert [number(device.recv(2.0)) for _ in range(50)] == list(range(50))


def test_a_port_without_a_handle() -> None:
    """As on Windows; loop:// of pyserial sends all back, our own commands, too."""
    with SlcanBulkBus("loop://", bitrate=1_000_000) as bus:
        for k in range(20):
            bus.send(sample(k))
        assert [number(bus.recv(2.0)) for _ in range(20)] == list(range(20))
        assert bus.malformed == 3  # C, S8, O
        begun = time.monotonic()
        assert bus.recv(0.05) is None
        assert 0.04 < time.monotonic() - begun < 1.0
        with pytest.raises(NotImplementedError):
            bus.fileno()


def test_slcan_over_a_socket_of_the_loopback() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = SlcanBulkBus(f"socket://127.0.0.1:{server.getsockname()[1]}")
        device, _ = server.accept()
        with device:
            assert device.recv(100) == b"C\rO\r"
            device.sendall(bus._line(sample(7)))
            assert same(bus.recv(2.0), sample(7))
        with pytest.raises(can.CanOperationError, match=r"socket://.* is gone: the other end"):
            bus.recv(2.0)
        bus.shutdown()


def test_ports_that_cannot_be_opened(tmp_path, pair) -> None:
    computer, device = pair
    with pytest.raises(
        can.CanInitializationError, match=r"nothing.*cannot be opened.*No such file"
    ):
        SlcanBulkBus(str(tmp_path / "nothing"))
    with pytest.raises(can.CanInitializationError, match="another program uses it"):
        SlcanBulkBus(computer.channel)
    with pytest.raises(can.CanInitializationError, match=r"another device uses .*tty\. End it"):
        SlcanBulkBus(device.channel)
    (tmp_path / "file").write_text("precious")
    with pytest.raises(can.CanInitializationError, match=r"file is no link to a pty\. Remove it"):
        SlcanBulkBus(f"pty:{tmp_path / 'file'}", device=True)
    with pytest.raises(can.CanInitializationError, match=r"cannot be opened: No such file"):
        SlcanBulkBus(f"pty:{tmp_path / 'no' / 'folder'}", device=True)
    assert (tmp_path / "file").read_text() == "precious"
    device.send(sample(1))
    assert same(computer.recv(2.0), sample(1))


@pytest.mark.parametrize("place", ["tcgetattr", "tcflush"])
def test_unplugged_while_it_is_opened(pair, monkeypatch, place) -> None:
    import termios

    computer, device = pair
    computer.unplug()

    def fail(*arguments) -> None:
        raise termios.error(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(termios, place, fail)
        assert computer.reconnect() is False
        with pytest.raises(can.CanInitializationError, match=r"tty cannot be opened: "):
            SlcanBulkBus(computer.channel)
    assert computer.reconnect() is True
    pump(device, lambda: device.opened)
    device.send(sample(1))
    assert same(computer.recv(2.0), sample(1))


def test_a_system_without_ptys(tmp_path, monkeypatch) -> None:
    monkeypatch.delattr(os, "openpty")
    with pytest.raises(can.CanInterfaceNotImplementedError, match=r"tty: this system has no ptys"):
        SlcanBulkBus(f"pty:{tmp_path / 'tty'}")


def test_a_pty_passes_bytes_as_they_are(tmp_path) -> None:
    """No echo, no line ends changed; a reader that stalls makes a short write, not a wait."""
    pty = Pty(tmp_path / "tty")
    slave = os.open(tmp_path / "tty", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        every = bytes(range(256))
        assert os.write(slave, every) == 256
        assert pty.write(every) == 256
        pty.wait(0.5, False)
        assert pty.read() == every
        got = b""

        def all_came() -> bool:
            nonlocal got
            if select.select([slave], [], [], 0)[0]:
                got += os.read(slave, 1000)
            return len(got) >= len(every)

        wait_until(all_came, what="all bytes")
        assert got == every
        total = 0
        while (taken := pty.write(1000 * b"x")) > 0:
            total += taken
        assert 1000 < total < 1_000_000
    finally:
        os.close(slave)
        pty.close()
    assert list(tmp_path.iterdir()) == []
