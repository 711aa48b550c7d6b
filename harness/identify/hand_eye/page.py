"""Results of a hand-eye rotation: table for the terminal, page beside the parameter file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from harness.common.types import FloatArray
from harness.identify.hand_eye.fit import HandEye
from harness.identify.hand_eye.read import TrackedMotion
from harness.identify.page import write_topic_page
from harness.report.page import Plot, Section, Table
from harness.report.plots import SERIES, layout, line

__all__ = ["result_table", "write_page"]


def result_table(found: HandEye) -> Table:
    """Tabulate rotations, bias, lag and residual with their intervals."""
    degrees = np.degrees
    rows = []

    def add(name: str, values: FloatArray, sigma: FloatArray, unit: str) -> None:
        axes = ("",) if len(values) == 1 else (" x", " y", " z")
        for axis, value, half in zip(axes, values, found.factor * sigma, strict=True):
            rows.append((name + axis, f"{value:.4f}", f"{half:.4f}", unit))

    add("hand-eye rotation h", degrees(found.mounting.as_rotvec()),
        degrees(found.mounting_sigma), "deg")  # fmt: skip
    if found.registration is not None and found.registration_sigma is not None:
        add("registration r", degrees(found.registration.as_rotvec()),
            degrees(found.registration_sigma), "deg")  # fmt: skip
    add("bias of the gyro", degrees(found.bias), degrees(found.bias_sigma), "deg/s")
    add("lag of the gyro", np.array([1e3 * found.lag]), np.array([1e3 * found.lag_sigma]), "ms")
    left = degrees(np.sqrt(np.mean(found.residual**2, axis=0)))
    rows += [
        (f"left of the fit {a}", f"{v:.4f}", "", "deg") for a, v in zip("xyz", left, strict=True)
    ]
    return Table(("quantity", "value", "± (95 %)", "unit"), tuple(rows), frozenset({1, 2}))


def write_page(path: Path, recorded: TrackedMotion, found: HandEye) -> Path:
    """Write the page beside the parameter file.

    Raises:
        SteadytipError: the file cannot be written.
    """
    plot = go.Figure()
    for axis, colour, values in zip("xyz", SERIES, found.residual.T, strict=False):
        plot.add_trace(line(found.time, np.degrees(values), colour, axis))
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="deg")
    residual = Plot(
        "What the fit leaves",
        "Rotation vectors from the predicted to the measured attitude of the coils, in their "
        "frame. What is slow in them is distortion, or scale of the gyro.",
        layout(plot, 380),
    )
    text = f"{len(found.time)} attitudes in {recorded.time[-1] - recorded.time[0]:.4g} s."
    return write_topic_page(
        path,
        "Hand-eye rotation",
        recorded.path.name,
        ("Rotation from the inertial unit to the tracker's coils, RK III.B.",),
        [Section("Fit", (text,), (result_table(found),), (residual,))],
    )
