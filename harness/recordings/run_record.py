"""Read the record of a run: a Parquet file, or the Arrow stream of a run that did not finish."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from fmu_src.errors import SteadytipError
from harness.common.types import PortType

STREAM, PARQUET, CSV = "results.arrows", "results.parquet", "results.csv"
METRICS, REPORT = "metrics.json", "report.html"
OUTPUTS = (STREAM, PARQUET, CSV, METRICS, REPORT)
METADATA_KEY = b"steadytip"
ARROW_TYPES: Mapping[PortType, pa.DataType] = {
    "Real": pa.float64(),
    "Integer": pa.int32(),
    "Boolean": pa.bool_(),
}
_NUMPY: Mapping[PortType, type] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}


def read_batches(stream: Path) -> Iterator[pa.RecordBatch]:
    """Yield the complete chunks of a stream; a chunk that was cut off ends it."""
    with pa.OSFile(str(stream), "rb") as source, pa.ipc.open_stream(source) as reader:
        while True:
            try:
                yield reader.read_next_batch()
            except (StopIteration, pa.ArrowInvalid, OSError):
                return


def record_file(path: Path) -> Path:
    """Return the record in a run's folder, finished or not; return a file as it is.

    Of a folder that holds the numbered folders of runs, it is the record of the newest.

    Raises:
        SteadytipError: there is no record.
    """
    folders = [path]
    if path.is_dir():
        folders += sorted((p for p in path.iterdir() if p.name.isdecimal()), key=_number)[::-1]
    files = (folder / name for folder in folders for name in (PARQUET, STREAM))
    candidates = files if path.is_dir() else [path]
    for file in candidates:
        if file.is_file():
            return file
    raise SteadytipError(
        f"{path} holds no record: neither {PARQUET} nor {STREAM}"
        if path.is_dir()
        else f"{path} does not exist"
    )


def _number(folder: Path) -> int:
    return int(folder.name)


def is_finished(file: Path) -> bool:
    """Return True if a record does not grow any more."""
    return file.suffix == Path(PARQUET).suffix


def read_record(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a record of either format.

    Args:
        file: the record.
        columns: only these; all by default.

    Raises:
        SteadytipError: the file is not a record.
    """
    try:
        if is_finished(file):
            # Not `parquet.read_table`: it looks for data sets of many files, and loads Pandas.
            with parquet.ParquetFile(file) as opened:
                return opened.read(columns)
        table = pa.Table.from_batches(read_batches(file), read_schema(file))
        return table if columns is None else table.select(columns)
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"{file} is not a record of a run: {error}") from None


def read_schema(file: Path) -> pa.Schema:
    """Read names, types and units of a record's columns, and the run's metadata.

    Raises:
        SteadytipError: the file is not a record.
    """
    try:
        if is_finished(file):
            with parquet.ParquetFile(file) as opened:
                return opened.schema_arrow
        with pa.OSFile(str(file), "rb") as source:
            return pa.ipc.open_stream(source).schema
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"{file} is not a record of a run: {error}") from None


def values_of(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return the values of a column, (n,); `to_numpy` would load Pandas."""
    kind = next((k for k, arrow in ARROW_TYPES.items() if arrow == column.type), None)
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


def read_metadata(schema: pa.Schema) -> dict[str, Any]:
    """Return the JSON object about the run; empty if the schema is not of a run's record."""
    metadata = schema.metadata or {}
    return dict(json.loads(metadata.get(METADATA_KEY, b"{}")))
