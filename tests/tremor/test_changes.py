"""Every filter from position to tremor: how it stands changes, and half an hour of tremor."""

import copy
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.reproduce.experiments.tremor import filters, sine

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


KINDS = {
    "still": np.zeros((HALF, 3)),
    "low": tones(HALF, 8.0),
    "five times": 5 * tones(HALF, 8.0),
    "high": tones(HALF, 11.0),
}
CHANGES = {
    "onset": ("still", "low"),
    "stop": ("low", "still"),
    "five times": ("low", "five times"),
    "a fifth": ("five times", "low"),
    "frequency up": ("low", "high"),
    "frequency down": ("high", "low"),
}
NOISE = 0.1e-6 * np.random.default_rng(5).standard_normal((2 * HALF, 3))

# The changes of a filter share their halves.
EACH = [pytest.param(name, marks=pytest.mark.xdist_group(f"changes of {name}")) for name in BOUNDS]


def test_every_filter_has_its_bounds():
    assert set(BOUNDS) == set(FILTERS)


@cache
def _settled(name: str, kind: str) -> Runner:
    runner = Runner(FILTERS[name].model)
    runner.run(HALF, {"position": KINDS[kind] + NOISE[:HALF]})
    return runner


@cache
def tremor(name: str, before: str, after: str) -> np.ndarray:
    """Tremor that a filter finds after a change."""
    runner = copy.copy(_settled(name, before))
    runner.x = runner.x.copy()
    return runner.run(HALF, {"position": KINDS[after] + NOISE[HALF:]})["tremor"]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", EACH)
def test_a_change_of_the_tremor_is_followed(name, change):
    """It is as if it had always been so; the change is a step of the position, too."""
    kinds = CHANGES[change]
    before, after = (KINDS[kind] for kind in kinds)
    bounds, changed = BOUNDS[name], tremor(name, *kinds)
    gap = np.abs(changed - tremor(name, kinds[1], kinds[1]))
    gap /= max(np.abs(before).max(), np.abs(after).max())
    assert gap.max() < bounds.peak
    assert gap[round(bounds.within / T) :].max() < bounds.gap
    assert gap[-500:].max() < bounds.end
    left = (after - changed)[-SECOND:]
    assert left.std() < bounds.tone * after.std() + 0.1 * SIZE * (change == "stop")


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_thirty_minutes_of_tremor_without_growth(name):
    """Intent, tremor and noise at 1 kHz; the last minute is as good as the second."""
    bounds, runner, left = BOUNDS[name], CompiledRunner(FILTERS[name].model), []
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


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_compiled_runs_are_those_of_the_recorded_function(name):
    """What half an hour is run with, against what everything else is."""
    model, position = FILTERS[name].model, np.concatenate((KINDS["low"], KINDS["high"])) + NOISE
    found, expected = (
        kind(model).run(2 * HALF, {"position": position})["tremor"]
        for kind in (CompiledRunner, Runner)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * SIZE)
