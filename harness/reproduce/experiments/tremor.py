"""Tremor filters in the signal alone: ideal position in, tremor out, no instrument around them.

    x    position of the tip in W, counted from its first sample     (n, 3) [m]
    y    tremor that a filter puts out                               (n, 3) [m]
    t    zero-phase band-pass 6 to 15 Hz of x: butter(2, band-pass), forwards and backwards
    bp   zero-phase band-pass 6 to 16 Hz: butter(4, band-pass), forwards and backwards

    a-posteriori   100 (1 - std(t - y) / std(t))            how much of the tremor y is
    in-band        100 (1 - std(bp(x - y)) / std(bp(x)))    how much of the band y takes away

Both are of each axis, and the mean over axes is a motion's. Each can be gamed alone: a filter that
calls all of x tremor leaves nothing in the band, and cancels all intent; one that says little where
it is not sure is better off a-posteriori.

Recordings are raw. A quintic spline goes through their samples, and nothing is smoothed before a
filter sees it: a zero-phase low-pass would show it the future. The spline itself does so, too, but
within a sample or two of the recording: its value between two samples depends on the next ones.
Filters whose lags are not shorter than that gain nothing by it; see `ceilings` for others.

A filter runs at its own sample period, and its output is held until its next sample, as in a loop.
With a delay, what is compared with the present is an output that has been computed from positions
up to that long ago, by a filter whose horizon is the delay.

What counts are samples from SETTLING on, since filters have to learn, up to TAIL before the end:
zero-phase filters have to invent what follows the end, and half a second is five of their periods.
They see the whole record, extended oddly by PADDING at both ends.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from fmu_src.kit.model import Model
from fmu_src.kit.records import Field, Record
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.pack.discovery import load_model, model_names
from harness.recordings.motion import read_recording
from plants import hand

RATE = 1000.0
"""Of what is compared [Hz]."""
DELAYS = (0.0, 4e-3, 8e-3)
"""Of the loop that a filter has to make up for [s]."""
TARGET_ORDER, TARGET_BAND = 2, (6.0, 15.0)
"""Of t; band [Hz]."""
BAND_ORDER, BAND = 4, (6.0, 16.0)
"""Of bp; band [Hz]."""
SETTLING, TAIL, PADDING = 3.0, 0.5, 1.0
"""Left out at the beginning and at the end, and extension of the record [s]."""
GENERATED_SECONDS = 23.5
"""Of the generator's motion; 20 s of it count."""
INTENT_SECONDS = 10.0
"""Of a motion without tremor."""
DIRECTION = np.array([0.6, 0.64, 0.48])
"""Of motion along a line: a unit vector that treats no two axes alike."""
PACKAGE = "fmu_src.tremor."
_SLACK = 1e-6  # of a sample, for instants that are equal but for rounding


@dataclass(frozen=True)
class TipMotion:
    """A motion of the tip.

    Attributes:
        name: for people.
        at: position at some times: (k,) [s] to (k, 3) [m].
        seconds: up to which it is known.
    """

    name: str
    at: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    seconds: float

    def instants(self, period: float) -> np.ndarray:
        """Return times of samples with some period, (n,) [s]."""
        return period * np.arange(int(self.seconds / period + _SLACK) + 1)

    @cached_property
    def time(self) -> np.ndarray:
        """Times of what is compared, (n,) [s]."""
        return self.instants(1 / RATE)

    @cached_property
    def position(self) -> np.ndarray:
        """x, (n, 3) [m]."""
        return self.at(self.time)

    @cached_property
    def target(self) -> np.ndarray:
        """t, (n, 3) [m]."""
        return zero_phase(TARGET_ORDER, TARGET_BAND, self.position)

    @cached_property
    def band(self) -> np.ndarray:
        """Tremor in the band, bp(x), (n, 3) [m]."""
        return zero_phase(BAND_ORDER, BAND, self.position)

    @property
    def counted(self) -> slice:
        """Samples that count."""
        return slice(round(SETTLING * RATE), len(self.time) - round(TAIL * RATE))


@dataclass(frozen=True)
class TremorReduction:
    """Reduction of tremor by both definitions, mean over the axes [%]."""

    a_posteriori: float
    in_band: float


@dataclass(frozen=True)
class TremorFilter:
    """A model that tells tremor from intent.

    Attributes:
        model: which.
        horizons: parameters that say how far ahead the tremor is wanted; empty if it cannot look
            ahead.
    """

    model: Model
    horizons: tuple[str, ...]

    @property
    def delays(self) -> tuple[float, ...]:
        """That it can make up for [s]."""
        return DELAYS if self.horizons else DELAYS[:1]

    def tremor(self, motion: TipMotion, delay: float = 0.0) -> np.ndarray:
        """Return y, what the filter takes for tremor, (n, 3) [m].

        Args:
            motion: ideal position.
            delay: after which its output arrives [s].
        """
        period = self.model.sample_period
        instants = motion.instants(period)
        inputs = {"position": motion.at(instants)}
        if "valid" in self.model.inputs.fields:
            inputs["valid"] = np.ones(len(instants))
        runner = CompiledRunner(self.model, dict.fromkeys(self.horizons, delay))
        found = runner.run(len(instants), inputs)["tremor"]
        latest = np.floor((motion.time - delay) / period + _SLACK).astype(int)
        return np.where(latest[:, None] < 0, 0.0, found[np.maximum(latest, 0)])


