"""Numbers of A04's tables of tracking, beside what each tracker does."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from harness.common.figures import Figure
from harness.reproduce.experiments.tracking import CONTROLLERS, Track, straight

WITHOUT = "without model"
RATE_DEPENDENT = "rate-dependent"
BEST = "modulated stops"
Progress = Callable[[float, str], None]
"""Told which share is done, and what is next."""


@dataclass(frozen=True)
class Column:
    """One controller on some demands.

    Attributes:
        tracks: one for each demand.
    """

    tracks: tuple[Track, ...]

    @property
    def rms(self) -> np.ndarray:
        """Of the error less its mean, for each demand [um]."""
        return np.array([1e6 * np.std(track.error) for track in self.tracks])

    @property
    def largest(self) -> np.ndarray:
        """Of the error less its mean, for each demand [um]."""
        return np.array([1e6 * np.abs(track.moving).max() for track in self.tracks])

    @property
    def whole(self) -> np.ndarray:
        """Rms of the error with its mean, for each demand [um]."""
        return np.array([1e6 * np.sqrt(np.mean(track.error**2)) for track in self.tracks])


def columns(
    shapes: Mapping[str, np.ndarray], progress: Progress, first_seed: int
) -> dict[str, Column]:
    """All controllers on all demands.

    Args:
        shapes: of the demands, by name.
        progress: told the share done.
        first_seed: of the sensor's noise on the first demand; the others follow.
    """
    found: dict[str, Column] = {}
    for index, name in enumerate((WITHOUT, *CONTROLLERS)):
        tracks = []
        for k, (label, shape) in enumerate(shapes.items()):
            share = (index + k / len(shapes)) / (len(CONTROLLERS) + 1)
            progress(share, f"{name}, {label}" if k or name == WITHOUT else f"identifying {name}")
            seed = first_seed + k
            tracks.append(
                straight(shape, seed) if name == WITHOUT else CONTROLLERS[name]().track(shape, seed)
            )
        found[name] = Column(tuple(tracks))
    return found


def figures(
    source: str,
    demand: str,
    found: Mapping[str, Column],
    paper: Mapping[str, tuple[float, float]],
) -> Iterable[Figure]:
    """Means over the demands: rms and largest error of each controller.

    Args:
        source: of the paper's numbers.
        demand: what was tracked, in words.
        found: by controller.
        paper: rms and largest error by controller [um]; that of the rate-dependent one stands
            beside the best of ours, too.
    """
    for name, column in found.items():
        rms, largest = paper.get(name, paper[RATE_DEPENDENT])
        beside = "" if name in paper else ", paper: rate-dependent"
        setting = f"{demand}; mean removed"
        yield Figure(source, f"rms error, {name}{beside}", "um", rms, column.rms.mean(), setting)
        yield Figure(
            source,
            f"largest error, {name}{beside}",
            "um",
            largest,
            column.largest.mean(),
            setting,
        )
    yield Figure(
        source,
        f"rms error with its mean, {BEST}",
        "um",
        None,
        found[BEST].whole.mean(),
        f"{demand}; the sensor's zero as identified",
    )
    yield Figure(
        source,
        f"largest error of all, {BEST}",
        "um",
        None,
        max(1e6 * np.abs(track.error).max() for track in found[BEST].tracks),
        f"{demand}; with its mean",
    )
