"""What a run leaves on the disk.

While it runs, chunks of ticks go to `results.arrows`, an Arrow IPC stream that can be read up to
its last chunk whatever becomes of the process. At the end they become `results.parquet` (and a CSV
file on demand) and the stream is removed. Columns are `time` [s] and `part.port`; each field
carries its unit and description, the schema a JSON object about the run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv, parquet

from harness.behind import BehindFile, write_all
from harness.errors import RecordError, SteadytipError
from harness.parts import FloatArray, PortType

__all__ = [
    "CHUNK",
    "METRICS",
    "REPORT",
    "Column",
    "Recorder",
    "is_finished",
    "read_facts",
    "read_schema",
    "read_table",
    "reason",
    "record_file",
    "replacing",
    "values_of",
    "write_text",
]

STREAM, PARQUET, CSV = "results.arrows", "results.parquet", "results.csv"
METRICS, REPORT = "metrics.json", "report.html"
OUTPUTS = (STREAM, PARQUET, CSV, METRICS, REPORT)
CHUNK = 1000
"""Ticks per chunk of the stream: what a killed process loses at most."""

_GROUP = 20 * CHUNK
"""Ticks per row group of the Parquet file; small ones take three times as long."""
_WORTHWHILE = 50  # ticks
_END = b"\xff\xff\xff\xff\0\0\0\0"  # of an Arrow IPC stream

_FACTS = b"steadytip"
_ARROW: Mapping[PortType, pa.DataType] = {
    "Real": pa.float64(),
    "Integer": pa.int32(),
    "Boolean": pa.bool_(),
}


_NUMPY: Mapping[PortType, type] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}


@dataclass(frozen=True)
class Column:
    """One recorded signal; see `harness.parts.Port`."""

    name: str
    type: PortType
    unit: str
    description: str


class Recorder:
    """Takes the signals of every tick and writes them in chunks."""

    def __init__(
        self,
        folder: Path,
        columns: Sequence[Column],
        step: float,
        facts: Mapping[str, Any],
        patient: bool = True,
    ) -> None:
        """Clear the folder of an earlier run's files and open the stream.

        Args:
            folder: made if it does not exist.
            columns: of the signals, in their order.
            step: period of the ticks [s].
            facts: about the run, JSON types only.
            patient: whether the caller may be made to wait for a disk that is busy.

        Raises:
            RecordError: the folder cannot be written to.
        """
        self.folder = folder
        self.ticks = 0
        self._columns = columns
        self._step = step
        self._schema = _schema(columns, facts)
        self._chunk = np.empty((CHUNK, len(columns)))
        self._filled = 0
        self._broken = False
        self._closed = False
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in OUTPUTS:
                (folder / name).unlink(missing_ok=True)
            path = self.stream
            self._file = path.open("wb", buffering=0) if patient else BehindFile(path)
            write_all(self._file, self._schema.serialize())
            # The first chunk costs some milliseconds more than others: not during the run.
            write_all(self._file, self._batch(0).serialize())
        except OSError as error:
            raise RecordError(f"cannot record to {folder}: {reason(error)}") from None

    @property
    def stream(self) -> Path:
        """The file that chunks go to."""
        return self.folder / STREAM

    def append(self, signals: FloatArray) -> None:
        """Record one tick, (len(columns),).

        Raises:
            RecordError: the disk does not take another chunk.
        """
        self._chunk[self._filled] = signals
        self.took(1)

    def room(self) -> FloatArray:
        """Where rows of signals may be written, (n, len(columns)), n > 0; say then `took`."""
        return self._chunk[self._filled :]

    def took(self, rows: int) -> None:
        """Record the first rows of `room`.

        Raises:
            RecordError: the disk does not take another chunk.
        """
        self._filled += rows
        if self._filled == CHUNK:
            self.flush()

    def relieve(self) -> None:
        """Write what is held back if that is worth the while; for whoever has time now.

        Raises:
            RecordError: the disk does not take it.
        """
        if self._filled >= _WORTHWHILE:
            self.flush()

    def flush(self) -> None:
        """Write what is held back.

        Raises:
            RecordError: the disk does not take it.
        """
        if not self._filled or self._broken:
            return
        batch = self._batch(self._filled)
        try:
            write_all(self._file, batch.serialize())
        except OSError as error:
            self._broken = True
            raise RecordError(
                f"{self.stream}: {reason(error)} while writing "
                f"{batch.nbytes / 1e6:.3g} MB. The {self.ticks * self._step:g} s recorded before "
                "are in that file; 'harness.read' reads it. Make room, or choose another folder."
            ) from None
        self.ticks += self._filled
        self._filled = 0

    def _batch(self, n: int) -> pa.RecordBatch:
        """The first ticks of those that are held back."""
        times = np.arange(self.ticks, self.ticks + n) * self._step
        values = np.ascontiguousarray(self._chunk[:n].T)
        # Buffers as they are: a conversion of each column takes ten times as long.
        buffer, width = pa.py_buffer(values), n * values.itemsize
        # Nor `pa.array`, which loads Pandas where there is one, for half a second.
        arrays = [pa.Array.from_buffers(_ARROW["Real"], n, [None, pa.py_buffer(times)])]
        for index, column in enumerate(self._columns):
            held = buffer.slice(index * width, width)
            if column.type == "Integer":
                held = pa.py_buffer(values[index].astype(np.int32))
            elif column.type == "Boolean":
                held = pa.py_buffer(np.packbits(values[index] != 0.0, bitorder="little"))
            arrays.append(pa.Array.from_buffers(_ARROW[column.type], n, [None, held]))
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema)

    def finish(
        self, facts: Mapping[str, Any], as_csv: bool = False, beside: pa.Table | None = None
    ) -> Path:
        """Close the stream and turn it into Parquet.

        Args:
            facts: about the run, now that it is over.
            as_csv: write a CSV file beside it.
            beside: more columns, a row for each tick.

        Returns:
            The file that holds the record.

        Raises:
            RecordError: the disk does not take a file; the record is in the one written before.
        """
        self.close()
        if self._broken:
            return self.stream
        target = self.folder / PARQUET
        schema = _schema(self._columns, facts)
        for field in beside.schema if beside is not None else ():
            schema = schema.append(field)
        try:
            # Measured values hardly repeat: looking for those that do takes longer than writing.
            writing = partial(parquet.ParquetWriter, schema=schema, use_dictionary=False)
            with replacing(target) as part, writing(part) as writer:
                for table in self._widened(beside):
                    writer.write_table(table.cast(schema))
        except OSError as error:
            size = self.stream.stat().st_size / 1e6
            raise RecordError(
                f"{target}: {reason(error)}; about {size:.3g} MB are needed. All "
                f"{self.ticks * self._step:g} s are in {self.stream}; 'harness.read' reads it."
            ) from None
        try:
            if as_csv:
                _write_csv(self.folder / CSV, self._widened(beside), schema)
        except OSError as error:
            raise RecordError(
                f"{self.folder / CSV}: {reason(error)}. The record is complete in {target}."
            ) from None
        finally:
            self.stream.unlink()
        return target

    def _widened(self, beside: pa.Table | None) -> Iterator[pa.Table]:
        """The stream's chunks in larger ones, with more columns."""
        done = 0
        for batches in _grouped(_batches(self.stream), _GROUP):
            table = pa.Table.from_batches(batches)
            if beside is not None:
                for name, column in zip(
                    beside.column_names, beside.slice(done, len(table)).columns, strict=True
                ):
                    table = table.append_column(name, column)
            done += len(table)
            yield table

    def discard(self) -> None:
        """Leave no file of a run that never reached its first tick."""
        self.close()
        self.stream.unlink()

    def close(self) -> None:
        """Write what is held back, if the disk takes it, and close the stream, once."""
        if self._closed:
            return
        self._closed = True
        with suppress(RecordError):
            self.flush()
        with suppress(OSError):
            write_all(self._file, _END)
        with suppress(OSError):
            self._file.close()


