"""Signals and figures of a run in the forms that notebooks work with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.quantities import format_quantity
from harness.recordings.findings import Finding
from harness.results.signals import RecordedSignals

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import pyarrow as pa
    import xarray as xr

    from harness.results.metrics import Metric

__all__ = ["Metrics", "UnknownMetricError", "html", "plot", "to_pandas", "to_xarray"]


class RecordedRun(RecordedSignals, Protocol):
    """A run, as a notebook sees it: see `Result`, which is one."""

    @property
    def file(self) -> Path:
        """The record."""

    @property
    def table(self) -> pa.Table:
        """Table of all signals."""

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""

    @property
    def error(self) -> str | None:
        """Reason why the run ended early; None if it did not."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about its recordings."""

    @property
    def metrics(self) -> Metrics:
        """Figures of merit by name."""


POINTS = 20_000
"""Points of a curve; more are thinned to the least and the largest value of each piece."""


class UnknownMetricError(SteadytipError, KeyError):
    """No figure of merit has that name."""

    def __str__(self) -> str:
        return str(self.args[0])


class Metrics(Mapping[str, "Metric"]):
    """Figures of merit by name; an unknown name is answered with the nearest one."""

    def __init__(self, values: Mapping[str, Metric]) -> None:
        """Take the figures over."""
        self._values = dict(values)

    def __getitem__(self, name: str) -> Metric:
        if name not in self._values:
            hint = nearest(name, self._values) if self._values else "this run has none"
            raise UnknownMetricError(f"no figure of merit is called '{name}'; {hint}")
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        rows = (f"{n}: {' '.join(format_quantity(m.value, m.unit))}" for n, m in self.items())
        return "\n".join(row.strip() for row in rows)

    def _repr_html_(self) -> str:
        return _figures(self)


def to_pandas(result: RecordedRun) -> pd.DataFrame:
    """Return all signals as a table whose index is the time [s]; units are in `attrs`.

    Raises:
        SteadytipError: pandas is not installed.
    """
    _need("pandas")
    frame = result.table.to_pandas().set_index("time")
    frame.index.name = "time [s]"
    frame.attrs["units"] = {k: v for k, v in result.units.items() if k != "time"}
    return frame


def to_xarray(result: RecordedRun) -> xr.Dataset:
    """Return all signals over the coordinate `time` [s], each with `units` in its attributes.

    Raises:
        SteadytipError: xarray is not installed.
    """
    _need("xarray")
    import xarray as xr

    units, names = result.units, [name for name in result.columns if name != "time"]
    data = {name: ("time", result.signals(name), {"units": units[name]}) for name in names}
    time = ("time", result.time, {"units": "s"})
    about = {"scenario": result.metadata.scenario, "seed": result.metadata.seed}
    return xr.Dataset(data, {"time": time}, about)


def plot(result: RecordedRun, *names: str) -> go.Figure:
    """Draw signals over time, a panel for each unit.

    Args:
        result: the run.
        names: of signals, or patterns with `*` and `?`; by default those of the tip.

    Raises:
        SteadytipError: nothing is called so.
    """
    from plotly.subplots import make_subplots

    found = list(_named(result, names))
    units = list(dict.fromkeys(result.units[name] for name in found))
    titles = [f"[{unit}]" if unit else "" for unit in units]
    figure = make_subplots(len(units), 1, shared_xaxes=True, vertical_spacing=0.06)
    for name in found:
        time, values = _thinned(result.time, result.signals(name))
        figure.add_scatter(
            x=time,
            y=values,
            name=name,
            mode="lines",
            row=1 + units.index(result.units[name]),
            col=1,
        )
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(units), col=1)
    return figure.update_layout(template="plotly_white", height=160 + 260 * len(units))


def html(result: RecordedRun) -> str:
    """Return a table of the figures, with findings and notes, for a notebook."""
    metadata = result.metadata
    head = escape(metadata.title or metadata.scenario)
    parts = [f"<p><b>{head}</b>, {len(result.time)} samples</p>"]
    if result.error:
        parts.append(f"<p>The run ended early: {escape(result.error)}</p>")
    parts.append(_figures(result.metrics))
    lines = [*(finding.sentence for finding in result.findings), *metadata.notes]
    parts += [f"<p>{escape(line)}</p>" for line in lines]
    return "".join(parts)


def _figures(metrics: Mapping[str, Metric]) -> str:
    rows = [
        f'<tr title="{escape(metric.definition)}"><td>{escape(name)}</td>'
        f"<td>{' '.join(format_quantity(metric.value, metric.unit))}</td></tr>"
        for name, metric in metrics.items()
    ]
    return f"<table>{''.join(rows)}</table>"


def _named(result: RecordedRun, names: tuple[str, ...]) -> Iterator[str]:
    from harness.common.patterns import matching

    roles = result.metadata.roles
    wanted = names or (*roles.get("tip_uncompensated", ()), *roles.get("tip", ()))
    for name in wanted or ("*",):
        columns = [column for column in result.columns if column != "time"]
        found = matching(columns, name)
        if not found:
            raise SteadytipError(f"{result.file} has no signal '{name}'; {nearest(name, columns)}")
        yield from found


def _thinned(time: Any, values: Any) -> tuple[Any, Any]:
    pieces = len(time) // (POINTS // 2)
    if pieces < 2:
        return time, values
    whole = len(time) // pieces * pieces
    folded = values[:whole].reshape(-1, pieces)
    first = np.arange(0, whole, pieces)
    chosen = np.sort(np.concatenate([first + folded.argmin(1), first + folded.argmax(1)]))
    return time[chosen], values[chosen]


def _need(module: str) -> None:
    from importlib.util import find_spec

    if find_spec(module) is None:
        raise SteadytipError(
            f"{module} is not installed: pip install 'steadytip[notebook]' brings it"
        )
