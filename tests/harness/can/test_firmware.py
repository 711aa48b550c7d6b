"""The board as a C program, seen from the host's end of its terminal.

The witnesses are cantools for the layout of frames and crccheck for their protection.
"""

import ctypes
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

if not sys.platform.startswith("linux"):
    pytest.skip("the board as a C program needs Linux", allow_module_level=True)

import tty

import cantools
from crccheck.crc import Crc8Base, Crc16CcittFalse
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiler import compile_c
from harness.can.channel import Address
from harness.can.controller_node import ControllerNode
from harness.can.database import load
from harness.can.fault_injection import KINDS
from harness.can.firmware import sources
from harness.can.firmware.build import build_board
from harness.can.firmware.process import CHANNELS, FirmwareBoard, fault_kinds, write_samples
from harness.can.protection import CheckStatus
from harness.can.protection import Counter as Sequencer
from harness.can.voltage_ramp import VoltageRamp
from harness.scenario.schema import Hil

DBCS = ("instrument", "instrument_fd")
STATES = {"stopped": 4, "operational": 5, "pre-operational": 127}
OFF, HOLD, RUN = range(3)
COMMAND, FEEDBACK, STATUS, HEARTBEAT, LOOP = 0x0A0, 0x120, 0x310, 0x701, 0x702
SAMPLES = 300
VERSION = "V1010"
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
STRICT = ("-Werror", "-fsanitize=undefined", "-fsanitize-trap=undefined")
"""Warnings are errors, and undefined behaviour ends the program."""


class Crc8E2E(Crc8Base):
    _poly = 0x1D
    _initvalue = 0
    _xor_output = 0


@cache
def database(dbc: str) -> cantools.database.Database:
    import harness.can

    return cantools.database.load_file(Path(harness.can.__file__).parent / f"dbc/{dbc}.dbc")


def protected(dbc: str, identifier: int, data: bytes) -> bytes:
    """The frame with the CRC that belongs to it, by crccheck."""
    which = identifier.to_bytes(2, "little")
    if identifier in (HEARTBEAT, LOOP):
        return data
    if dbc == "instrument":
        return bytes([Crc8E2E.calc(which + data[1:])]) + data[1:]
    return Crc16CcittFalse.calc(data[2:] + which).to_bytes(2, "little") + data[2:]


def encoded(dbc: str, identifier: int, **values: float) -> bytes:
    """A frame by cantools, with its protection."""
    message = database(dbc).get_message_by_frame_id(identifier)
    zeros = {signal.name: 0 for signal in message.signals}
    # A raw 0xFFFF is out of the range, but not of the field.
    raw = message.encode(zeros | values, strict=False)
    return protected(dbc, identifier, raw)


def command(dbc: str, counter: int, mode: int, *volts: float) -> bytes:
    values = {f"volts_{i + 1}": v for i, v in enumerate(volts)}
    return encoded(dbc, COMMAND, counter=counter, mode=mode, **values)


@dataclass(frozen=True)
class Frame:
    """As it came: 11-bit identifier, data, and whether it is one of CAN FD."""

    id: int
    data: bytes
    fd: bool = False

    @property
    def line(self) -> str:
        letter = "b" if self.fd else "t"
        return f"{letter}{self.id:03X}{LENGTHS.index(len(self.data)):X}{self.data.hex().upper()}\r"


STOPPED = Frame(HEARTBEAT, bytes([STATES["stopped"]]))


class Host:
    """The host's end of the terminal.

    Attributes:
        frames: that have come.
        times: of the reads that brought them [s].
        answers: all other lines; a BEL is a line.
        stamps: of the frames [ms], where they have such.
    """

    def __init__(self, link: Path, *, speak: bool = True, stamped: bool = False) -> None:
        self.fd = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd)
        self.frames: list[Frame] = []
        self.times: list[float] = []
        self.answers: list[str] = []
        self.stamps: list[int] = []
        self._stamped = stamped
        self._incomplete = ""
        self.is_beating = True
        self._beat = 0.0
        if speak:
            self.write("C\rS8\rZ1\rO\r" if stamped else "C\rS8\rO\r")

    def write(self, text: str) -> None:
        left = text.encode()
        while left:
            try:
                left = left[os.write(self.fd, left) :]
            except BlockingIOError:
                select.select([self.fd], [self.fd], [], 0.1)
                self.read()

    def beat(self, state: str = "operational") -> None:
        self.write(f"t7021{STATES[state]:02X}\r")

    def read(self) -> int:
        """Take what is there; the number of new frames."""
        try:
            text = os.read(self.fd, 1 << 16).decode("ascii")
        except BlockingIOError:
            return 0
        if not text:
            raise ConnectionError("the terminal has no other end any more")
        *lines, self._incomplete = (self._incomplete + text.replace("\a", "\a\r")).split("\r")
        before, now = len(self.frames), time.monotonic()
        for line in lines:
            found = re.fullmatch(r"([tb])([0-9A-F]{3})([0-9A-F])((?:[0-9A-F]{2})*)", line)
            if not found:
                self.answers.append(line)
                continue
            letter, identifier, code, data = found.groups()
            if self._stamped:
                self.stamps.append(int(data[-4:], 16))
                data = data[:-4]
            frame = Frame(int(identifier, 16), bytes.fromhex(data), letter == "b")
            assert len(frame.data) == LENGTHS[int(code, 16)], line
            self.frames.append(frame)
            self.times.append(now)
        return len(self.frames) - before

    def pump(self, seconds: float = np.inf, until: Callable[[], bool] = lambda: False) -> None:
        """Read, with a heartbeat each 100 ms, for some time or until something is true."""
        limit = 20.0
        end = time.monotonic() + min(seconds, limit)
        while not until() and (now := time.monotonic()) < end:
            if self.is_beating and now - self._beat >= 0.1:
                self.beat()
                self._beat = now
            if select.select([self.fd], [], [], min(0.02, end - now))[0]:
                self.read()
        assert seconds <= limit or until(), "what is waited for does not come"

    def ask(self, text: str) -> list[str]:
        """All answers to some lines: up to that to another line behind them, for the version."""
        self.answers.clear()
        self.write(text + "V\r")
        end = time.monotonic() + 2.0
        while self.answers[-1:] != [VERSION] or len(self.answers) < 2:
            assert time.monotonic() < end, f"no answer to {text!r} but {self.answers}"
            select.select([self.fd], [], [], 0.01)
            self.read()
        return self.answers[:-1]

    @property
    def has_stopped(self) -> bool:
        return STOPPED in self.frames[-4:]

    def close(self) -> None:
        os.close(self.fd)


@pytest.fixture(scope="module")
def volts() -> np.ndarray:
    """(samples, 9) whole counts all over the range of the converter, no two samples alike [V]."""
    return np.random.default_rng(7).integers(0, 65535, (SAMPLES, 9)) * (5.0 / 65535)


