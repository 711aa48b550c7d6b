"""A ring of rows in a file: one process writes, any number read, none waits for another.

The file is a header, columns as JSON, and rows of float64 in the writer's byte order:

| bytes | content |
| --- | --- |
| 0..7 | magic `STEADYRG` |
| 8..15 | version, int64 |
| 16..23 | capacity in rows, int64 |
| 24..31 | period of the rows [s], float64 |
| 32..39 | length of the JSON text in bytes, int64 |
| 64..71 | rows written so far, int64 |
| 128..135 | 1 once the writer has closed, int64 |
| 192.. | columns: list of name, type, unit, description |
| next multiple of 4096 | rows; row k is at place k modulo capacity |

The writer stores a row, then the count: both are plain stores to memory that the processes share,
and the count is one aligned word. A reader takes the count, copies, and takes the count again.
While the count is c the writer may be at row c, which lies where row c - capacity was; so of the
copy, rows from c - capacity + 1 on are whole. This relies on other processors seeing stores in the
order in which they were made, as on x86-64; elsewhere that is the rule rather than a promise.

Readers map the file read-only. They cannot disturb the writer, who never looks at them.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError
from harness.common.files import reason, replacing
from harness.common.types import FloatArray
from harness.parts.ports import Column

__all__ = ["CAPACITY", "IntArray", "Ring", "RingWriter", "memory_folder", "no_ring"]

IntArray = NDArray[np.int64]

CAPACITY = 32768
"""Rows, half a minute at 1 kHz."""

_MAGIC = b"STEADYRG"
_VERSION = 1
_HEADER = np.dtype(
    {
        "names": ["magic", "version", "capacity", "step", "length", "written", "closed"],
        "formats": ["S8", "i8", "i8", "f8", "i8", "i8", "i8"],
        "offsets": [0, 8, 16, 24, 32, 64, 128],
        "itemsize": 192,
    }
)
_WRITTEN, _CLOSED = (_HEADER.fields[name][1] // 8 for name in ("written", "closed"))  # type: ignore[index]
_PAGE = 4096
_LOOK = 0.02  # s between two looks for a file that is waited for


def memory_folder() -> Path:
    """Return a folder in memory for rings, where a disk cannot make the writer wait."""
    shared = Path("/dev/shm")
    return shared if os.access(shared, os.W_OK) else Path(tempfile.gettempdir())


class Ring:
    """The reader's end.

    Attributes:
        path: of the file.
        columns: of a row.
        step: period of the rows [s].
        capacity: rows that the file holds.
    """

    def __init__(self, path: Path, mode: Literal["r", "r+"] = "r") -> None:
        """Map a file that is known to be there; see `open`."""
        self.path = path
        try:
            with path.open("rb") as file:
                head = file.read(_HEADER.itemsize)
                if len(head) < _HEADER.itemsize or not head.startswith(_MAGIC):
                    raise SteadytipError(f"{path} is not a ring: it does not begin as one")
                header = np.frombuffer(head, _HEADER)[0]
                if header["version"] != _VERSION:
                    raise SteadytipError(
                        f"{path} is a ring of version {header['version']}; this reads {_VERSION}. "
                        "Take the same release at both ends."
                    )
                text = file.read(max(0, int(header["length"])))
            self.columns = tuple(Column(*fields) for fields in json.loads(text))
            self.step = float(header["step"])
            self.capacity = int(header["capacity"])
            shape = (self.capacity, len(self.columns))
            if path.stat().st_size != _rows_at(len(text)) + 8 * shape[0] * shape[1]:
                raise ValueError(f"it is not as long as {shape[0]} rows of {shape[1]} columns are")
            words = np.memmap(path, np.int64, mode, shape=(_HEADER.itemsize // 8,))
            rows = np.memmap(path, np.float64, mode, offset=_rows_at(len(text)), shape=shape)
            # Plain arrays and views of them: a memmap makes every access five times as dear.
            self._words = np.asarray(words).data
            self._rows: FloatArray = np.asarray(rows)
        except OSError as error:
            raise SteadytipError(f"cannot read the ring {path}: {reason(error)}") from None
        except (ValueError, TypeError, OverflowError, MemoryError) as error:
            raise SteadytipError(f"{path} is a damaged ring: {error}") from None

    @staticmethod
    def create(
        path: Path, columns: Sequence[Column], step: float, capacity: int = CAPACITY
    ) -> RingWriter:
        """Make the file, in place of one that is there, and open the writer's end.

        The whole file is written once, so that the loop meets neither a full disk nor a page that
        is not there yet. It appears under its name when it is complete.

        Args:
            path: best in `memory_folder`.
            columns: of a row, one or more.
            step: period of the rows [s].
            capacity: rows to hold, 2 or more.

        Raises:
            RecordError: the file cannot be made.
        """
        if not columns or capacity < 2 or not step > 0.0:
            raise ValueError(f"a ring of {len(columns)} columns, {capacity} rows, step {step}")
        text = json.dumps([astuple(column) for column in columns]).encode()
        header = np.zeros((), _HEADER)
        header["magic"], header["version"], header["capacity"] = _MAGIC, _VERSION, capacity
        header["step"], header["length"] = step, len(text)
        try:
            with replacing(path) as part, part.open("wb") as file:
                file.write((header.tobytes() + text).ljust(_rows_at(len(text)), b"\0"))
                blank = bytes(8 * len(columns))
                for _ in range(capacity):
                    file.write(blank)
        except OSError as error:
            size = 8e-6 * len(columns) * capacity
            raise RecordError(
                f"cannot make the ring {path} of {size:.3g} MB: {reason(error)}"
            ) from None
        return RingWriter(path)

    @staticmethod
    def open(path: Path, wait: float = 0.0) -> Ring:
        """Open the reader's end.

        Args:
            path: of the file.
            wait: how long it may take to appear [s].

        Raises:
            SteadytipError: it is not there in time, or is no ring.
        """
        end = time.monotonic() + wait
        while not path.is_file():
            if time.monotonic() >= end:
                raise no_ring(path, wait)
            time.sleep(_LOOK)
        return Ring(path)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(column.name for column in self.columns)

    @property
    def written(self) -> int:
        """Rows written so far."""
        return int(self._words[_WRITTEN])

    @property
    def closed(self) -> bool:
        """True once the writer has said that no more rows follow."""
        return bool(self._words[_CLOSED])

    def latest(self, n: int, columns: Sequence[int] | None = None) -> tuple[IntArray, FloatArray]:
        """Return the last rows, whole ones only.

        Args:
            n: at most so many; fewer where fewer were written, or were overwritten meanwhile.
            columns: places of the columns to take; all by default.

        Returns:
            Numbers of the rows, (m,), without a gap up to the newest; rows, (m, columns).
        """
        end = self.written
        begin = max(0, end - min(n, self.capacity))
        at, stop = begin % self.capacity, begin % self.capacity + end - begin
        spans = [slice(at, stop), slice(0, max(0, stop - self.capacity))]
        taken = slice(None) if columns is None else list(columns)
        rows = np.concatenate([self._rows[span][:, taken] for span in spans])
        whole = max(begin, self.written - self.capacity + 1)
        return np.arange(whole, max(whole, end)), rows[whole - begin :]


class RingWriter(Ring):
    """The writer's end; see `Ring.create`."""

    def __init__(self, path: Path) -> None:
        """Map a file that is known to be there, to write."""
        super().__init__(path, "r+")
        self._rows.fill(0.0)  # the first touch of a page costs as much as several rows
        self._count = 0
        self._place = 0

    def append(self, row: FloatArray) -> None:
        """Add a row, (columns,); the oldest gives way."""
        place = self._place
        self._rows[place] = row
        self._count = count = self._count + 1
        self._words[_WRITTEN] = count
        place += 1
        self._place = place if place < self.capacity else 0

    def close(self) -> None:
        """Tell readers that no more rows follow; the file stays."""
        self._words[_CLOSED] = 1


def no_ring(path: Path, wait: float) -> SteadytipError:
    """Return the error to raise when a file has not appeared within `wait` [s]."""
    within = f" within {wait:g} s" if wait > 0.0 else ""
    return SteadytipError(f"there is no ring {path}{within}; is its writer running?")


def _rows_at(length: int) -> int:
    """Return the place where the rows begin behind a JSON text of that length [bytes]."""
    return -(-(_HEADER.itemsize + length) // _PAGE) * _PAGE