def filters() -> dict[str, TremorFilter]:
    """Return all models of the package of tremor filters from `position` to `tremor`, by name."""
    found = {}
    for name in model_names():
        model = load_model(name)
        from_position = _has_vector(model.inputs, "position") and _has_vector(
            model.outputs, "tremor"
        )
        if model.step.__module__.startswith(PACKAGE) and from_position:
            names = [scalar.name for scalar in model.parameters.scalars()]
            ahead = (name for name in names if name.rpartition(".")[2] == "horizon")
            found[name] = TremorFilter(model, tuple(ahead))
    return found


def _has_vector(record: type[Record], name: str) -> bool:
    declared = record.fields.get(name)
    return isinstance(declared, Field) and declared.shape == (3,)


def through(name: str, time: np.ndarray, position: np.ndarray) -> TipMotion:
    """Return the motion through samples, by a quintic spline; nothing is smoothed.

    Args:
        name: for people.
        time: (k,) [s], from 0 on.
        position: (k, 3) [m].
    """
    return TipMotion(name, make_interp_spline(time, position, 5), float(time[-1]))


def recorded(path: Path) -> TipMotion:
    """Return motion of a recorded hand."""
    recording = read_recording(path)
    return through(path.stem, recording.time, recording.position)


def generated(seed: int = 1) -> TipMotion:
    """Return motion of the generator, its tremor a tone that wanders over 8 to 12 Hz.

    Args:
        seed: of the motion.
    """
    period = hand.MODEL.sample_period
    samples = round(GENERATED_SECONDS / period) + 1
    tip = CompiledRunner(hand.MODEL, {"seed": seed}).run(samples)["tip"]
    return through("generator", period * np.arange(samples), tip - tip[0])


def sine(t: np.ndarray) -> np.ndarray:
    """Return a sine of 1 Hz, 1 mm amplitude, (k, 3) [m]."""
    return 1e-3 * np.outer(np.sin(2 * np.pi * t), DIRECTION)


def ramp(t: np.ndarray) -> np.ndarray:
    """Return a ramp of 2 mm/s, (k, 3) [m]."""
    return np.outer(2e-3 * t, DIRECTION)


def reach(t: np.ndarray) -> np.ndarray:
    """Return a reach of 5 mm within 0.7 s, of least jerk, out of rest after 4 s, (k, 3) [m]."""
    s = np.clip((t - 4.0) / 0.7, 0.0, 1.0)
    return 5e-3 * np.outer(s**3 * (10 - 15 * s + 6 * s**2), DIRECTION)


def tracing(t: np.ndarray) -> np.ndarray:
    """Return a circle of 1 mm radius at 5 mm/s, lying, (k, 3) [m]."""
    turn = 5.0 * t  # 5 mm/s over 1 mm [rad]
    return 1e-3 * np.column_stack((np.cos(turn) - 1.0, np.sin(turn), np.zeros_like(turn)))


INTENTS = {
    "sine of 1 Hz, 1 mm": sine,
    "ramp of 2 mm/s": ramp,
    "reach of 5 mm in 0.7 s": reach,
    "circle of 1 mm radius at 5 mm/s": tracing,
}
"""Motions without any tremor, by name."""


def intents() -> Iterable[TipMotion]:
    """Return motions that a filter should leave alone."""
    return (TipMotion(name, at, INTENT_SECONDS) for name, at in INTENTS.items())


def zero_phase(order: int, band: tuple[float, float], x: np.ndarray) -> np.ndarray:
    """Filter by a Butterworth band-pass forwards and backwards, (n, 3).

    Args:
        order: of the prototype; the band-pass has twice as many poles.
        band: corners [Hz].
        x: (n, 3), at RATE.
    """
    sos = butter(order, band, "bandpass", fs=RATE, output="sos")
    return sosfiltfilt(sos, x, axis=0, padlen=min(round(PADDING * RATE), len(x) - 1))


def score(motion: TipMotion, tremor: np.ndarray, counted: slice | None = None) -> TremorReduction:
    """Score how much of a motion's tremor is found, by both definitions.

    Args:
        motion: what the filter has seen.
        tremor: y, (n, 3) [m].
        counted: samples that count; the motion's by default.
    """
    part = motion.counted if counted is None else counted
    left = zero_phase(BAND_ORDER, BAND, motion.position - tremor)
    return TremorReduction(
        _reduction((motion.target - tremor)[part], motion.target[part]),
        _reduction(left[part], motion.band[part]),
    )


def _reduction(left: np.ndarray, there: np.ndarray) -> float:
    return 100.0 * float(np.mean(1.0 - np.std(left, axis=0) / np.std(there, axis=0)))


def disturbance(motion: TipMotion, tremor: np.ndarray) -> float:
    """Return the rms of what is taken for tremor in a motion without, over the motion's rms [%].

    The motion's is about its mean.

    Args:
        motion: intent.
        tremor: y, (n, 3) [m].
    """
    moved = motion.position[motion.counted]
    taken = np.mean(tremor[motion.counted] ** 2)
    return 100.0 * float(np.sqrt(taken / np.mean((moved - moved.mean(axis=0)) ** 2)))


@dataclass(frozen=True)
class FilterScores:
    """One filter on some motions.

    Attributes:
        scores: one for each motion.
    """

    scores: Sequence[TremorReduction]

    @property
    def mean(self) -> TremorReduction:
        """Over the motions."""
        return TremorReduction(*np.mean(self._values, axis=0).tolist())

    @property
    def worst(self) -> TremorReduction:
        """Least of the motions, each definition by itself."""
        return TremorReduction(*np.min(self._values, axis=0).tolist())

    @property
    def _values(self) -> np.ndarray:
        return np.array([(score.a_posteriori, score.in_band) for score in self.scores])
