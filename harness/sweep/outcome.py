"""What comes out of a sweep: a table with a row for each run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError
from harness.common.files import reason, replacing
from harness.results.variants import RANKED
from harness.sweep.store import JOURNAL, PAGE, PARQUET, contents, rows

if TYPE_CHECKING:
    from harness.common.types import FloatArray
    from harness.sweep.statistics import Influence, Summary

__all__ = ["SweepResult", "larger_is_better", "read", "write_parquet"]

_FACTS = b"steadytip"
_ROWS = 2000  # per group of the Parquet file


class SweepResult:
    """A sweep, read from its files.

    Attributes:
        path: folder of the sweep.
    """

    def __init__(self, path: Path) -> None:
        """Refer to a sweep; it is read on first use."""
        self.path = path

    @property
    def file(self) -> Path:
        """The Parquet file; the journal of a sweep that was cut off."""
        table, journal = self.path / PARQUET, self.path / JOURNAL
        if not table.exists():
            return journal
        # A sweep that went on and was cut off has a journal that is newer than the table.
        newer = journal.exists() and journal.stat().st_mtime_ns > table.stat().st_mtime_ns
        return journal if newer else table

    @property
    def page(self) -> Path:
        """Path of the page, if one was written."""
        return self.path / PAGE

    @cached_property
    def table(self) -> pa.Table:
        """A row for each run: `run`, `seed`, what was varied, figures, `status`, `error`, ..."""
        if self.file.name == PARQUET:
            return parquet.read_table(self.file)
        schema, batches = _batches(self.file, None)
        return pa.Table.from_batches(batches, schema)

    @cached_property
    def metadata(self) -> Mapping[str, Any]:
        """About the sweep: scenario, method, seeds, variables with their units, versions."""
        return dict(json.loads((self.table.schema.metadata or {})[_FACTS]))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        return {field.name: _said(field, b"unit") for field in self.table.schema}

    @property
    def axes(self) -> list[str]:
        """Columns of what was varied."""
        return [f.name for f in self.table.schema if _said(f, b"role") == "variable"]

    @property
    def figures(self) -> list[str]:
        """Columns of the figures of merit."""
        return [f.name for f in self.table.schema if _said(f, b"role") == "figure"]

    @property
    def judge(self) -> str | None:
        """Figure that tells the worst runs; None where no run has any."""
        wanted = [self.metadata.get("judge"), *RANKED, *self.figures]
        return next((name for name in wanted if name in self.figures), None)

    def values(self, column: str) -> FloatArray:
        """(n,) a numeric column; NaN where a run has no value."""
        chunked = self.table.column(column).cast(pa.float64())
        return np.asarray(chunked.to_numpy(zero_copy_only=False), dtype=float)

    @cached_property
    def failed(self) -> list[tuple[int, str, str]]:
        """Number, status and error of each run that is not `ok`."""
        names = ("run", "status", "error")
        columns = [self.table.column(name).to_pylist() for name in names]
        return [row for row in zip(*columns, strict=True) if row[1] != "ok"]

    def worst(self, count: int) -> list[dict[str, Any]]:
        """Rows of the runs that the judging figure is worst of, the worst first."""
        if self.judge is None:
            return []
        values = self.values(self.judge)
        order = np.argsort(values if larger_is_better(self.judge) else -values, kind="stable")
        chosen = [int(k) for k in order if np.isfinite(values[k])][:count]
        return list(self.table.take(chosen).to_pylist())

    @cached_property
    def summary(self) -> Mapping[str, Summary]:
        """Median, mean with its interval, least and largest value of each figure."""
        from harness.sweep.statistics import summary_of

        return {name: summary_of(self.values(name)) for name in self.figures}

    def influences(self, figure: str) -> list[Influence]:
        """Return how much each variable has to do with a figure, the most influential first."""
        from harness.sweep.statistics import influences_of

        named = {
            axis: self.values(axis)
            if pa.types.is_floating(self.table.schema.field(axis).type)
            else np.array(self.table.column(axis).to_pylist(), dtype=object)
            for axis in self.axes
        }
        levels = self.metadata["method"] == "grid"
        return influences_of(self.values(figure), named, levels)


def larger_is_better(figure: str) -> bool:
    """Return whether a large value of a figure is good."""
    return "reduction" in figure or figure.endswith("_inside")


def read(path: str | os.PathLike[str]) -> SweepResult:
    """Read a sweep back, also one that was cut off.

    Args:
        path: its folder, or a file in it.

    Raises:
        SteadytipError: there is none.
    """
    folder = Path(path)
    folder = folder.parent if folder.is_file() else folder
    found = SweepResult(folder)
    if not found.file.exists():
        raise SteadytipError(f"{folder} holds no sweep: neither {PARQUET} nor {JOURNAL}")
    return found


def write_parquet(folder: Path, metadata: Mapping[str, Any]) -> Path:
    """Turn the journal of a folder into a Parquet file, all at once or not at all.

    Raises:
        RecordError: the disk does not take it; the journal is as it was.
    """
    target = folder / PARQUET
    schema, batches = _batches(folder / JOURNAL, metadata)
    try:
        with replacing(target) as part, parquet.ParquetWriter(part, schema) as writer:
            for batch in batches:
                writer.write_batch(batch)
    except OSError as error:
        raise RecordError(
            f"{target}: {reason(error)}. All rows are in {folder / JOURNAL}; make room and give "
            "the same command again."
        ) from None
    return target


def _batches(
    journal: Path, metadata: Mapping[str, Any] | None
) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    own, figures, places = contents(journal)
    schema = _schema(own if metadata is None else metadata, figures)

    def batches() -> Iterator[pa.RecordBatch]:
        lines = rows(journal, places)
        while some := [_flat(line) for line in islice(lines, _ROWS)]:
            columns = [pa.array([row.get(f.name) for row in some], f.type) for f in schema]
            yield pa.RecordBatch.from_arrays(columns, schema=schema)

    return schema, batches()


def _flat(line: Mapping[str, Any]) -> dict[str, Any]:
    return {**line, **line["drawn"], **line["metrics"]}


def _schema(metadata: Mapping[str, Any], figures: Mapping[str, Mapping[str, str]]) -> pa.Schema:
    def field(name: str, kind: pa.DataType, unit: str = "", **more: str) -> pa.Field:
        return pa.field(name, kind, metadata={"unit": unit, **more})

    fields = [
        field("run", pa.int32(), description="number of the run"),
        field("seed", pa.int64(), description="seed of the scenario"),
    ]
    for name, about in metadata["variables"].items():
        kind = pa.float64() if about["numeric"] else pa.string()
        fields.append(field(name, kind, about["unit"], role="variable"))
    for name, about in figures.items():
        fields.append(
            field(
                name,
                pa.float64(),
                about["unit"],
                role="figure",
                description=about["definition"],
            )
        )
    fields += [
        field("wall", pa.float64(), "s", description="time that the run took"),
        field("cpu", pa.float64(), "s", description="processor time of the worker meanwhile"),
        field("status", pa.string(), description="ok, failed, or lost with its worker"),
        field("error", pa.string(), description="why it is not ok"),
        field("command", pa.string(), description="runs it again, alone"),
    ]
    return pa.schema(fields, metadata={_FACTS: json.dumps(dict(metadata))})


def numeric(values: Sequence[Any]) -> bool:
    """Return whether all values are numbers."""
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def _said(field: pa.Field, key: bytes) -> str:
    return (field.metadata or {}).get(key, b"").decode()
