"""Figures and plots of A04's tables of tracking, beside what each controller does."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, grid, line
from harness.reproduce.experiments.stack import RATE
from harness.reproduce.experiments.tracking import CONTROLLERS, Track, track_without_model
from harness.reproduce.item import Context, ItemResult, figures_of

WITHOUT = "without model"
RATE_DEPENDENT = "rate-dependent"
BEST = "modulated stops"


@dataclass(frozen=True)
class TrackingErrors:
    """Errors of one controller on some demands.

    Attributes:
        tracks: one for each demand.
    """

    tracks: tuple[Track, ...]

    @property
    def rms(self) -> np.ndarray:
        """Rms of the error less its mean, for each demand [um]."""
        return np.array([1e6 * np.std(track.error) for track in self.tracks])

    @property
    def largest(self) -> np.ndarray:
        """Largest error less its mean, for each demand [um]."""
        return np.array([1e6 * np.abs(track.moving).max() for track in self.tracks])

    @property
    def rms_with_mean(self) -> np.ndarray:
        """Rms of the error with its mean, for each demand [um]."""
        return np.array([1e6 * np.sqrt(np.mean(track.error**2)) for track in self.tracks])


Found = Mapping[str, TrackingErrors]
"""Errors by controller."""
Paper = Mapping[str, tuple[float, float]]
"""Rms and largest error of the paper by controller [um]."""


def track_all(context: Context, shapes: Mapping[str, np.ndarray], first_seed: int) -> Found:
    """Track all demands with all controllers.

    Args:
        context: of the item; its progress is called.
        shapes: of the demands, by name.
        first_seed: of the sensor's noise on the first demand; the others follow.
    """
    found: dict[str, TrackingErrors] = {}
    for index, name in enumerate((WITHOUT, *CONTROLLERS)):
        tracks = []
        for k, (label, shape) in enumerate(shapes.items()):
            share = (index + k / len(shapes)) / (len(CONTROLLERS) + 1)
            text = f"{name}, {label}" if k or name == WITHOUT else f"identifying {name}"
            context.progress(share, text)
            track = track_without_model if name == WITHOUT else CONTROLLERS[name]().track
            tracks.append(track(shape, first_seed + k))
        found[name] = TrackingErrors(tuple(tracks))
    context.progress(0.98, "plots")
    return found


def mean_figures(source: str, demand: str, found: Found, paper: Paper) -> Iterable[Figure]:
    """Yield rms and largest error of each controller, means over the demands.

    Args:
        source: of the paper's numbers.
        demand: what was tracked, in words.
        found: by controller.
        paper: numbers of the paper; those of the rate-dependent controller stand beside the best
            of ours, too.
    """
    for name, errors in found.items():
        rms, largest = paper.get(name, paper[RATE_DEPENDENT])
        beside = "" if name in paper else ", paper: rate-dependent"
        rows = (
            (f"rms error, {name}{beside}", "um", rms, errors.rms.mean()),
            (f"largest error, {name}{beside}", "um", largest, errors.largest.mean()),
        )
        yield from figures_of(source, f"{demand}; mean removed", rows)
    best = found[BEST]
    row = (f"rms error with its mean, {BEST}", "um", None, best.rms_with_mean.mean())
    yield from figures_of(source, f"{demand}; the sensor's zero as identified", [row])
    top = max(1e6 * np.abs(track.error).max() for track in best.tracks)
    row = (f"largest error of all, {BEST}", "um", None, top)
    yield from figures_of(source, f"{demand}; with its mean", [row])


def plot_tracks(title: str, caption: str, found: Found, place: int, seconds: float) -> Plot:
    """Plot demand, measurement and error of each controller, one controller below the other.

    Args:
        title: heading.
        caption: what else there is to say.
        found: by controller.
        place: number of the demand.
        seconds: that are shown, from the first one.
    """
    panels = []
    for errors in found.values():
        track, shown = errors.tracks[place], slice(0, round(seconds * RATE))
        time = np.arange(len(track.wanted))[shown] / RATE
        wanted, measured = (1e6 * (x - x.mean())[shown] for x in (track.wanted, track.measured))
        curves = (
            line(time, wanted, GREY, "demand", dash="dot"),
            line(time, measured, SERIES[0], "measured"),
        )
        error = line(time, 1e6 * track.moving[shown], SERIES[1], "difference")
        panels.append((curves, [error]))
    figure = grid(panels, "time, s", ["µm"] * len(found), 190 * len(found), row_titles=list(found))
    # All but the first, which has no model, to one scale.
    for row in range(2, len(found) + 1):
        figure.update_yaxes(range=[-0.8, 0.8], row=row, col=2)
    text = "Demand and what is measured (left), and the difference (right)"
    return Plot(title, f"{text}, {caption}", figure)


def changing_demands(
    context: Context,
    source: str,
    demand: str,
    shapes: Mapping[str, np.ndarray],
    first_seed: int,
    paper: Paper,
    title: str,
    which: str,
    note: str,
) -> ItemResult:
    """Track demands that are no sines; see `track_all`, `mean_figures` and `plot_tracks`."""
    found = track_all(context, shapes, first_seed)
    return ItemResult(
        tuple(mean_figures(source, demand, found, paper)),
        (plot_tracks(title, f"of each controller; the first {which}.", found, 0, 2.0),),
        (note,),
    )
