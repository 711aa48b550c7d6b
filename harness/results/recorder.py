"""What a run leaves on the disk.

While it runs, chunks of ticks go to `results.arrows`, an Arrow IPC stream that can be read up to
its last chunk whatever becomes of the process. At the end they become `results.parquet` (and a CSV
file on demand) and the stream is removed. Columns are `time` [s] and `part.port`; each field
carries its unit and description, the schema a JSON object about the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from harness.common.background_writer import BackgroundFile, write_all
from harness.common.errors import RecordError
from harness.common.files import reason, replacing
from harness.common.types import FloatArray
from harness.parts.ports import Column
from harness.recordings.run_record import (
    ARROW_TYPES,
    CSV,
    METADATA_KEY,
    OUTPUTS,
    PARQUET,
    STREAM,
    read_batches,
)
from harness.results.run_metadata import RunMetadata

__all__ = ["CHUNK", "Recorder"]

CHUNK = 1000
"""Ticks per chunk of the stream: what a killed process loses at most."""

_GROUP = 20 * CHUNK
"""Ticks per row group of the Parquet file; small ones take three times as long."""
_WORTHWHILE = 50  # ticks
_END = b"\xff\xff\xff\xff\0\0\0\0"  # of an Arrow IPC stream


class Recorder:
    """Takes the signals of every tick and writes them in chunks."""

    def __init__(
        self,
        folder: Path,
        columns: Sequence[Column],
        step: float,
        metadata: RunMetadata,
        patient: bool = True,
    ) -> None:
        """Clear the folder of an earlier run's files and open the stream.

        Args:
            folder: made if it does not exist.
            columns: of the signals, in their order.
            step: period of the ticks [s].
            metadata: about the run.
            patient: whether the caller may be made to wait for a disk that is busy.

        Raises:
            RecordError: the folder cannot be written to.
        """
        self.folder = folder
        self.ticks = 0
        self._columns = columns
        self._step = step
        self._schema = _schema(columns, metadata)
        self._chunk = np.empty((CHUNK, len(columns)))
        self._filled = 0
        self._broken = False
        self._closed = False
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in OUTPUTS:
                (folder / name).unlink(missing_ok=True)
            path = self.stream
            self._file = path.open("wb", buffering=0) if patient else BackgroundFile(path)
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
        self.commit(1)

    def buffer(self) -> FloatArray:
        """Return memory for rows of signals, (n, len(columns)), n > 0; `commit` them then."""
        return self._chunk[self._filled :]

    def commit(self, rows: int) -> None:
        """Record the first rows of `buffer`.

        Raises:
            RecordError: the disk does not take another chunk.
        """
        self._filled += rows
        if self._filled == CHUNK:
            self.flush()

    def flush_idle(self) -> None:
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
                "are in that file; 'steadytip.read' reads it. Make room, or choose another folder."
            ) from None
        self.ticks += self._filled
        self._filled = 0

    def _batch(self, n: int) -> pa.RecordBatch:
        """Return the first n ticks of those that are held back."""
        times = np.arange(self.ticks, self.ticks + n) * self._step
        values = np.ascontiguousarray(self._chunk[:n].T)
        # Buffers as they are: a conversion of each column takes ten times as long.
        buffer, width = pa.py_buffer(values), n * values.itemsize
        # Nor `pa.array`, which loads Pandas where there is one, for half a second.
        arrays = [pa.Array.from_buffers(ARROW_TYPES["Real"], n, [None, pa.py_buffer(times)])]
        for index, column in enumerate(self._columns):
            held = buffer.slice(index * width, width)
            if column.type == "Integer":
                held = pa.py_buffer(values[index].astype(np.int32))
            elif column.type == "Boolean":
                held = pa.py_buffer(np.packbits(values[index] != 0.0, bitorder="little"))
            arrays.append(pa.Array.from_buffers(ARROW_TYPES[column.type], n, [None, held]))
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema)

    def finish(
        self,
        metadata: RunMetadata,
        as_csv: bool = False,
        extra_columns: pa.Table | None = None,
    ) -> Path:
        """Close the stream and turn it into Parquet.

        Args:
            metadata: about the run, now that it is over.
            as_csv: write a CSV file, too.
            extra_columns: more columns, a row for each tick.

        Returns:
            The file that holds the record.

        Raises:
            RecordError: the disk does not take a file; the record is in the one written before.
        """
        self.close()
        if self._broken:
            return self.stream
        target = self.folder / PARQUET
        schema = _schema(self._columns, metadata)
        for field in extra_columns.schema if extra_columns is not None else ():
            schema = schema.append(field)
        try:
            # Measured values hardly repeat: looking for those that do takes longer than writing.
            writing = partial(parquet.ParquetWriter, schema=schema, use_dictionary=False)
            with replacing(target) as part, writing(part) as writer:
                for table in self._widened(extra_columns):
                    writer.write_table(table.cast(schema))
        except OSError as error:
            size = self.stream.stat().st_size / 1e6
            raise RecordError(
                f"{target}: {reason(error)}; about {size:.3g} MB are needed. All "
                f"{self.ticks * self._step:g} s are in {self.stream}; 'steadytip.read' reads it."
            ) from None
        try:
            if as_csv:
                _write_csv(self.folder / CSV, self._widened(extra_columns), schema)
        except OSError as error:
            raise RecordError(
                f"{self.folder / CSV}: {reason(error)}. The record is complete in {target}."
            ) from None
        finally:
            self.stream.unlink()
        return target

    def _widened(self, extra_columns: pa.Table | None) -> Iterator[pa.Table]:
        """Yield the stream's chunks in larger ones, with more columns."""
        done = 0
        for batches in _grouped(read_batches(self.stream), _GROUP):
            table = pa.Table.from_batches(batches)
            if extra_columns is not None:
                for name, column in zip(
                    extra_columns.column_names,
                    extra_columns.slice(done, len(table)).columns,
                    strict=True,
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


def _schema(columns: Sequence[Column], metadata: RunMetadata) -> pa.Schema:
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s", "description": "time"})]
    fields += [
        pa.field(
            c.name, ARROW_TYPES[c.type], metadata={"unit": c.unit, "description": c.description}
        )
        for c in columns
    ]
    return pa.schema(fields, metadata={METADATA_KEY: metadata.json_text()})


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
