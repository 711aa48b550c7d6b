"""Every filter from position to tremor: how it stands changes, and half an hour of tremor."""

from dataclasses import dataclass

import numpy as np
import pytest

from fmu_src.kit import Runner
from harness.reproduce.bench.tremor import filters, sine

T = 1e-3
SIZE = 20e-6
HALF = 4000  # samples before a change, and after it
SECOND = 1000
MINUTE = 60_000


@dataclass(frozen=True)
class Bounds:
    """What a filter keeps, with a small margin.

    Attributes:
        peak: largest distance to what it would say had it always been so, after a change, over the
            tremor's largest.
        within: time after which that is small [s].
        gap: what it is then.
        end: what it is after 3.5 s.
        tone: what is left at last of a lasting tone of 8 or 11 Hz, rms over its own.
        long: the same of tones of 9 to 11 Hz after half an hour, with intent and noise.
        intent: whether intent can be beside them; not where the input is to be prefiltered.
    """

    peak: float
    within: float
    gap: float
    end: float
    tone: float
    long: float
    intent: bool = True


FILTERS = filters()
BOUNDS = {
    "ArKalman": Bounds(1.4, 1.0, 0.4, 0.02, 0.06, 0.1),
    "Bmflc": Bounds(2.3, 0.2, 0.12, 0.01, 0.5, 0.5),
    "BmflcKf": Bounds(2.3, 0.2, 0.12, 0.01, 0.5, 0.5),
    "Flc": Bounds(1.0, 0.2, 0.15, 0.01, 0.9, 0.5, intent=False),
    "IntentOscillators": Bounds(2.3, 0.2, 0.12, 0.01, 0.5, 0.5),
    "Shelving": Bounds(0.8, 0.2, 0.01, 0.001, 0.55, 0.55),
    # A step of the position, which no hand makes, costs it one round of learning.
    "VarForecaster": Bounds(12.0, 0.5, 0.1, 0.03, 0.06, 0.1),
    "Wflc": Bounds(1.2, 2.0, 0.25, 0.05, 0.05, 0.01, intent=False),
    "WflcFlc": Bounds(1.2, 2.0, 0.25, 0.05, 0.05, 0.35),
}


def tones(samples: int, frequency: float, size: float = SIZE) -> np.ndarray:
    """A tone along each axis, out of phase, (samples, 3) [m]."""
    time = np.arange(samples) * T
    return size * np.sin(2 * np.pi * frequency * time[:, None] + np.arange(3.0))


LOW, HIGH, STILL = tones(HALF, 8.0), tones(HALF, 11.0), np.zeros((HALF, 3))
CHANGES = {
    "onset": (STILL, LOW),
    "stop": (LOW, STILL),
    "five times": (LOW, 5 * LOW),
    "a fifth": (5 * LOW, LOW),
    "frequency up": (LOW, HIGH),
    "frequency down": (HIGH, LOW),
}
NOISE = 0.1e-6 * np.random.default_rng(5).standard_normal((2 * HALF, 3))


def test_every_filter_has_its_bounds():
    assert set(BOUNDS) == set(FILTERS)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", BOUNDS)
def test_a_change_of_the_tremor_is_followed(name, change):
    """It is as if it had always been so; the change is a step of the position, too."""
    before, after = CHANGES[change]
    bounds, model = BOUNDS[name], FILTERS[name].model

    def run(*halves: np.ndarray) -> np.ndarray:
        position = np.concatenate(halves) + NOISE
        return Runner(model).run(2 * HALF, {"position": position})["tremor"][HALF:]

    changed = run(before, after)
    gap = np.abs(changed - run(after, after)) / max(np.abs(before).max(), np.abs(after).max())
    assert gap.max() < bounds.peak
    assert gap[round(bounds.within / T) :].max() < bounds.gap
    assert gap[-500:].max() < bounds.end
    left = (after - changed)[-SECOND:]
    assert left.std() < bounds.tone * after.std() + 0.1 * SIZE * (change == "stop")


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_thirty_minutes_of_tremor_without_growth(name):
    """Intent, tremor and noise at 1 kHz; the last minute is as good as the second."""
    bounds, runner, left = BOUNDS[name], Runner(FILTERS[name].model), []
    rng = np.random.default_rng(9)
    for minute in range(30):
        t = 60.0 * minute + T * np.arange(MINUTE)
        tone = 30e-6 * np.sin(2 * np.pi * np.outer(t, [9.0, 10.0, 11.0]))
        position = tone + bounds.intent * sine(t) + 0.3e-6 * rng.standard_normal((MINUTE, 3))
        found = runner.run(MINUTE, {"position": position})["tremor"]
        assert np.all(np.isfinite(runner.x))
        left.append(np.std(tone - found))
    assert left[-1] < 1.1 * left[1]
    assert left[-1] < bounds.long * np.std(tone)
