"""Results of a calibration: tables for the terminal, and the page beside the parameter file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from fmu_src.device import design
from harness.identify.imu.fit import CONFIDENCE, Calibration
from harness.identify.page import write_topic_page
from harness.recordings.turntable import ACCELEROMETERS, MAGNETOMETERS
from harness.report.page import Plot, Section, Table
from harness.report.plots import SERIES, layout

__all__ = ["parameter_table", "residual_table", "write_page"]

_MG = 1e-3 * design.STANDARD_GRAVITY


def parameter_table(found: Calibration) -> Table:
    """Tabulate each parameter with its interval."""
    rows = []
    for one in found.found:
        half = "" if np.isnan(one.half) else f"{one.half:.2g}"
        unit = one.scalar.field.unit or ""
        rows.append((one.scalar.name, f"{one.value:.6g}", half, unit))
    columns = ("parameter", "value", f"± ({100 * CONFIDENCE:.0f} %)", "unit")
    return Table(columns, tuple(rows), frozenset({1, 2}))


def residual_table(found: Calibration) -> Table:
    """Tabulate the residual of each channel."""
    rows = []
    for i, name in enumerate(ACCELEROMETERS):
        left = found.residual[:, i] / _MG
        rows.append((name, f"{np.std(left):.3g}", f"{np.abs(left).max():.3g}", "mg"))
    if found.field_residual is not None:
        for i, name in enumerate(MAGNETOMETERS):
            left = found.field_residual[:, i] / design.MAGNETIC_FIELD * 1e3
            rows.append(
                (name, f"{np.std(left):.3g}", f"{np.abs(left).max():.3g}", "‰ of the field")
            )
    return Table(("left of", "rms", "largest", "unit"), tuple(rows), frozenset({1, 2}))


def _table_errors(found: Calibration) -> Table:
    rows = [
        (name, f"{np.degrees(value):.3g}", f"{np.degrees(half):.2g}")
        for name, (value, half) in found.table.items()
    ]
    if np.isfinite(found.inclination):
        rows.append(("inclination of the field", f"{np.degrees(found.inclination):.4g}", ""))
    columns = ("of the turntable", "deg", f"± ({100 * CONFIDENCE:.0f} %)")
    return Table(columns, tuple(rows), frozenset({1, 2}))


def write_page(path: Path, recordings: Sequence[Path], found: Calibration) -> Path:
    """Write the page.

    Raises:
        SteadytipError: the file cannot be written.
    """
    names = ", ".join(one.name for one in recordings)
    text = (
        f"{len(found.positions)} rests on a two-axis turntable. The residual is what the "
        "compensation makes of the volts, less what the channel's axis feels at the turntable's "
        "angles; one that goes along with an angle is a form that the model does not have.",
        *(f"Note: {note}." for note in (*found.positions.notes, *found.notes)),
    )
    tables = (residual_table(found), _table_errors(found), parameter_table(found))
    return write_topic_page(
        path,
        "Sensors calibrated",
        f"measurement model of A04 3.2, from {names}",
        (),
        [Section("Rests", text, tables, (_residuals(found),))],
        "casadi",
    )


def _residuals(found: Calibration) -> Plot:
    figure = go.Figure()
    for i, name in enumerate(ACCELEROMETERS):
        figure.add_trace(
            go.Scatter(
                x=np.arange(1, len(found.positions) + 1),
                y=found.residual[:, i] / _MG,
                name=name,
                mode="markers",
                marker={"color": SERIES[i], "size": 4},
                text=[
                    f"α {np.degrees(a):.4g}°, β {np.degrees(b):.4g}°"
                    for a, b in zip(found.positions.alpha, found.positions.beta, strict=True)
                ],
            )
        )
    figure.update_xaxes(title_text="rest")
    figure.update_yaxes(title_text="residual, mg")
    return Plot("Residual", "Of each accelerometer channel, in order.", layout(figure, 380))