@pytest.fixture(scope="module")
def recording(volts, tmp_path_factory) -> Path:
    n = np.arange(SAMPLES)
    path = tmp_path_factory.mktemp("board") / "samples.csv"
    return write_samples(path, volts, temperature=-20.0 + 0.3 * n, field_new=n % 10 == 0)


def sample_frames(dbc: str, k: int, volts: Sequence[float]) -> list[Frame]:
    """The frames of sample k as they should be."""
    named = {f"volts_{name}": v for name, v in zip(CHANNELS, volts, strict=True)}
    new = float(k % 10 == 0)
    if dbc == "instrument_fd":
        extra = {"field_new": new, "sample": k, "board_time": k * 1e-3}
        return [Frame(0x110, encoded(dbc, 0x110, counter=k % 256, **named, **extra), True)]
    names = list(named)
    parts = [{n: named[n] for n in names[i : i + 3]} for i in (0, 3, 6)]
    parts[2]["field_new"] = new
    return [
        Frame(0x110 + i, encoded(dbc, 0x110 + i, counter=k % 15, **part))
        for i, part in enumerate(parts)
    ]


def clean_frames(dbc: str, volts: np.ndarray) -> list[list[Frame]]:
    """What a healthy board without commands sends with each sample."""
    fd = dbc == "instrument_fd"
    modulus = 256 if fd else 15
    found = []
    for k, row in enumerate(volts):
        frames = sample_frames(dbc, k, row)
        if k % 100 == 0:
            values = {"sample": k, "temperature": -20.0 + 0.3 * k}
            data = encoded(dbc, STATUS, counter=k // 100 % modulus, **values)
            frames.insert(0, Frame(STATUS, data, fd))
        if k % 10 == 0:
            frames.append(Frame(FEEDBACK, encoded(dbc, FEEDBACK, counter=k // 10 % modulus), fd))
        if k % 100 == 0:
            frames.append(Frame(HEARTBEAT, bytes([STATES["operational"]])))
        found.append(frames)
    return found


def played(
    recording: Path, faults: Sequence[str], seeds: Sequence[int] = (1,), dbc: str = "instrument"
) -> list[list[Frame]]:
    """Frames of whole recordings, from sample 0 until the board says that it has stopped."""
    boards = [FirmwareBoard(recording, dbc, faults=faults, seed=seed) for seed in seeds]
    try:
        for board in boards:
            board.start()
        hosts = [Host(board.link) for board in boards]
        for host in hosts:
            host.pump(until=lambda host=host: len(host.frames) > 1)  # it runs; all run at once
        for host in hosts:
            host.pump(until=lambda host=host: host.has_stopped)
            host.close()
    finally:
        for board in boards:
            board.stop()
            board.check()
    return [while_sampling(host.frames) for host in hosts]


def while_sampling(frames: list[Frame]) -> list[Frame]:
    """From sample 0 to the last one, without the heartbeats before and after."""
    end = len(frames)
    while frames[end - 1] == STOPPED:
        end -= 1
    return frames[[frame.id for frame in frames].index(STATUS) : end]


# --- Building -------------------------------------------------------------------------------


@pytest.mark.parametrize("dbc", DBCS)
def test_compiles_without_a_warning_and_only_once(dbc) -> None:
    program = build_board(dbc, STRICT)
    built = program.stat().st_mtime_ns
    assert build_board(dbc, STRICT) == program
    assert program.stat().st_mtime_ns == built
    assert (program.parent / "bus.h").is_file()
    assert program.is_relative_to(Path("build/c/board").resolve())
    assert sources.__wrapped__(dbc) == sources(dbc), "generated code depends on the time"


def test_a_warning_would_be_an_error() -> None:
    with pytest.raises(SteadytipError, match=r"(?s)refused the board.*board\.[ch]"):
        build_board("instrument", ["-Werror", "-Wunused-macros", "-DBOARD_CHANNELS=8"])


def test_a_bus_without_the_boards_messages_is_refused(tmp_path) -> None:
    path = tmp_path / "other.dbc"
    path.write_text('VERSION ""\n\nBU_: A\n\nBO_ 5 PiezoCommand: 8 A\n\n')
    with pytest.raises(SteadytipError, match=r"other\.dbc: 5 problems"):
        build_board(str(path))
    with pytest.raises(SteadytipError, match=r"no DBC file is called 'nowhere'"):
        build_board("nowhere")


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_portable_part_compiles_for_a_microcontroller(dbc, tmp_path) -> None:
    """No operating system, no heap: the sources that a firmware takes, for a Cortex-M4."""
    texts = {n: t for n, t in sources(dbc).items() if not n.startswith(("host", "faults"))}
    arguments = ["-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4", "-std=c99", "-Os"]
    units = {n: t for n, t in texts.items() if n in ("board.c", "bus.c", "slcan.c")}
    # The C library's headers come with one; these few words are all that is needed of it.
    texts["string.h"] = (
        "#include <stddef.h>\nvoid *memset(void *, int, size_t);\nsize_t strlen(const char *);\n"
        "char *strchr(const char *, int);\nvoid *memcpy(void *, const void *, size_t);\n"
    )
    texts["math.h"] = "double round(double);\n"
    for name in units:
        flags = [*arguments, "-I.", "-c", name, "-o", "unit.o"]
        made = compile_c(texts, flags, "unit.o").read_bytes()
        assert made[:4] == b"\x7fELF"
        assert made[18] == 40, "machine is ARM"
        for word in (b"malloc", b"printf", b"errno"):
            assert word not in made, f"{name} needs {word.decode()}"


# --- What is sent -----------------------------------------------------------------------------


@pytest.mark.parametrize("dbc", DBCS)
def test_frames_are_those_of_cantools_and_crccheck(recording, volts, dbc) -> None:
    [seen] = played(recording, [], dbc=dbc)
    expected = [frame for frames in clean_frames(dbc, volts) for frame in frames]
    assert seen == expected


def test_sampling_waits_for_the_loop_and_says_its_state(recording) -> None:
    with FirmwareBoard(recording) as board:
        host = Host(board.link)
        for state in ("pre-operational", "stopped"):
            host.beat(state)
        host.write("t70205\rt70220500\rt70221\rT00000702105\rr7021\r")  # none is a heartbeat
        time.sleep(0.25)
        host.read()
        assert {f.id for f in host.frames} == {HEARTBEAT}
        assert {f.data[0] for f in host.frames} == {STATES["pre-operational"]}
        assert 2 <= len(host.frames) <= 4
        host.pump(until=lambda: host.has_stopped)
        states = [f.data[0] for f in host.frames if f.id == HEARTBEAT]
        assert list(dict.fromkeys(states)) == [127, 5, 4]
        host.write("C\r")
        board.wait(2.0)
        host.close()
    assert not board.link.exists()
    log = board.log
    np.testing.assert_array_equal(log["sample"], np.arange(SAMPLES))
    assert board.summary["samples"] == SAMPLES
    assert board.summary["unsent"] == 0
    assert log["unknown"][-1] == 1  # the heartbeat with 29 bits
    assert log["length"][-1] == 2  # two bytes of state, and the remote frame


def test_a_signal_that_is_not_available_is_sent_so(tmp_path) -> None:
    volts = np.full((20, 9), 1.0)
    volts[3:, 4] = np.nan
    volts[5:, 0] = 5.0  # the converter at its end
    [seen] = played(write_samples(tmp_path / "nan.csv", volts), [])
    raw = {id: [f.data for f in seen if f.id == id] for id in (0x110, 0x111)}
    a3x = [int.from_bytes(data[4:6], "little") for data in raw[0x111]]
    a1x = [int.from_bytes(data[2:4], "little") for data in raw[0x110]]
    assert a3x == [13107] * 3 + [0xFFFF] * 17
    assert a1x == [13107] * 5 + [0xFFFF] * 15


def mean_period(times: Sequence[float]) -> float:
    """Over half of the samples, from each to its partner [s]: a read that is late counts little."""
    half = len(times) // 2
    return float(np.median(np.subtract(times[half : 2 * half], times[:half]))) / half


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_five_seconds_at_1_khz(volts, recording, dbc) -> None:
    """Expected: no frame lost, counters in step, mean period 1 ms within 0.1 %."""
    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        host.pump(until=lambda: any(f.id == 0x110 for f in host.frames))
        host.pump(5.0)
        host.close()
    parts = (0x110, 0x111, 0x112) if dbc == "instrument" else (0x110,)
    of_part = {i: [f.data for f in host.frames if f.id == i] for i in parts}
    modulus = 15 if dbc == "instrument" else 256
    for part in parts:
        counters = [d[1] & 15 if dbc == "instrument" else d[2] for d in of_part[part]]
        assert counters == [k % modulus for k in range(len(counters))]
    times = [t for t, f in zip(host.times, host.frames, strict=True) if f.id == 0x110]
    period = mean_period(times)
    print(f"\n{dbc}: {len(times)} samples, mean period {1e3 * period:.5f} ms")
    assert len(times) >= 4990
    assert period == pytest.approx(1e-3, rel=1e-3)
    assert board.summary["unsent"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("drift", [-8000.0, 8000.0])
def test_a_clock_that_drifts(recording, drift) -> None:
    with FirmwareBoard(recording, loop=True, drift=drift) as board:
        host = Host(board.link)
        host.pump(until=lambda: any(f.id == 0x110 for f in host.frames))
        host.pump(3.0)
        host.close()
    times = [t for t, f in zip(host.times, host.frames, strict=True) if f.id == 0x110]
    period = mean_period(times)
    assert period == pytest.approx(1e-3 / (1 + drift * 1e-6), rel=1e-3)


# --- The line -----------------------------------------------------------------------------------


@pytest.fixture
def idle(recording) -> Iterator[Host]:
    """A host whose channel is closed, so that nothing but answers comes."""
    program = build_board("instrument", STRICT)
    with FirmwareBoard(recording, log=False, program=program) as board:
        host = Host(board.link, speak=False)
        yield host
        host.close()


def test_answers_are_those_of_the_lawicel_manual(idle) -> None:
    ok, bad = "", "\a"
    talk = [
        # closed
        *[("C", bad), ("F", bad), ("t0A00", bad), ("S9", bad), ("S", bad), ("V", "V1010")],
        *[("N", "NB001"), ("S8", ok), ("s001C", ok), ("s00G0", bad), ("Y2", ok), ("Z0", ok)],
        *[("Z2", bad), ("", ok), ("Q", bad), ("OO", bad), ("O", ok)],
        # open; a beat that is not operational, so that the board stays quiet
        *[("O", bad), ("S8", bad), ("Z1", bad), ("F", "F00"), ("t70217F", "z"), ("t7FF0", "z")],
        *[("T1FFFFFFF0", "Z"), ("T200000000", bad), ("t8000", bad), ("t7FF9" + "00" * 9, bad)],
        *[("t0A01", bad), ("t0A0100FF", bad), ("t0A01XY", bad), ("r0A08", "z"), ("r0A0800", bad)],
        *[("bA00", bad), ("b0A09" + "00" * 12, "z"), ("d0A09" + "00" * 11, bad)],
        *[("D1FFFFFFFF" + "00" * 64, "Z"), ("t" * 5000, bad), ("V", "V1010"), ("C", ok)],
        ("L", ok),
        # only listening
        *[("t7FF0", bad), ("C", ok), ("C", bad)],
    ]
    for line, answer in talk:
        assert [a for a in idle.ask(f"{line}\r") if a != ok or answer == ok] == [answer], line


def test_stamps_are_the_boards_milliseconds(recording) -> None:
    with FirmwareBoard(recording, log=False) as board:
        host = Host(board.link, stamped=True)
        host.pump(until=lambda: len(host.frames) > 200)
        host.close()
    ids = [f.id for f in host.frames]
    begin = ids.index(STATUS)
    of_samples = [s for i, s in zip(ids[begin:], host.stamps[begin:], strict=True) if i == 0x112]
    assert (np.diff(of_samples) == 1).all()


def test_python_cans_own_slcan_gets_every_frame(recording, volts) -> None:
    import can

    expected = [f for frames in clean_frames("instrument", volts) for f in frames][:300]
    with FirmwareBoard(recording) as board:
        bus = can.Bus(
            interface="slcan", channel=str(board.link), bitrate=1_000_000, sleep_after_open=0
        )
        bus.send(can.Message(arbitration_id=LOOP, is_extended_id=False, data=[5]))
        seen: list[Frame] = []
        while len(seen) < 320:
            if message := bus.recv(1.0):
                seen.append(Frame(message.arbitration_id, bytes(message.data)))
        bus.shutdown()
    assert while_sampling(seen)[:300] == expected


def test_host_that_leaves_and_comes_back_finds_no_old_frames(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        first = Host(board.link)
        first.pump(0.05)
        time.sleep(0.1)  # unread frames pile up
        first.close()
        time.sleep(0.05)
        second = Host(board.link, speak=False)
        assert second.ask("V\r") == ["V1010"]
        assert second.frames == []
        second.write("O\r")
        second.pump(until=lambda: len(second.frames) > 20)
        second.close()


def test_slow_host_gets_whole_lines_and_is_told(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        host.pump(0.05)
        time.sleep(0.8)
        host.pump(0.3)
        host.write("F\r")
        host.pump(until=lambda: any(a.startswith("F") for a in host.answers))
        host.close()
    assert [a for a in host.answers if a not in ("", "z", "\a")] == ["F08"]
    assert board.summary["unsent"] > 100
    for frame in host.frames:
        assert protected("instrument", frame.id, frame.data) == frame.data


# --- The drive ------------------------------------------------------------------------------------


def drive(
    host: Host, dbc: str, wanted: Callable[[int], Sequence[float]], count: int, done: int = 0
) -> None:
    """Answer samples by commands in the mode run, up to a number; `done` are answered already."""
    answered = done
    seen = len(host.frames) if done else 0
    fd = dbc == "instrument_fd"
    modulus = 256 if fd else 15
    last = 0x110 if fd else 0x112

    def answer() -> bool:
        nonlocal seen, answered
        fresh = host.frames[seen:]
        seen = len(host.frames)
        for frame in fresh:
            if frame.id == last:
                data = command(dbc, answered % modulus, RUN, *wanted(answered))
                host.write(Frame(COMMAND, data, fd).line)
                answered += 1
        return answered >= count

    host.pump(until=answer)


@pytest.mark.parametrize("dbc", DBCS)
def test_command_of_a_sample_acts_in_the_next(recording, dbc) -> None:
    """Expected: volts of the next sample are those of the command, all three of one command."""

    def wanted(k: int) -> tuple[float, float, float]:
        return 0.002 * (k % 100), 0.002 * (k // 100), 0.2  # within a sample of rest

    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        drive(host, dbc, wanted, 250)
        host.close()
    log = board.log
    applied = np.column_stack([log[f"volts_{i}"] for i in (1, 2, 3)])[:250]
    acting = log["mode"][:250] == RUN
    of = np.rint((applied[acting, :2] / 0.002) @ [1, 100]).astype(int)  # sample of the command
    commands = np.array([wanted(k) for k in of])
    np.testing.assert_allclose(applied[acting], commands, atol=1e-9)
    late = np.flatnonzero(acting) - 1 - of
    assert late.min() >= 0, "a command acted before it was sent"
    # A host that is held up answers late, but not as a rule.
    assert np.count_nonzero(acting) > 100
    assert np.median(late) == 0
    for key in ("crc", "length", "repeated", "sequence", "range", "unknown"):
        assert log[key][-1] == 0, key
    data = [f.data for f in host.frames if f.id == FEEDBACK]
    message = database(dbc).get_message_by_frame_id(FEEDBACK)
    for j, frame in enumerate(data[: len(applied) // 10]):
        decoded = message.decode(frame, decode_choices=False)
        volts = [decoded[f"applied_{i}"] for i in (1, 2, 3)]
        np.testing.assert_allclose(volts, applied[10 * j], atol=1e-9)
        assert decoded["applied_mode"] == log["mode"][10 * j]


@pytest.mark.parametrize("dbc", DBCS)
def test_silence_takes_the_stacks_to_rest_without_a_jump(recording, dbc) -> None:
    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        drive(host, dbc, lambda k: (10.0, 5.0, 2.502), 150)
        host.pump(0.2)
        host.close()
    log = board.log
    applied = np.column_stack([log[f"volts_{i}"] for i in (1, 2, 3)])
    assert applied.max(axis=0) == pytest.approx([10.0, 5.0, 2.502])
    assert np.abs(np.diff(applied, axis=0)).max() <= 0.2 + 1e-9
    last = np.flatnonzero(log["mode"] == RUN)[-1]
    fall = applied[last] - 0.2 * np.arange(len(applied) - last)[:, None]
    np.testing.assert_allclose(applied[last:], np.maximum(fall, 0.0), atol=1e-9)
    assert len(fall) > 120
    assert log["timeout"][-1] - log["timeout"][last] == 1


def test_loop_that_stops_takes_the_stacks_to_rest_and_sampling_goes_on(recording) -> None:
    """Expected: commands do not count while the loop's node says that it has stopped."""
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        drive(host, "instrument", lambda k: (2.0, 2.0, 2.0), 50)
        host.beat("stopped")
        seen = len(host.frames)
        for k in range(50, 90):
            data = command("instrument", k % 15, RUN, 2.0, 2.0, 2.0)
            host.write(Frame(COMMAND, data).line)
            time.sleep(1e-3)
            host.read()
        host.close()
        assert sum(f.id == 0x112 for f in host.frames[seen:]) >= 35
    log = board.log
    assert log["volts_1"].max() == pytest.approx(2.0)
    assert log["volts_1"][-1] == 0
    assert log["mode"][-1] == OFF


def test_lost_heartbeat_takes_the_stacks_to_rest_in_spite_of_commands(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        drive(host, "instrument", lambda k: (0.2, 0.2, 0.2), 20)
        host.is_beating = False
        drive(host, "instrument", lambda k: (0.2, 0.2, 0.2), 450, done=20)
        host.close()
    log = board.log
    assert log["volts_1"].max() == pytest.approx(0.2)
    assert log["heartbeat"][[200, 440]].tolist() == [0, 1]
    assert log["mode"][440] == OFF
    assert log["volts_1"][440] == 0


# The board's portable part as a library, a millisecond a call.
_SHIM = """
#include "board.h"
static Board board;
__attribute__((visibility("default"))) void begin(void)
{
    Frame beat = {.id = BUS_LOOP_HEARTBEAT_FRAME_ID, .length = 1, .data = {5}};
    board_start(&board);
    board_hear(&board, &beat);
}
__attribute__((visibility("default"))) void hear(int fd, int length, const uint8_t *data)
{
    Frame f = {.id = BUS_PIEZO_COMMAND_FRAME_ID, .fd = fd, .length = length};
    for (int i = 0; i < length; i++) f.data[i] = data[i];
    board_hear(&board, &f);
}
__attribute__((visibility("default"))) void tick(unsigned *out)
{
    static Frame frames[BOARD_FRAMES];
    static const Sample sample;
    Frame beat = {.id = BUS_LOOP_HEARTBEAT_FRAME_ID, .length = 1, .data = {5}};
    const Counts *c = &board.counts;
    if (board.ms % 100 == 0) board_hear(&board, &beat);
    board_tick(&board, &sample, frames);
    for (int i = 0; i < 3; i++) out[i] = board.applied[i];
    out[3] = board.mode;
    const unsigned counts[] = {c->crc,   c->length, c->repeated, c->lost, c->sequence,
                               c->range, c->timeout};
    for (int i = 0; i < 7; i++) out[4 + i] = counts[i];
}
"""


@cache
def shim(dbc: str) -> ctypes.CDLL:
    texts = {n: t for n, t in sources(dbc).items() if not n.startswith(("host", "faults"))}
    texts["shim.c"] = _SHIM
    arguments = ["shim.c", "board.c", "bus.c", "-std=c99", "-shared", "-fPIC", "-O1", "-o", "shim"]
    return ctypes.CDLL(str(compile_c(texts, arguments, "shim")))


@dataclass(frozen=True)
class Sent:
    """A command of a test: its counter is so many after the one before."""

    step: int
    mode: int
    raw: tuple[int, int, int]
    spoilt: bool
    length: int


raw_volts = st.one_of(st.integers(0, 50000), st.sampled_from([0, 50000, 50001, 0xFFFE, 0xFFFF]))
sent = st.builds(
    Sent,
    step=st.sampled_from([1, 1, 1, 1, 1, 1, 0, 2, 3, 4, 7]),
    mode=st.sampled_from([RUN, RUN, RUN, HOLD, OFF, 3, 15]),
    raw=st.tuples(raw_volts, raw_volts, raw_volts),
    spoilt=st.sampled_from([False] * 9 + [True]),
    length=st.sampled_from([0] * 9 + [-1, 1]),
)
ticks = st.lists(
    st.one_of(sent, sent, sent, st.none(), st.integers(2, 12)), min_size=1, max_size=60
)


class Model:
    """What the board should do with its commands, from the parts that the loop's side has."""

    def __init__(self, modulus: int) -> None:
        self.sequence = Sequencer(modulus)
        self.quiet = 99
        self.good: Sent | None = None
        self.drive = VoltageRamp([(0, 50000)] * 3, 100)
        self.mode = OFF
        self.counts = Counter()

    def hear(self, s: Sent, counter: int) -> None:
        if s.length:
            self.counts["length"] += 1
        elif s.spoilt:
            self.counts["crc"] += 1
        elif self.is_usable(counter):
            if s.mode > RUN or (s.mode != OFF and max(s.raw) > 50000):
                self.counts["range"] += 1
            else:
                self.good, self.quiet = s, 0

    def is_usable(self, counter: int) -> bool:
        status = self.sequence.take(counter)
        self.counts["repeated"] += status is CheckStatus.REPEATED
        self.counts["sequence"] += status is CheckStatus.WRONG_SEQUENCE
        self.counts["lost"] += self.sequence.lost
        return status in (CheckStatus.INITIAL, CheckStatus.OK, CheckStatus.OK_SOME_LOST)

    def tick(self) -> None:
        if self.quiet == 5:
            self.counts["timeout"] += 1
            self.sequence.silence()
        led = self.good is not None and self.quiet < 5
        self.mode = self.good.mode if led else OFF
        self.drive.step(None if self.mode == OFF else self.good.raw)
        self.quiet += 1


@pytest.mark.parametrize("dbc", DBCS)
@settings(max_examples=100)
@given(script=ticks)
def test_commands_are_judged_by_the_table_of_faults(dbc, script) -> None:
    """Expected: what is applied is in range, moves only as it may, and is what the table says."""
    fd = dbc == "instrument_fd"
    modulus = 256 if fd else 15
    library, out = shim(dbc), (ctypes.c_uint * 11)()
    library.begin()
    model, counter = Model(modulus), 0
    before, asked = [0, 0, 0], None
    for item in [*script, 510]:
        if isinstance(item, Sent):
            counter = (counter + item.step) % modulus
            signals = dict(zip(("volts_1", "volts_2", "volts_3"), item.raw, strict=True))
            message = database(dbc).get_message_by_frame_id(COMMAND)
            zeros = {signal.name: 0 for signal in message.signals}
            values = zeros | signals | {"mode": item.mode, "counter": counter}
            data = bytearray(
                protected(dbc, COMMAND, message.encode(values, scaling=False, strict=False))
            )
            if item.spoilt:
                data[-1] ^= 0x10
            data = data[: len(data) - 1] if item.length < 0 else data + bytes(item.length)
            library.hear(fd, len(data), bytes(data))
            model.hear(item, counter)
        for _ in range(item if isinstance(item, int) else 1):
            library.tick(out)
            model.tick()
            applied = out[:3]
            assert applied == model.drive.volts
            assert out[3] == model.mode
            for i in range(3):
                # No faster than the ramp, and what the command moves meanwhile.
                follows = asked is not None and model.mode != OFF
                moved = abs(model.good.raw[i] - asked[i]) if follows else 0
                assert abs(applied[i] - before[i]) <= 100 + moved
                assert applied[i] <= 50000
            before = applied
            asked = model.good.raw if model.mode != OFF else None
    names = ("crc", "length", "repeated", "lost", "sequence", "range", "timeout")
    assert dict(zip(names, out[4:], strict=True)) == {n: model.counts[n] for n in names}
    assert list(out[:3]) == [0, 0, 0], "silence does not take it to rest"


# --- Faults ---------------------------------------------------------------------------------------

FROM, TO = 50, 250
WHEN = f"@{FROM * 1e-3}-{TO * 1e-3}"


def test_kinds_are_those_of_the_issue() -> None:
    assert list(fault_kinds()) == [
        *("drop", "delay", "duplicate", "reorder", "corrupt", "freeze", "stick", "wrong-length"),
        *("unknown", "babble", "silence", "bus-off", "unplug", "unavailable"),
    ]
    assert set(fault_kinds()) == set(KINDS), "those of the board in Python"
    header = sources("instrument")["faults.h"]
    assert re.findall(r'X\(\w+, "([\w-]+)"', header) == list(fault_kinds())


def check_drop(seen: list[Frame], clean: list[list[Frame]]) -> None:
    rest = iter(f for frames in clean for f in frames)
    assert all(frame in rest for frame in seen), "not the same frames in the same order"
    inside = sum(map(len, clean[FROM:TO]))
    lost = sum(map(len, clean)) - len(seen)
    assert 0.1 * inside < lost < 0.3 * inside


def check_delay(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [(k, f) for k, frames in enumerate(clean) for f in frames]
    assert Counter(seen) == Counter(f for _, f in flat)
    # Time on the wire goes by the frames that are not late: their sample is the newest so far.
    home: dict[Frame, list[int]] = {}
    for k, f in flat:
        home.setdefault(f, []).append(k)
    now, lags = 0, []
    for frame in seen:
        k = home[frame].pop(0)
        now = max(now, k)
        lags.append(now - k)
    assert max(lags) == 5
    assert np.mean(np.array(lags) > 0) > 0.05


def check_duplicate(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    once = [f for i, f in enumerate(seen) if i == 0 or f != seen[i - 1]]
    assert once == flat
    assert 0.1 < (len(seen) - len(flat)) / sum(map(len, clean[FROM:TO])) < 0.3


def check_reorder(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    swaps, i = 0, 0
    while i < len(flat):
        if seen[i] == flat[i]:
            i += 1
            continue
        assert seen[i : i + 2] == [flat[i + 1], flat[i]]
        swaps, i = swaps + 1, i + 2
    assert swaps > 50


def check_corrupt(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    assert len(seen) == len(flat)
    bad = [(s, f) for s, f in zip(seen, flat, strict=True) if s != f]
    assert len(bad) > 50
    for s, f in bad:
        a, b = (int.from_bytes(x.data, "big") for x in (s, f))
        assert (a ^ b).bit_count() == 1
        assert s.id == HEARTBEAT or protected("instrument", s.id, s.data) != s.data
    assert seen[: 3 * FROM] == flat[: 3 * FROM]


def sensor_data(frames: list[Frame]) -> dict[int, list[bytes]]:
    return {i: [f.data for f in frames if f.id == i] for i in (0x110, 0x111, 0x112)}


def check_freeze(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    for i, frames in sensor_data(seen).items():
        assert [d[1] & 15 for d in frames] == [k % 15 for k in range(SAMPLES)]
        assert all(protected("instrument", i, d) == d for d in frames)
        frozen = [k for k in range(1, SAMPLES) if frames[k][2:] == frames[k - 1][2:]]
        assert 20 < len(frozen) < 60
        assert set(frozen) <= set(range(FROM, TO))
        good = set(range(SAMPLES)) - set(frozen)
        assert all(frames[k] == flat[i][k] for k in good)


def check_stick(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    for i, frames in sensor_data(seen).items():
        stuck = [k for k in range(1, SAMPLES) if frames[k] == frames[k - 1]]
        assert 20 < len(stuck) < 60
        assert set(stuck) <= set(range(FROM, TO))
        assert all(frames[k] == flat[i][k] for k in set(range(SAMPLES)) - set(stuck))


def check_length(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    assert [f.id for f in seen] == [f.id for f in flat]
    bad = [(s, f) for s, f in zip(seen, flat, strict=True) if s != f]
    assert len(bad) > 50
    assert all(len(s.data) != len(f.data) and len(s.data) <= 8 for s, f in bad)


def check_unknown(seen: list[Frame], clean: list[list[Frame]]) -> None:
    known = {m.frame_id for m in database("instrument").messages}
    foreign = [f for f in seen if f.id not in known]
    assert [f for f in seen if f.id in known] == [f for frames in clean for f in frames]
    assert len({f.id for f in foreign}) > 50


def check_babble(seen: list[Frame], clean: list[list[Frame]]) -> None:
    check_unknown(seen, clean)
    per_sample = np.diff([i for i, f in enumerate(seen) if f.id == 0x112])
    full = per_sample[FROM:TO] >= 8
    assert 0.1 < full.mean() < 0.3
    assert (per_sample[: FROM - 1] < 7).all()


def check_silence(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for k, frames in enumerate(clean) if not FROM <= k < TO for f in frames]
    assert seen == flat


def check_unavailable(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    places = set()
    for i, frames in sensor_data(seen).items():
        assert all(protected("instrument", i, d) == d for d in frames)
        for k, (a, b) in enumerate(zip(frames, flat[i], strict=True)):
            for at in (2, 4, 6):
                if a[at : at + 2] != b[at : at + 2]:
                    assert a[at : at + 2] == b"\xff\xff"
                    assert FROM <= k < TO
                    places.add((i, at))
    assert len(places) == 1


CHECKS = {
    "drop:0.2": check_drop,
    "delay:0.2": check_delay,
    "duplicate:0.2": check_duplicate,
    "reorder:0.2": check_reorder,
    "corrupt:0.2": check_corrupt,
    "freeze:0.2": check_freeze,
    "stick:0.2": check_stick,
    "wrong-length:0.2": check_length,
    "unknown:0.2": check_unknown,
    "babble:0.2": check_babble,
    "silence": check_silence,
    "unavailable:0.5": check_unavailable,
}


def test_every_kind_has_a_check() -> None:
    kinds = {fault.partition(":")[0] for fault in CHECKS}
    assert kinds | {"bus-off", "unplug"} == set(fault_kinds())


@pytest.mark.parametrize("fault", CHECKS)
def test_fault_shows_as_it_should_and_again_from_its_seed(recording, volts, fault) -> None:
    """Expected: nothing outside its time; from the same seed the same frames, else others."""
    first, second, other = played(recording, [fault + WHEN], seeds=(3, 3, 4))
    assert first == second
    if ":" in fault:
        assert first != other
    clean = clean_frames("instrument", volts)
    CHECKS[fault](first, clean)
    before = sum(map(len, clean[:FROM]))
    assert first[:before] == [f for frames in clean[:FROM] for f in frames]


def test_fault_of_one_id_and_several_at_once(recording, volts) -> None:
    faults = [f"drop/0x701{WHEN}", f"drop/0x111{WHEN}", "corrupt/0x310"]
    [seen] = played(recording, faults)
    clean = [f for frames in clean_frames("instrument", volts) for f in frames]
    assert len(sensor_data(seen)[0x111]) == SAMPLES - (TO - FROM)
    assert sum(f.id == HEARTBEAT for f in seen) == 1  # of 0, 100 and 200 ms
    assert not {f for f in clean if f.id == STATUS} & set(seen)
    same = (0x110, 0x112, FEEDBACK)
    assert [f for f in seen if f.id in same] == [f for f in clean if f.id in same]


def test_fd_frames_of_wrong_length_are_frames_still(recording, volts) -> None:
    [seen] = played(recording, ["wrong-length:0.3"], dbc="instrument_fd")
    clean = [f for frames in clean_frames("instrument_fd", volts) for f in frames]
    lengths = {len(f.data) for s, f in zip(clean, seen, strict=True) if s != f}
    assert len(lengths) > 8
    assert max(lengths) == 64


def test_bus_off_is_silent_and_refuses_and_says_so(recording, volts) -> None:
    with FirmwareBoard(recording, faults=[f"bus-off{WHEN}"]) as board:
        host = Host(board.link)
        host.pump(until=lambda: "sb000255" in host.answers)
        host.answers.clear()
        host.write("F\r" + Frame(COMMAND, command("instrument", 0, RUN, 1, 1, 1)).line)
        host.pump(0.02)
        assert host.answers[0] == "FA4"
        assert "\a" in host.answers
        assert "z" not in host.answers
        host.answers.clear()
        host.write("C\rO\rF\r")  # a host that restarts the controller is told again
        host.pump(0.02)
        assert host.answers[:3] == ["", "", "FA4"]
        assert "sb000255" in host.answers
        host.pump(until=lambda: host.has_stopped)
        assert "sa000000" in host.answers
        host.answers.clear()
        host.write("F\r")
        host.pump(until=lambda: "F00" in host.answers)
        host.close()
    clean = clean_frames("instrument", volts)
    seen = while_sampling(host.frames)
    expected = [f for k, frames in enumerate(clean) if not FROM <= k < TO for f in frames]
    assert seen == expected
    assert (board.log["volts_1"] == 0).all(), "the command was heard"


def test_unplugged_and_back_behind_the_same_link(recording) -> None:
    with FirmwareBoard(recording, loop=True, faults=["unplug@0.05-0.15"]) as board:
        host = Host(board.link)
        terminal = str(board.link.readlink())
        with pytest.raises(OSError, match=r"no other end|Input/output error"):
            host.pump()
        gone = time.monotonic()
        assert not board.link.is_symlink()
        while not board.link.exists():
            assert time.monotonic() - gone < 1.0
            time.sleep(1e-3)
        away = time.monotonic() - gone
        back = Host(board.link)
        back.pump(until=lambda: sum(f.id == STATUS for f in back.frames) >= 1)
        status = next(f.data for f in back.frames if f.id == STATUS)
        for h in (host, back):
            h.close()
        assert terminal.startswith("/dev/pts/")
    assert 0.05 < away < 0.2
    assert int.from_bytes(status[2:6], "little") == 200, "the board's time stood still"
    assert not board.link.exists()


def test_times_without_end_come_and_go_by_their_rate(recording, volts) -> None:
    """A rate makes episodes of 200 ms out of a fault that otherwise lasts."""
    [seen] = played(recording, ["silence:0.05@0.02-"], seeds=(3,))
    heard = sensor_data(seen)[0x110]
    sent = sensor_data([f for k, v in enumerate(volts) for f in sample_frames("instrument", k, v)])
    begin = next(k for k, data in enumerate(heard) if data != sent[0x110][k])
    assert 20 <= begin < 100
    again = sent[0x110][begin + 200 :]  # until the next episode
    assert len(heard) > begin + 10
    assert heard[begin:] == again[: len(heard) - begin]


# --- The loop's end ------------------------------------------------------------------------------


def looped(
    recording: Path, dbc: str, ticks: int, faults: Sequence[str] = ()
) -> tuple[ControllerNode, dict[int, tuple[float, ...]], FirmwareBoard]:
    """The loop's own node with the board, on the bulk slcan interface: node, samples by number."""
    taken: dict[int, tuple[float, ...]] = {}
    with FirmwareBoard(recording, dbc, loop=True, faults=faults, seed=5) as board:
        address = Address("slcanbulk", str(board.link))
        node = ControllerNode(load(dbc), "Loop", address, Hil(), 1e-3)
        node.open()
        node.wait_for_board()
        for k in range(ticks):
            sample = node.wait(k).sample
            if sample is not None:
                taken[sample.number] = sample.values
            node.transmit([0.1, 0.15, 0.2])
        node.close()
    return node, taken, board


def named(node: ControllerNode, values: Sequence[float]) -> list[float]:
    """The channels of a sample in the board's order."""
    parts = [m for m in node.database.messages if m.role == "sample"]
    names = [signal.name for m in parts for signal in m.signals]
    return [values[names.index(f"volts_{name}")] for name in CHANNELS]


@pytest.mark.parametrize("dbc", DBCS)
def test_loop_and_board_understand_each_other(recording, volts, dbc) -> None:
    node, taken, board = looped(recording, dbc, 400)
    assert len(taken) > 300
    for number, values in taken.items():
        np.testing.assert_allclose(named(node, values), volts[number % SAMPLES], atol=1e-9)
    ours, theirs = node.reception.counts, board.log
    for fault in ("lost", "repeated", "crc", "range", "length", "unknown", "heartbeat"):
        assert ours[fault] == 0, fault
    for fault in ("lost", "repeated", "crc", "range", "length", "unknown"):
        assert theirs[fault][-1] == 0, fault
    assert [theirs[f"volts_{i}"].max() for i in (1, 2, 3)] == pytest.approx([0.1, 0.15, 0.2])


@pytest.mark.parametrize(
    ("fault", "counted"),
    [
        ("drop/0x110:0.05", ["lost", "incomplete"]),
        ("silence@0.2-0.204", ["sequence"]),
        ("silence@0.2-0.22", ["timeouts"]),
        ("duplicate:0.05", ["repeated"]),
        ("stick:0.05", ["repeated"]),
        ("corrupt/0x111:0.05", ["crc", "incomplete"]),
        ("wrong-length/0x112:0.05", ["length", "incomplete"]),
        ("unavailable@0.2-0.3", ["range"]),
        ("unknown:0.05", ["unknown"]),
        ("babble@0.2-0.3", ["unknown"]),
        ("delay/0x110:0.1", ["sequence"]),
        ("drop/0x701@0.05-", ["heartbeat"]),
        ("bus-off@0.2-0.25", ["bus_off"]),
        ("unplug@0.2-0.25", ["unplugged"]),
    ],
)
def test_loop_detects_what_the_board_does_wrong(recording, volts, fault, counted) -> None:
    """Expected: counted as in the table of faults; a sample that is taken was recorded as one."""
    node, taken, _ = looped(recording, "instrument", 500, [fault])
    for name in counted:
        assert node.reception.counts[name] > 0, name
    borne = int(fault.startswith("unavailable"))  # channels that are held
    for number, values in taken.items():
        wrong = np.abs(volts - named(node, values)) > 1e-9
        assert wrong.sum(axis=1).min() <= borne, number


# --- Garbage --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dbc", DBCS)
def test_garbage_on_the_line_does_not_disturb(recording, volts, dbc) -> None:
    """Expected: frames as ever, nothing applied; run where undefined behaviour is a trap."""
    rng = np.random.default_rng(11)
    letters = np.frombuffer(b"0123456789ABCDEFtTrRdDbBSsVNFZYx\r\r\r\a\n", np.uint8)
    program = build_board(dbc, STRICT)
    with FirmwareBoard(recording, dbc, program=program) as board:
        host = Host(board.link)
        fd = dbc == "instrument_fd"
        good = Frame(COMMAND, command(dbc, 3, RUN, 10.0, 10.0, 10.0), fd).line
        while not host.has_stopped:
            size = int(rng.integers(1, 60))
            junk = rng.integers(0, 256, size, dtype=np.uint8)
            noise = rng.choice(letters, size)
            cut = good[: int(rng.integers(1, len(good) - 1))]
            text = junk.tobytes() + noise.tobytes() + b"\r"
            # What closes the channel is no garbage but a command, and so is what only listens.
            lines = [x for x in text.split(b"\r") if x not in (b"C", b"O", b"L")]
            os.write(host.fd, b"\r".join(lines) + cut.encode() + b"\r")
            host.pump(2e-3)
        host.close()
    clean = [f for frames in clean_frames(dbc, volts) for f in frames]
    seen = while_sampling(host.frames)
    assert [f for f in seen if f.id != FEEDBACK] == [f for f in clean if f.id != FEEDBACK]
    assert (board.log["volts_1"] == 0).all()
    assert (board.log["mode"] == OFF).all()


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_all_faults_at_once_under_the_sanitisers_of_another_compiler(
    recording, dbc, tmp_path
) -> None:
    """Zig has no run-time part for addresses; the system's compiler may have one."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no other C compiler here")
    for name, text in sources(dbc).items():
        (tmp_path / name).write_text(text)
    units = [n for n in sources(dbc) if n.endswith(".c")]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-g", "-O1"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    done = subprocess.run(
        [compiler, *flags, *units, "-o", "board", "-lm"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    if "cannot find" in done.stderr:
        pytest.skip("the C compiler here has no sanitisers")
    assert done.returncode == 0, done.stderr
    faults = [f"{kind}:0.05" for kind in fault_kinds() if kind not in ("silence", "bus-off")]
    faults = [f"{f.split(':')[0]}:0.002" if f.startswith("unplug") else f for f in faults]
    faults += ["silence:0.002", "bus-off:0.002"]
    options = {"faults": faults, "seed": 2, "program": tmp_path / "board", "loop": True}
    with FirmwareBoard(recording, dbc, **options) as board:
        end = time.monotonic() + 4.0
        while time.monotonic() < end:
            try:
                host = Host(board.link)
            except OSError:
                time.sleep(5e-3)
                continue
            try:
                host.pump(end - time.monotonic())
            except OSError:
                pass  # unplugged
            finally:
                host.close()
        assert board.is_running, board.check()
    assert len(board.log["sample"]) > 3000


# --- Mistakes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "option '--link': it is missing"),
        (["--link", "x"], "option '--samples': it is missing"),
        (["--speed", "2"], "option '--speed': it is not known; --help"),
        (["--log"], "option '--log': it needs a value"),
        (["--seed", "-1"], "--seed '-1': it must be a number in [0, 4294967295]"),
        (["--drift", "fast"], "--drift 'fast': it must be a number in [-10000, 10000]"),
        (["--drift", "nan"], "--drift 'nan': it must be a number"),
        (["--priority", "0"], "--priority '0': it must be a number in [1, 99]"),
        (["--fault", "drip"], "--fault 'drip': the kind is not known; --kinds"),
        (["--fault", "drop:1.1"], "the rate must be a probability, 0 to 1"),
        (["--fault", "drop:-0.1"], "the rate must be a probability, 0 to 1"),
        (["--fault", "drop:0.1@3-2"], "the time must end after it begins"),
        (["--fault", "drop@3"], "the time must be START-END or START-"),
        (["--fault", "drop@-3-4"], "the time must be START-END or START-"),
        (["--fault", "drop@1-2x"], "not of the form KIND[/ID][:RATE][@START-END]"),
        (["--fault", "drop/0x555"], "the id is none of this bus"),
        (["--fault", "silence/0x110"], "only faults of frames have an id"),
        (["--fault", "drop"] * 33, "there are too many faults, more than 32"),
    ],
)
def test_wrong_options_are_told_in_words(arguments, words) -> None:
    done = subprocess.run([build_board(), *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stdout == ""


def test_help_names_every_option() -> None:
    done = subprocess.run([build_board(), "--help"], capture_output=True, text=True, check=True)
    for name in ("link", "samples", "loop", "log", "drift", "fault", "seed", "kinds", "priority"):
        assert f"--{name}" in done.stdout


GOOD = ",".join(f"volts_{name}" for name in CHANNELS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        (f"{GOOD}\n", "it has a header and no samples"),
        (f"{GOOD},volts_x\n", "line 1: a column is not known: 'volts_x'"),
        (f"{GOOD},volts_mx\n", "line 1: a column stands twice: 'volts_mx'"),
        ("temperature\n1\n", "line 1: a column is missing: 'volts_a1x'"),
        (f"{GOOD}\n1,1,1,1,1,1,1,1\n", "line 2: there are more or fewer cells"),
        (f"{GOOD}\n{'1,' * 8}1\n{'1,' * 8}x\n", "line 3: no number: 'x'"),
        (f"{GOOD}\n{'1,' * 8}5.1\n", "line 2: a voltage must be in [0, 5] V, or nan"),
        (f"{GOOD}\n{'1,' * 8}inf\n", "line 2: a voltage must be in [0, 5] V, or nan"),
        (f"{GOOD},temperature\n{'1,' * 9}200\n", "line 2: a temperature must be in [-40, 125]"),
        (f"{GOOD},field_new\n{'1,' * 9}2\n", "line 2: field_new must be 0 or 1, not '2'"),
    ],
)
def test_wrong_recordings_are_told_by_line(tmp_path, text, words) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(SteadytipError) as caught, FirmwareBoard(path):
        pass
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "status 2" in str(caught.value)


def test_a_recording_has_nine_channels(tmp_path) -> None:
    with pytest.raises(SteadytipError, match=r"have the shape \(5, 8\), they need \(samples, 9\)"):
        write_samples(tmp_path / "wrong.csv", np.ones((5, 8)))


def test_a_link_does_not_replace_a_file(recording, tmp_path) -> None:
    path = tmp_path / "precious"
    path.write_text("text")
    done = subprocess.run(
        [build_board(), "--link", path, "--samples", recording], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "there is something else at this path" in done.stderr
    assert path.read_text() == "text"


def test_a_board_that_dies_is_told(recording) -> None:
    board = FirmwareBoard(recording)
    board.start()
    assert board.is_running
    board._process.send_signal(signal.SIGKILL)
    board._process.wait()
    assert not board.is_running
    with pytest.raises(SteadytipError, match=r"the board ended with status -9"):
        board.check()
    with pytest.raises(SteadytipError, match="not ended in order"):
        board.summary  # noqa: B018
    board.stop()
    board.stop()


def test_a_board_whose_parent_dies_ends(recording, tmp_path) -> None:
    link = tmp_path / "line"
    script = (
        "import sys, os, pathlib\n"
        "from harness.can.firmware import FirmwareBoard\n"
        "recording, link = map(pathlib.Path, sys.argv[1:])\n"
        "board = FirmwareBoard(recording, link=link)\n"
        "board.start()\nprint(board._process.pid, flush=True)\nos._exit(0)\n"
    )
    command = [sys.executable, "-c", script, recording, link]
    done = subprocess.run(command, capture_output=True, text=True)
    child = int(done.stdout)
    end = time.monotonic() + 2.0
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < end:
        if Path(f"/proc/{child}/stat").read_text().split()[2] == "Z":
            break
        time.sleep(0.01)
    assert time.monotonic() < end
    assert not link.is_symlink()


def test_summary_is_json_and_log_is_whole_after_a_signal(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        host.pump(0.1)
        host.close()
    assert set(board.summary) == {"samples", "unsent", "latest_us"}
    assert json.dumps(board.summary)
    assert len(board.log["sample"]) == board.summary["samples"] > 50
