"""Results of an Allan deviation: table for the terminal, curves for the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from harness.identify.allan.fit import CONFIDENCE, TERMS, Noise
from harness.identify.page import write_topic_page
from harness.report.page import Plot, Section, Table
from harness.report.plots import GREY, SERIES, layout, line

__all__ = ["curves", "term_table", "write_page"]

SignalNoise = Mapping[str, tuple[Noise, float, str]]
"""Noise of each signal, the factor to the measured quantity, and its unit."""
_TERM_TITLES = {
    "quantisation": "quantisation Q",
    "white": "white noise N",
    "bias": "bias instability B",
    "walk": "random walk K",
    "trend": "trend R",
    "sample": "white noise, one sample",
}


def term_table(found: SignalNoise) -> Table:
    """Tabulate each term with its interval."""
    rows = []
    for name, (noise, factor, unit) in found.items():
        for key in TERMS:
            if key in noise.terms:
                term = noise.terms[key]
                rows.append(
                    (
                        name,
                        _TERM_TITLES[key],
                        f"{factor * term.value:.4g}",
                        f"{factor * term.half:.2g}",
                        (unit or "1") + TERMS[key][1],
                    )
                )
        least, at = noise.least
        rows.append((name, f"least deviation, at {at:.4g} s", f"{factor * least:.4g}", "", unit))
        if noise.lag:
            rows.append((name, "time constant of the filter", f"{noise.lag:.4g}", "", "s"))
    columns = ("signal", "term", "value", f"± ({100 * CONFIDENCE:.0f} %)", "unit")
    return Table(columns, tuple(rows), frozenset({2, 3}))


def curves(found: Iterable[tuple[str, Noise, float]], unit: str) -> go.Figure:
    """Plot the root Allan deviation of signals of one unit, and the terms of the first one.

    Args:
        found: name, noise and factor to the unit.
        unit: unit of the deviation, for people.
    """
    figure = go.Figure()
    for k, (name, noise, factor) in enumerate(found):
        curve = noise.curve
        figure.add_trace(
            go.Scatter(
                x=curve.tau,
                y=factor * curve.deviation,
                name=name,
                mode="lines+markers",
                marker={"size": 4},
                line={"color": SERIES[k % len(SERIES)], "width": 1.4},
                error_y={
                    "type": "data",
                    "symmetric": False,
                    "array": factor * (curve.high - curve.deviation),
                    "arrayminus": factor * (curve.deviation - curve.low),
                    "thickness": 0.8,
                    "width": 0,
                },
            )
        )
        if k == 0:
            for key, part in noise.parts.items():
                shown = line(curve.tau, factor * np.sqrt(part), GREY, _TERM_TITLES[key], dash="dot")
                figure.add_trace(shown)
    figure.update_xaxes(type="log", title_text="averaging time, s", exponentformat="power")
    figure.update_yaxes(
        type="log", title_text=f"root Allan variance, {unit}", exponentformat="power"
    )
    return layout(figure, 460)


def write_page(path: Path, recording: Path, found: SignalNoise) -> Path:
    """Write the page.

    Raises:
        SteadytipError: the file cannot be written.
    """
    sections = []
    for unit in dict.fromkeys(unit for _, _, unit in found.values()):
        some = {name: one for name, one in found.items() if one[2] == unit}
        notes = [f"Note: {name}: {note}." for name, (noise, _, _) in some.items()
                 for note in noise.notes]  # fmt: skip
        plot = Plot(
            "Root Allan variance",
            f"With intervals of {100 * CONFIDENCE:.0f} %; dotted are the terms of the first curve.",
            curves([(n, noise, factor) for n, (noise, factor, _) in some.items()], unit or "1"),
        )
        title = f"Signals in {unit}" if unit else "Signals"
        sections.append(Section(title, tuple(notes), (term_table(some),), (plot,)))
    return write_topic_page(
        path,
        "Noise at rest",
        f"Allan deviation of {recording.name}",
        (
            "N is a one-sided density; the velocity or angle random walk of a data sheet is "
            "N / √2. A term is listed where the curve shows it.",
        ),
        sections,
        "allantools",
    )
