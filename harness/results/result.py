"""What comes out of a run: signals, metrics, files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.files import replacing
from harness.common.patterns import matching
from harness.recordings.findings import Finding
from harness.recordings.run_record import (
    METRICS,
    REPORT,
    is_finished,
    read_metadata,
    read_record,
    read_schema,
    record_file,
    values_of,
)
from harness.results import notebook
from harness.results.notebook import Metrics
from harness.results.run_metadata import RunMetadata

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import pyarrow as pa
    import xarray as xr

    from harness.common.types import FloatArray
    from harness.results.consistency import Consistency

__all__ = ["Result", "read"]


class Result:
    """A run, read from its files.

    Attributes:
        file: the record, Parquet or (of a run that did not finish) an Arrow stream.
        path: the folder it is in.
    """

    def __init__(self, file: Path) -> None:
        """Refer to a record; of its signals, those are read that are asked for."""
        self.file = file
        self.path = file.parent

    @cached_property
    def table(self) -> pa.Table:
        """Signals: `time` and `part.port`, units in the fields' metadata."""
        return read_record(self.file)

    @cached_property
    def _schema(self) -> pa.Schema:
        return read_schema(self.file)

    @cached_property
    def metadata(self) -> RunMetadata:
        """About the run: scenario, roles, parts with their FMUs, seeds, versions, how it ended."""
        return RunMetadata.read(read_metadata(self._schema), str(self.file))

    @property
    def error(self) -> str | None:
        """Reason why the run ended early; None if it did not, or if the process was killed."""
        return self.metadata.error

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the recordings that the run used."""
        found = self.metadata.findings
        return tuple(Finding(**{k: v for k, v in each.items() if k != "part"}) for each in found)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        return {
            field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in self._schema
        }

    @cached_property
    def time(self) -> FloatArray:
        """(n,) instants of the samples [s]."""
        return self._columns(["time"])[:, 0]

    @property
    def columns(self) -> Sequence[str]:
        """Names of all columns."""
        return list(self._schema.names)

    def signals(self, name: str) -> FloatArray:
        """Signals by name.

        Args:
            name: `part.port` for one signal; with `*` or `?` for several.

        Returns:
            (n,), or (n, columns) for a pattern.

        Raises:
            SteadytipError: nothing is called so.
        """
        columns = self._schema.names
        names = matching(columns, name)
        if not names:
            raise SteadytipError(f"{self.file} has no signal '{name}'; {nearest(name, columns)}")
        values = self._columns(names)
        return values if set(name) & set("*?") else values[:, 0]

    def role(self, role: str) -> FloatArray | None:
        """(n, columns) signals that play a role of the scenario's `signals`; None without one."""
        names = self.metadata.roles.get(role)
        return self._columns(names) if names else None

    def _columns(self, names: Sequence[str]) -> FloatArray:
        # A record that still grows is read once: all signals are of the same ticks.
        table = read_record(self.file, names) if is_finished(self.file) else self.table
        values = np.empty((len(table), len(names)))
        for k, name in enumerate(names):
            values[:, k] = values_of(table.column(name))
        return values

    @cached_property
    def metrics(self) -> Metrics:
        """Figures of merit by name: of `metrics`, `can_feed` and `consistency`."""
        from harness.results.can_feed import figures_of
        from harness.results.metrics import metrics_of_result

        found = metrics_of_result(self) | figures_of(self)
        stated = {k: v for each in self.consistency for k, v in each.metrics().items()}
        return Metrics(found | stated)

    @cached_property
    def consistency(self) -> Sequence[Consistency]:
        """Errors of estimators beside those they state; see `harness.results.consistency`."""
        from harness.results.consistency import consistency_of

        return consistency_of(self)

    def to_pandas(self) -> pd.DataFrame:
        """Signals as a table whose index is the time; see `notebook.to_pandas`."""
        return notebook.to_pandas(self)

    def to_xarray(self) -> xr.Dataset:
        """Signals over the coordinate `time`; see `notebook.to_xarray`."""
        return notebook.to_xarray(self)

    def plot(self, *names: str) -> go.Figure:
        """Figure of signals over time, by name or pattern; see `notebook.plot`."""
        return notebook.plot(self, *names)

    def _repr_html_(self) -> str:
        return notebook.html(self)

    @property
    def report(self) -> Path:
        """Path of the report, if one was written."""
        return self.path / REPORT

    def write_metrics(self) -> Path:
        """Write `metrics.json`: `{name: {"value", "unit", "definition"}}`."""
        target = self.path / METRICS
        values = {
            name: {"value": m.value, "unit": m.unit, "definition": m.definition}
            for name, m in self.metrics.items()
        }
        with replacing(target) as part:
            part.write_text(json.dumps(values, indent=2, ensure_ascii=False) + "\n", "utf-8")
        return target


def read(path: str | os.PathLike[str]) -> Result:
    """Read a run back, also one whose process was killed.

    Args:
        path: folder of the run, or its `results.parquet` or `results.arrows`; or the folder of all
            runs of a name, for the newest of them.

    Raises:
        SteadytipError: there is no record.
    """
    return Result(record_file(Path(path)))
