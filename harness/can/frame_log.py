"""The log of raw frames, as other tools read it: candump's text or Vector's BLF.

Frames of the bus are on lane `can0`, those that were sent marked so. On `can1`, which is no bus, a
frame with id 0 stands where a tick began: its time, and `CycleInput.packed` as its data. With these
the log holds all that a run depends on.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Generator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmu_src.errors import SteadytipError
from harness.common.background_writer import BackgroundFile
from harness.common.errors import FaultError
from harness.common.files import reason

__all__ = ["BUS", "SUFFIXES", "TICKS", "Entry", "FrameLog", "read_log"]

BUS, TICKS = "can0", "can1"
"""Lanes of the log."""
SUFFIXES = {"candump": ".log", "blf": ".blf"}


class FrameLog:
    """Buffers frames and ticks; `flush` writes them."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Args:
            path: its ending tells the format, `.log` or `.blf`.

        Raises:
            FaultError: it cannot be written.
        """
        import can

        self.path = path
        self._message = can.Message
        self._buffer: list[Any] = []
        self._open = ExitStack()
        binary = path.suffix == SUFFIXES["blf"]
        try:
            file: Any = BackgroundFile(path)
            if not binary:
                file = io.TextIOWrapper(file, "ascii")
            self._open.callback(file.close)
            writer: Any = can.BLFWriter if binary else can.CanutilsLogWriter
            self._writer = writer(file)
            self._open.callback(self._writer.stop)
        except OSError as error:
            with suppress(OSError):
                self._open.close()
            raise FaultError(f"the log of frames {path}: {reason(error)}") from None

    def frame(self, message: Any) -> None:
        """Take a frame; its time is in [us]."""
        self._buffer.append(message)

    def tick(self, time: int, content: bytes) -> None:
        """Take the beginning of a tick [us]."""
        self._buffer.append(
            self._message(
                timestamp=time,
                arbitration_id=0,
                is_extended_id=False,
                data=content,
                channel=TICKS,
            )
        )

    def flush(self) -> None:
        """Write what was taken.

        Raises:
            FaultError: the disk does not take it.
        """
        buffered, self._buffer = self._buffer, []
        try:
            for message in buffered:
                message.timestamp *= 1e-6
                if message.channel != TICKS:
                    message.channel = BUS
                self._writer.on_message_received(message)
        except OSError as error:
            raise FaultError(f"the log of frames {self.path}: {reason(error)}") from None

    def close(self) -> None:
        """Write what is left and close the file.

        Raises:
            FaultError: the disk does not take it.
        """
        try:
            with self._open:
                self.flush()
        except OSError as error:
            raise FaultError(f"the log of frames {self.path}: {reason(error)}") from None


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a log.

    Attributes:
        time: [us].
        tick: data of the beginning of a tick; None for a frame.
        message: the frame, its time in [us].
    """

    time: int
    tick: bytes | None
    message: Any

    @property
    def was_sent(self) -> bool:
        """True if this end of the bus sent the frame."""
        return self.tick is None and not self.message.is_rx


def read_log(path: Path) -> Generator[Entry]:
    """Entries of a log, in their order.

    Raises:
        SteadytipError: it does not exist, or is no such log.
    """
    import can

    if not path.is_file():
        raise SteadytipError(f"log {path} does not exist")
    if path.suffix not in SUFFIXES.values():
        raise SteadytipError(f"log {path}: give one that ends in {' or '.join(SUFFIXES.values())}")
    number = 0
    try:
        binary = path.suffix == SUFFIXES["blf"]
        reader: Any = can.BLFReader if binary else can.CanutilsLogReader
        with path.open("rb") if binary else path.open(encoding="ascii") as file:
            for message in reader(file):
                number += 1
                time = round(message.timestamp * 1e6)
                message.timestamp = time
                ticks = str(message.channel) in (TICKS, TICKS.removeprefix("can"))
                yield Entry(time, bytes(message.data) if ticks else None, message)
    except (ValueError, LookupError, OSError, EOFError, struct.error, can.CanError) as error:
        raise SteadytipError(
            f"log {path} cannot be read after {number} frames: {type(error).__name__}: {error}"
        ) from None
