"""Results of an analysis in numbers: figures for machines, tables for people, and the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from harness.analyze.analysis import DOUBTFUL, INCOHERENT, Analysis
from harness.analyze.delay_budget import BAND, INTENT, band, correction_of, left_of
from harness.analyze.multisine import FREQUENCIES, SPACING
from harness.analyze.operating_point import AXES
from harness.common.figures import Figure
from harness.common.quantities import format_quantity
from harness.common.types import FloatArray
from harness.report.page import Section, Table, made_with, write_sections
from harness.results.metrics import TREMOR_BAND

__all__ = ["PAGE", "figures", "tables", "write_page"]

PAGE = "delay_budget.html"
SOURCE = "steadytip analyze"
SHOWN = (8.0, 10.0, 12.0)
"""Frequencies of the tables [Hz]."""
LEFT_AT = (0.5, 1.0, 2.0, 4.0, 6.0, *SHOWN, 14.0, 16.0, 20.0)
DOUBT = " (?)"


_Made = Callable[..., Figure]
"""(quantity, unit, value) to a figure."""


def _line(frequency: float) -> int:
    return round(frequency / SPACING) - 1


def _phase(analysis: Analysis) -> FloatArray:
    """Return the phase of the correction against the motion, (f,), leading is positive [deg]."""
    return np.degrees(np.angle(correction_of(analysis.measured)))


def figures(analysis: Analysis) -> list[Figure]:
    """Return all numbers; the setting names those that are not to be trusted."""
    return list(_figures(analysis))


def _figures(analysis: Analysis) -> Iterator[Figure]:
    setting = (
        f"{analysis.scenario.name}, tremor of {analysis.tremor * 1e6:.3g} um rms from "
        f"{TREMOR_BAND[0]:g} to {TREMOR_BAND[1]:g} Hz"
    )

    def figure(quantity: str, unit: str, value: Any, doubt: str = "") -> Figure:
        return Figure(SOURCE, quantity, unit, None, float(value), setting + doubt)

    left, from_parts, phase = (
        left_of(analysis.measured),
        left_of(analysis.from_parts),
        _phase(analysis),
    )
    for f in LEFT_AT:
        k = _line(f)
        doubt = f"; doubtful: beyond {DOUBTFUL:g}" if analysis.doubtful[k] else ""
        yield figure(f"tip motion by hand motion at {f:g} Hz, whole loop", "", left[k], doubt)
        for i, axis in enumerate(AXES):
            value = np.linalg.norm(analysis.measured[k, :, i])
            yield figure(f"tip motion by hand motion along {axis} at {f:g} Hz", "", value, doubt)
        yield figure(f"tip motion by hand motion at {f:g} Hz, parts", "", from_parts[k], doubt)
        yield figure(f"tip motion by hand motion at {f:g} Hz, error", "", analysis.scatter[k])
    for f in SHOWN:
        k = _line(f)
        doubt = f"; doubtful: coherence {analysis.coherence[k]:.2f}"
        doubt = doubt if analysis.coherence[k] < INCOHERENT else ""
        yield figure(f"phase of the correction at {f:g} Hz", "deg", phase[k], doubt)
        yield figure(f"coherence of the correction at {f:g} Hz", "", analysis.coherence[k])
        for stage in analysis.stages:
            what = f"the wire to {stage.label[2:]}" if stage.wire else stage.label
            yield figure(f"phase of {what} at {f:g} Hz", "deg", np.degrees(stage.phase[k]), doubt)
            yield figure(f"delay of {what} at {f:g} Hz", "ms", stage.delay[k] * 1e3, doubt)
    for high in (1.0, INTENT):
        worst = np.linalg.norm(analysis.measured, ord=2, axis=(1, 2))[: _line(high) + 1].max()
        yield figure(f"largest amplification of intent up to {high:g} Hz", "", worst)
    k = int(np.argmax(left))
    yield figure("largest tip motion by hand motion", "", left[k])
    yield figure("frequency of the largest tip motion by hand motion", "Hz", FREQUENCIES[k])
    yield from _delays(analysis, figure)
    yield figure(
        f"parts against whole, rms from {BAND[0]:g} to {BAND[1]:g} Hz",
        "",
        np.sqrt(np.mean(band(analysis.held_out) ** 2)),
    )


def _delays(analysis: Analysis, figure: _Made) -> Iterator[Figure]:
    budget, of = analysis.budget, f"{BAND[0]:g} to {BAND[1]:g} Hz"
    yield figure(f"left of tremor from {of}, parts", "", budget.left)
    yield figure(f"left of tremor at the worst of {of}, parts", "", budget.left_worst)
    for value, where in ((budget.spare, "over"), (budget.spare_everywhere, "everywhere from")):
        if value is not None and math.isfinite(value):
            text = f"largest further delay with {budget.wanted:g} left {where} {of}"
            yield figure(text, "ms", value * 1e3)
    yield figure("further delay with which least is left", "ms", budget.best * 1e3)
    yield figure("left of tremor with that delay", "", budget.best_left)
    yield figure("change of what is left by further delay", "1/ms", budget.per_delay * 1e-3)
    yield figure("change of what is left by relative gain", "", budget.per_gain)
    margins = analysis.margins
    if margins is not None:
        yield figure("smallest singular value of 1 - L", "", margins.modulus)
        for value, name, unit in (
            (margins.gain, "gain margin", ""),
            (math.degrees(margins.phase), "phase margin", "deg"),
            (margins.delay * 1e3, "delay margin", "ms"),
        ):
            if math.isfinite(value):
                yield figure(name, unit, value)


def spare_text(analysis: Analysis) -> str:
    """Return the delay budget in a sentence."""
    budget, of = analysis.budget, f"{BAND[0]:g} to {BAND[1]:g} Hz"

    def words(value: float | None, left: float) -> str:
        if value is None:
            return f"not met as it is, {100 * left:.0f} % is left"
        if math.isinf(value):
            return "met at all delays that were tried"
        return f"{value * 1e3:.2f} ms more"

    return (
        f"No more than {100 * budget.wanted:g} % left of a tremor spread over {of}: "
        f"{words(budget.spare, budget.left)}; at every frequency there: "
        f"{words(budget.spare_everywhere, budget.left_worst)}."
    )


def tables(analysis: Analysis) -> dict[str, Table]:
    """Return tables for people, by their title."""
    left, from_parts, phase = (
        left_of(analysis.measured),
        left_of(analysis.from_parts),
        _phase(analysis),
    )
    rows = []
    for f in LEFT_AT:
        k = _line(f)
        columns = np.linalg.norm(analysis.measured[k], axis=0)
        doubt = DOUBT if analysis.doubtful[k] else ""
        angle = f"{phase[k]:.1f}" if analysis.coherence[k] >= INCOHERENT else "–"
        rows.append(
            (
                f"{f:g}",
                *(f"{value:.2f}" for value in columns),
                f"{left[k]:.2f}{doubt}",
                f"{analysis.scatter[k]:.2f}",
                f"{from_parts[k]:.2f}",
                angle,
                f"{analysis.coherence[k]:.2f}",
            )
        )
    found = {
        "Tip motion by hand motion": Table(
            ("Hz", *AXES, "any axis", "±", "parts", "phase, deg", "coherence"),
            tuple(rows),
            frozenset(range(9)),
        )
    }
    if analysis.stages:
        found["What each part costs"] = _stage_table(analysis)
    found["Delay and intent"] = Table(
        ("quantity", "value", "unit"),
        tuple(
            (figure.quantity, f"{figure.measured:.3g}", figure.unit)
            for figure in figures(analysis)
            if any(word in figure.quantity for word in ("intent", "delay with", "change", "margin"))
            or figure.quantity.startswith(("left of", "largest tip", "frequency of"))
        ),
        frozenset({1}),
    )
    return found


def _stage_table(analysis: Analysis) -> Table:
    def row(name: str, phase: FloatArray, how: str) -> tuple[str, ...]:
        cells = [name]
        for f in SHOWN:
            degrees = phase[_line(f)]
            cells += [_plain(degrees, 1), _plain(-degrees / (360.0 * f) * 1e3, 2)]
        return (*cells, how)

    rows = []
    for stage in analysis.stages:
        nonlinear = set(stage.parts) & set(analysis.fitted)
        how = "wire" if stage.wire else "loop" if nonlinear else "alone"
        rows.append(row(stage.label, np.degrees(stage.phase), how))
    total = np.sum([stage.phase for stage in analysis.stages], axis=0)
    rows.append(row("all together", np.degrees(total), ""))
    rows.append(row("whole loop", _phase(analysis), "measured"))
    heads = [head for f in SHOWN for head in (f"{f:g} Hz, °", "ms")]
    return Table(("part", *heads, "response"), tuple(rows), frozenset(range(1, 7)))


def _plain(value: float, digits: int) -> str:
    """Format a number without the sign of a rounded zero."""
    text = f"{value:.{digits}f}"
    return text if float(text) else text.lstrip("-")


def write_page(analysis: Analysis, folder: Path) -> Path:
    """Write the page.

    Raises:
        SteadytipError: the folder cannot be written to.
    """
    from harness.analyze import plots

    found = tables(analysis)
    sections = [
        Section(
            "What is left of a motion",
            (
                "Tip motion by hand motion along each axis; 1 is without compensation. Any axis: "
                "rms. Parts: the same from the responses of the parts. A question mark is where "
                f"two realisations, or parts and whole, differ by more than {DOUBTFUL:g}; a phase "
                f"is left out where the correction's coherence with the motion is below "
                f"{INCOHERENT:g}.",
            ),
            (found["Tip motion by hand motion"],),
            (plots.attenuation(analysis),),
        ),
        Section(
            "What each part costs",
            (
                "Phase on the way from the hand to the correction of the tip, negative where a "
                "part lags, and the delay that it is worth; mean of the axes.",
            ),
            (found["What each part costs"],) if analysis.stages else (),
            (plots.phases(analysis),) if analysis.stages else (),
            trouble="" if analysis.stages else analysis.notes[-1].capitalize() + ".",
        ),
        Section(
            "What delay it bears",
            (spare_text(analysis),),
            (found["Delay and intent"],),
            (plots.delays(analysis),),
        ),
        Section(
            "How far this goes",
            tuple(f"{note[:1].upper()}{note[1:]}." for note in analysis.notes),
            plots=(plots.misfits(analysis),),
        ),
    ]
    size, unit = format_quantity(analysis.tremor, "m")
    return write_sections(
        folder / PAGE,
        f"Delay budget: {analysis.scenario.title}",
        f"{analysis.scenario.name}, tremor of {size} {unit} rms"
        + (f" as in {analysis.motion.name}" if analysis.motion else ""),
        (
            spare_text(analysis),
            "The hand moves by multisines, its tremor as large as in the scenario but spread "
            f"over {TREMOR_BAND[0]:g} to {TREMOR_BAND[1]:g} Hz, as that of real hands is: a "
            "filter that learns cancels a tone better. What a run does with its own motion is "
            "in its report.",
        ),
        sections,
        made_with("control", "numpy", "scipy", "fmpy", "plotly"),
    )
