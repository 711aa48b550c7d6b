"""Where the rows of a sweep are kept: a journal while it runs, one Parquet file at its end.

The journal `sweep.jsonl` has a first line about the sweep, then a line for each run, and one for
each figure of merit that is new. Lines are given to the system as they come and forced to the disk
some times a second: a process that is killed loses nothing that was finished, a machine without
power what was finished in the last second. A line that was cut off counts as not written.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError
from harness.common.files import reason

if TYPE_CHECKING:
    from harness.sweep.worker import CaseRow

__all__ = ["JOURNAL", "PAGE", "PARQUET", "Store", "contents", "differences", "rows"]

JOURNAL, PARQUET, PAGE = "sweep.jsonl", "sweep.parquet", "sweep.html"
_FORCED = 0.5  # s between two times that lines are forced to the disk
_FORMAT = 1


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Names of what is not the same in two nested tables."""
    found: list[str] = []
    for key in dict.fromkeys([*old, *new]):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            found += differences(a, b, f"{prefix}{key} ")
        elif a != b:
            found.append(f"{prefix}{key}")
    return found


class Store:
    """The journal of a sweep."""

    def __init__(
        self, folder: Path, identity: Mapping[str, Any], metadata: Mapping[str, Any], fresh: bool
    ) -> None:
        """Open the journal of an earlier start of the same sweep, or begin one.

        Args:
            folder: of the sweep, made if it does not exist.
            identity: what all numbers follow from, JSON types only.
            metadata: what else is to be known of the sweep, JSON types only.
            fresh: start over, whatever is there.

        Raises:
            SteadytipError: the folder holds another sweep.
            RecordError: the disk does not take it.
        """
        self.folder = folder
        self.path = folder / JOURNAL
        self.done: dict[int, str] = {}
        """Status of the runs that have a row, by number; the last one counts."""
        self.units: dict[str, dict[str, str]] = {}
        """Unit and definition of each figure of merit."""
        self._forced = time.monotonic()
        self._dirty = False
        head = json.dumps({"sweep": {**identity, "format": _FORMAT}, "facts": metadata})
        try:
            folder.mkdir(parents=True, exist_ok=True)
            end = 0 if fresh else self._read(identity)
            if fresh:
                for name in (PARQUET, PAGE):
                    (folder / name).unlink(missing_ok=True)
            self._file = self.path.open("r+b" if end else "wb", buffering=0)
            self._file.truncate(end)
            self._file.seek(end)
            self._end = end
            if not end:
                self._write(head)
        except OSError as error:
            raise RecordError(f"cannot keep a sweep in {folder}: {reason(error)}") from None

    def _read(self, identity: Mapping[str, Any]) -> int:
        """Take up what is there; returns where the last whole line ends."""
        if not self.path.exists():
            return 0
        end = 0
        for line, at in _lines(self.path):
            if "sweep" in line:
                changed = differences(line["sweep"], {**identity, "format": _FORMAT})
                if changed:
                    raise SteadytipError(
                        f"{self.path} is of another sweep; changed since: {', '.join(changed)}. "
                        "Give another folder by --out, or start over by --fresh."
                    )
            elif "figure" in line:
                self.units[line["figure"]] = {k: line[k] for k in ("unit", "definition")}
            elif "run" in line:
                self.done[line["run"]] = line["status"]
            end = at
        return end

    def add(self, row: CaseRow, case: Mapping[str, Any]) -> None:
        """Keep a row.

        Args:
            row: what became of a run.
            case: what the run is, by column, JSON types only.

        Raises:
            RecordError: the disk does not take it.
        """
        try:
            for name, metric in row.metrics.items():
                if name not in self.units:
                    self.units[name] = {"unit": metric.unit, "definition": metric.definition}
                    self._write(json.dumps({"figure": name, **self.units[name]}))
            line: dict[str, Any] = {"run": row.number, **case}
            line |= {"status": row.status, "error": row.error, "wall": row.wall, "cpu": row.cpu}
            line["metrics"] = {name: metric.value for name, metric in row.metrics.items()}
            self._write(json.dumps(line))
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(self._end)
            raise RecordError(
                f"{self.path}: {reason(error)}. The {len(self.done)} runs before are in that file; "
                "make room and give the same command again, it goes on from there."
            ) from None
        self.done[row.number] = row.status

    def _write(self, text: str) -> None:
        data = memoryview(f"{text}\n".encode())
        whole = len(data)
        while data:
            data = data[self._file.write(data) :]
        self._end += whole
        self._dirty = True

    def force(self) -> None:
        """Have the disk take what it has been given, if that was a while ago.

        Raises:
            RecordError: it does not.
        """
        if not self._dirty or time.monotonic() - self._forced < _FORCED:
            return
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise RecordError(f"{self.path}: {reason(error)}") from None
        self._forced, self._dirty = time.monotonic(), False

    def close(self) -> None:
        """Close the journal, once."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError):
            os.fsync(self._file.fileno())
        with contextlib.suppress(OSError):
            self._file.close()


def _lines(path: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """Whole lines, and where each ends; a line that was cut off, or is damaged, ends them."""
    at = 0
    with path.open("rb") as file:
        for raw in file:
            at += len(raw)
            if not raw.endswith(b"\n"):
                return
            try:
                yield json.loads(raw), at
            except ValueError:
                return


def contents(path: Path) -> tuple[dict[str, Any], dict[str, dict[str, str]], dict[int, int]]:
    """Read a journal: metadata, figures with unit and definition, where each run's line is."""
    metadata: dict[str, Any] = {}
    figures: dict[str, dict[str, str]] = {}
    places: dict[int, int] = {}
    before = 0
    for line, at in _lines(path):
        if "sweep" in line:
            metadata = line["facts"]
        elif "figure" in line:
            figures[line["figure"]] = {k: line[k] for k in ("unit", "definition")}
        else:
            places[line["run"]] = before
        before = at
    return metadata, figures, places


def rows(path: Path, places: Mapping[int, int]) -> Iterator[dict[str, Any]]:
    """Lines of the runs, the last one of each, in the order of their numbers."""
    with path.open("rb") as file:
        for number in sorted(places):
            file.seek(places[number])
            yield json.loads(file.readline())