class replacing:  # noqa: N801 - reads as a verb in `with`
    """A name to write to: becomes the target when all went well, and vanishes otherwise."""

    def __init__(self, target: Path) -> None:
        self._target = target
        self._part = target.with_name(f"{target.name}.part")

    def __enter__(self) -> Path:
        return self._part

    def __exit__(self, kind: object, error: BaseException | None, _trace: object) -> None:
        if error is None:
            self._part.replace(self._target)
            return
        self._part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(self._target)  # a failing write does not know where it was


def write_text(path: Path, text: str) -> Path:
    """Write a file that the user asked for, and its folder, all at once or not at all.

    Raises:
        SteadytipError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
    return path


def reason(error: OSError) -> str:
    """What the system says; Arrow wraps it into words of its own."""
    return os.strerror(error.errno) if error.errno else str(error)


def _schema(columns: Sequence[Column], facts: Mapping[str, Any]) -> pa.Schema:
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s", "description": "time"})]
    fields += [
        pa.field(c.name, _ARROW[c.type], metadata={"unit": c.unit, "description": c.description})
        for c in columns
    ]
    return pa.schema(fields, metadata={_FACTS: json.dumps(dict(facts))})


def _batches(stream: Path) -> Iterator[pa.RecordBatch]:
    """Whole chunks of a stream; a chunk that was cut off ends it."""
    with pa.OSFile(str(stream), "rb") as source, pa.ipc.open_stream(source) as reader:
        while True:
            try:
                yield reader.read_next_batch()
            except (StopIteration, pa.ArrowInvalid, OSError):
                return


def _grouped(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[list[pa.RecordBatch]]:
    """Chunks put together until they have so many rows."""
    group: list[pa.RecordBatch] = []
    for batch in batches:
        group.append(batch)
        if sum(len(b) for b in group) >= rows:
            yield group
            group = []
    if group:
        yield group


def _write_csv(target: Path, tables: Iterator[pa.Table], schema: pa.Schema) -> None:
    """Header `name [unit]`, full precision."""
    units = [field.metadata[b"unit"].decode() for field in schema]
    names = [f"{n} [{u}]" if u else n for n, u in zip(schema.names, units, strict=True)]
    plain = pa.schema([pa.field(n, f.type) for n, f in zip(names, schema, strict=True)])
    with replacing(target) as part, csv.CSVWriter(part, plain) as writer:
        for table in tables:
            writer.write_table(pa.table(table.columns, schema=plain))


def record_file(path: Path) -> Path:
    """The record in a run's folder, finished or not; a file is taken as it is.

    Raises:
        SteadytipError: there is none.
    """
    candidates = [path / PARQUET, path / STREAM] if path.is_dir() else [path]
    for file in candidates:
        if file.is_file():
            return file
    raise SteadytipError(
        f"{path} holds no record: neither {PARQUET} nor {STREAM}"
        if path.is_dir()
        else f"{path} does not exist"
    )


def is_finished(file: Path) -> bool:
    """Whether a record is one that does not grow any more."""
    return file.suffix == Path(PARQUET).suffix


def read_table(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a record of either format.

    Args:
        file: the record.
        columns: only these; all by default.

    Raises:
        SteadytipError: it is not one.
    """
    try:
        if is_finished(file):
            # Not `parquet.read_table`: it looks for data sets of many files, and loads Pandas.
            with parquet.ParquetFile(file) as whole:
                return whole.read(columns)
        table = pa.Table.from_batches(_batches(file), read_schema(file))
        return table if columns is None else table.select(columns)
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"{file} is not a record of a run: {error}") from None


