"""A04 figure 7.8: the identified operator over the measured response."""

import numpy as np

from harness.identify.hysteresis.plays import excitation, identify_hysteresis
from harness.report.page import Plot
from harness.report.plots import SERIES, chart, line
from harness.reproduce.experiments.stack import RATE, TRAVEL, read, respond, run_operator, sine
from harness.reproduce.item import Context, Item, ItemResult, figures_of

FREQUENCY = 10.0
"""Of the sine [Hz]."""
SECONDS = 5.0
"""Of its recording (A04 7.4)."""
SHOWN = 2
"""Cycles in the plot."""
SEEDS = (78, 79)
"""Of the sensor noise: identification, sine."""
SOURCE = "A04 figure 7.8"


def run(context: Context) -> ItemResult:
    """Fit the operator to recorded responses alone, and lay it over a 10 Hz sine."""
    context.progress(0.0, "recording for the identification")
    drive = excitation(RATE)
    response = read(respond(drive), SEEDS[0])
    context.progress(0.3, "10 Hz sine")
    volts, stroke = sine(FREQUENCY, round(SECONDS * FREQUENCY))
    measured = read(stroke, SEEDS[1])
    travel = np.ptp(stroke)
    figures, models = [], {}
    for share, name, recording, setting in (
        (0.6, "saw-tooth", (drive, response), "10 Hz saw-tooth whose size falls, not this sine"),
        (0.8, "sine", (volts, measured), "the same sine, as in the thesis"),
    ):
        context.progress(share, f"identification from the {name}")
        fit = identify_hysteresis(*recording)
        # The operator begins at rest: what comes before the last cycle settles its memory.
        left = measured - run_operator(fit.parameters, volts)
        left = (left - left.mean())[round(RATE / FREQUENCY) :]
        models[name] = run_operator(fit.parameters, volts)
        rms, largest = np.std(left), np.abs(left).max()
        where = f"identified from: {setting}; sensor noise 0.07 um rms included"
        rows = (
            ("rms of measured less model", "um", None, rms * 1e6),
            ("the same over the travel", "%", None, 100 * rms / TRAVEL),
            ("largest of measured less model", "um", None, largest * 1e6),
        )
        figures += figures_of(SOURCE, where, rows)
    row = ("travel of the sine, p-p", "um", TRAVEL * 1e6, travel * 1e6)
    figures += figures_of(SOURCE, "voltage chosen for it", [row])
    context.progress(0.95, "plot")
    return ItemResult(
        figures=tuple(figures),
        plots=(_loops(volts, measured, models),),
        notes=(
            "Measured response of the plant (no play operators in it) to a 10 Hz sine, and the "
            "modified Prandtl-Ishlinskii operator of 10 plays and 4 dead zones identified from "
            "recordings of it. Mean values are left out: a new stack settles off its zero.",
        ),
    )


def _loops(volts: np.ndarray, measured: np.ndarray, models: dict[str, np.ndarray]) -> Plot:
    last = slice(-round(SHOWN * RATE / FREQUENCY), None)
    curves = [line(volts[last], measured[last] * 1e6, SERIES[5], "measured", width=2.4)]
    for (name, model), colour, dash in zip(models.items(), SERIES, ("dot", "dash"), strict=False):
        moved = model - model.mean() + measured.mean()
        name = f"model, from the {name}"
        curves.append(line(volts[last], moved[last] * 1e6, colour, name, dash=dash))
    return Plot(
        "Identified operator over the measured response",
        f"The last {SHOWN} cycles of a 10 Hz sine of 12.5 µm p-p, with sensor noise.",
        chart(curves, "voltage, V", "stroke, µm", 480),
    )


ITEM = Item(
    name="figure-7.8",
    source=SOURCE,
    title="Identified operator over the measured response to a 10 Hz sine",
    group="hysteresis",
    run=run,
)
