"""Outputs of a part as another run recorded them.

    [part.sensors]
    recorded = "build/runs/closed_loop/0001/results.parquet"
    of       = "sensors"        # if left out, the part's own name

The ports are the recorded columns of that part, with their types and units; tick k puts out row k.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import FaultError, nearest
from harness.common.types import PortType
from harness.parts.ports import Port, unit_of
from harness.parts.protocols import RunContext, Settings
from harness.parts.rows import RowsPart
from harness.parts.settings import RecordedSettings, check_settings
from harness.recordings.run_record import read_record, read_schema, values_of

_TYPES: Mapping[str, PortType] = {"int32": "Integer", "bool": "Boolean"}


class RecordedPart(RowsPart):
    """Plays columns of a record."""

    def __init__(self, name: str, settings: Settings, seed: int) -> None:
        """Read the record.

        Raises:
            ProblemsError: a setting that there is not.
            SteadytipError: the record cannot be read, or has no such part.
        """
        self.name = name
        keys = check_settings(RecordedSettings, name, settings)
        self._path = Path(keys.recorded)
        schema, of = read_schema(self._path), keys.of or name
        fields = [field for field in schema if field.name.startswith(f"{of}.")]
        if "time" not in schema.names or not fields:
            parts = {n.rpartition(".")[0] for n in schema.names if "." in n}
            raise SteadytipError(f"{self._path} has no signals of '{of}'; {nearest(of, parts)}")
        table = read_record(self._path, ["time", *(field.name for field in fields)])
        if len(table) == 0:
            raise SteadytipError(f"{self._path} is empty")
        self.outputs: Sequence[Port] = [
            Port(
                field.name[len(of) + 1 :],
                _TYPES.get(str(field.type), "Real"),
                unit_of((field.metadata or {}).get(b"unit", b"").decode() or "1"),
                (field.metadata or {}).get(b"description", b"").decode(),
            )
            for field in fields
        ]
        self.rows = np.column_stack(
            [values_of(table.column(field.name)).astype(float) for field in fields]
        )
        self._time = values_of(table.column("time"))
        step = self._time[1] - self._time[0] if len(self._time) > 1 else np.inf
        self.seconds = float(len(self._time) * step)

    def evaluate(self, run: RunContext) -> None:
        """Check that the record has the step of the run; see `RowsPart.evaluate`."""
        wanted = np.arange(len(self._time)) * run.step
        if not np.allclose(self._time, wanted, rtol=0.0, atol=run.step / 10):
            raise FaultError(
                f"{self._path} has another step than {run.step:g} s, or gaps in its time"
            )

    def metadata(self) -> dict[str, Any]:
        """File and length."""
        return {"kind": "recorded", "file": self._path.name, "seconds": self.seconds}