def read_schema(file: Path) -> pa.Schema:
    """Names, types and units of a record's columns, and about the run; see `read_facts`.

    Raises:
        SteadytipError: it is not a record.
    """
    try:
        if is_finished(file):
            with parquet.ParquetFile(file) as whole:
                return whole.schema_arrow
        with pa.OSFile(str(file), "rb") as source:
            return pa.ipc.open_stream(source).schema
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"{file} is not a record of a run: {error}") from None


def values_of(column: pa.ChunkedArray) -> NDArray[Any]:
    """(n,) values of a column without gaps; `to_numpy` would load Pandas where there is one."""
    kind = next((k for k, arrow in _ARROW.items() if arrow == column.type), None)
    if kind is None or column.null_count:
        return np.asarray(column.to_numpy())
    none: NDArray[Any] = np.empty(0, _NUMPY[kind])
    return np.concatenate([none, *(_piece(chunk, kind) for chunk in column.chunks if len(chunk))])


def _piece(chunk: pa.Array, kind: PortType) -> NDArray[Any]:
    first, last = chunk.offset, chunk.offset + len(chunk)
    if kind == "Boolean":
        bits = np.frombuffer(chunk.buffers()[1], np.uint8)
        return np.unpackbits(bits, count=last, bitorder="little")[first:].astype(bool)
    return np.frombuffer(chunk.buffers()[1], _NUMPY[kind], count=last)[first:]


def read_facts(schema: pa.Schema) -> dict[str, Any]:
    """The JSON object about the run; empty if the schema is not of a run's record."""
    metadata = schema.metadata or {}
    return dict(json.loads(metadata.get(_FACTS, b"{}")))
