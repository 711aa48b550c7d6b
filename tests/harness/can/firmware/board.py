"""The board as a C program, seen from the host's end of its terminal.

The witnesses are cantools for the layout of frames and crccheck for their protection.
"""

import errno
import os
import re
import select
import sys
import time
from collections.abc import Callable, Sequence
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

from harness.can.firmware.process import CHANNELS, FirmwareBoard

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
        self._rest = ""
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
            except OSError as error:
                if error.errno != errno.EIO:  # the board has ended, which `read` tells
                    raise
                return

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
        *lines, self._rest = (self._rest + text.replace("\a", "\a\r")).split("\r")
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
