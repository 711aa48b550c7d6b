"""Remaining error of A04 table 7.1, and the share of each part of the operator in it."""

from collections.abc import Callable

import numpy as np
import plotly.graph_objects as go

from harness.identify.hysteresis.modulated_stops import identify_stops
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart
from harness.reproduce.experiments.stack import RATE, read
from harness.reproduce.experiments.tracking import (
    SECONDS,
    SEEDS,
    Track,
    TrackingController,
    recorded,
    stops,
    stops_tracker,
    tone,
)
from harness.reproduce.item import Context, Item, ItemResult, figures_of
from plants import displacement_sensor, piezo_stack

SOURCE = "A04 table 7.1"
FREQUENCIES = (1.0, 10.0, 19.0)
"""Sines that each row is a mean over [Hz]."""
FEW = 4
"""Stops of the smallest operator."""
GAIN_DRIFT, LOOP_DRIFT = 0.01, 0.05
"""Of the stack after it was identified: relative change of the gain, and of what makes loops."""
ADAPTATION = 1.0
"""Time of the gain's adaptation [s]."""
SETTLED = 10.0
"""Seconds of tracking after which an adapted gain is looked at."""
SENSOR = "sensor noise alone"


def run(context: Context) -> ItemResult:
    """Track with one part left out, or one thing changed, at a time."""
    volts, stroke = recorded()
    noisy = read(stroke, SEEDS["excitation"])

    def rms(tracker: TrackingController, noise: bool = True, **more: object) -> float:
        """Return the rms error with its mean, over all frequencies [um]."""
        squares = []
        for frequency in FREQUENCIES:
            seed = int(frequency) if noise else None
            track = tracker.track(tone(frequency), seed, **more)  # type: ignore[arg-type]
            squares.append(np.sqrt(np.mean(track.error**2)))
        return 1e6 * float(np.mean(squares))

    def fitted(measured: np.ndarray = noisy, **more: object) -> TrackingController:
        return stops_tracker(identify_stops(volts, measured, 1 / RATE, **more))  # type: ignore[arg-type]

    def late(adaptation: float) -> float:
        """Track a long sine on a stack with drifted gain; return the rms error at its end [um]."""
        shape = np.tile(tone(10.0), 3)
        track = stops().track(shape, 10, {"gain_error": GAIN_DRIFT}, adaptation)
        last = slice(round(SETTLED * RATE), round((SETTLED + SECONDS) * RATE))
        part = Track(track.wanted[last], track.measured[last])
        return 1e6 * float(np.sqrt(np.mean(part.error**2)))

    shipped = piezo_stack.Params.unpack(piezo_stack.Params.starts())
    looser = {
        name: (1 + LOOP_DRIFT) * getattr(shipped, name) for name in ("slip_weight", "loop_weight")
    }
    drift = {"gain_error": GAIN_DRIFT}
    rows: dict[str, Callable[[], float]] = {
        "all of it": lambda: rms(stops()),
        SENSOR: lambda: 1e6 * displacement_sensor.Params.starts()[0],
        "no sensor noise while tracking": lambda: rms(stops(), noise=False),
        "none in the recording for the identification either": lambda: rms(
            fitted(stroke), noise=False
        ),
        "creep left out of the operator": lambda: rms(fitted(without=("creep",))),
        "lag left out of the operator": lambda: rms(fitted(without=("lead",))),
        f"{FEW} stops": lambda: rms(fitted(orders=(FEW,))),
        f"gain {100 * GAIN_DRIFT:g} % off after the identification": lambda: rms(
            stops(), stack=drift
        ),
        f"loops {100 * LOOP_DRIFT:g} % wider after the identification": lambda: rms(
            stops(), stack=looser
        ),
        f"gain {100 * GAIN_DRIFT:g} % off, 10 Hz, after {SETTLED:g} s": lambda: late(0.0),
        "the same, gain adapted to a displacement sensor": lambda: late(ADAPTATION),
    }
    found: dict[str, float] = {}
    for k, (name, measure) in enumerate(rows.items()):
        context.progress(k / len(rows), name)
        found[name] = measure()
    setting = "modulated stops, mean over sines of 1, 10 and 19 Hz, 12.5 um p-p; with the mean"
    numbers = ((f"rms error: {name}", "um", None, value) for name, value in found.items())
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, numbers)),
        plots=(_plot(found),),
        notes=(
            "Rms errors add up by their squares: what a part costs is the root of the difference "
            "of two squares. Most of what remains is the sensor's own noise, which no controller "
            "removes; the rest is what the operator cannot say of the stack, hardly noise in the "
            "identification. A drift of the stack afterwards costs more than all of it; what a "
            "gain that has drifted costs, its adaptation to a displacement signal gets back.",
        ),
    )


def _plot(found: dict[str, float]) -> Plot:
    names = list(found)[::-1]
    colours = [GREY if name == SENSOR else SERIES[0] for name in names]
    bars = go.Bar(
        x=[found[name] for name in names], y=names, orientation="h", marker={"color": colours}
    )
    plot = chart([bars], "rms error, µm", "", 460, showlegend=False)
    plot.update_yaxes(automargin=True)
    return Plot("Error budget", "Rms error of tracking, one change at a time.", plot)


ITEM = Item(
    name="error-budget",
    source=SOURCE,
    title="What the error of tracking is made of",
    group="hysteresis",
    run=run,
)
