"""FLC and WFLC: speed of adaptation, independence of the amplitude, limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.kit.runner import Runner
from fmu_src.tremor import flc, wflc

T = 1e-3
MICROMETRE = 1e-6


def _tone(seconds: float, frequency: float, amplitude: float, phase: float = 0.0) -> np.ndarray:
    time = np.arange(round(seconds / T)) * T
    one = amplitude * np.sin(2 * np.pi * frequency * time + phase)
    return np.column_stack([one, one, one])


@pytest.mark.parametrize("time_constant", [0.05, 0.2])
def test_flc_settles_with_its_time_constant(time_constant):
    runner = Runner(flc.MODEL, {"combiner.time_constant": time_constant})
    position = _tone(time_constant, 10.0, 20 * MICROMETRE, phase=1.0)
    runner.run(len(position), {"position": position})
    weights = runner.x[3:].reshape(3, 2).T  # stacked by columns behind the phases
    reached = np.linalg.norm(weights, axis=0) / (20 * MICROMETRE)
    np.testing.assert_allclose(reached, 1 - np.exp(-1), atol=0.05)


def test_flc_is_the_equations():
    """Eq. 5.2 to 5.4 in plain NumPy, one axis."""
    position = np.random.default_rng(52).standard_normal((400, 3)) * MICROMETRE
    run = Runner(flc.MODEL, {"frequency": 9.0}).run(400, {"position": position})
    w, tones = np.zeros(2), []
    for k, s in enumerate(position[:, 1], start=1):
        x = np.array([np.sin(2 * np.pi * 9.0 * k * T), np.cos(2 * np.pi * 9.0 * k * T)])
        w = w + 2 * (T / 0.1) * x * (s - w @ x)
        tones.append(w @ x)
    np.testing.assert_allclose(run["tremor"][:, 1], tones, atol=1e-15)


@settings(max_examples=25)
@given(st.floats(8.0, 12.0), st.floats(20e-6, 2e-3), st.floats(0.0, 6.28))
def test_frequency_is_found_whatever_the_amplitude(frequency, amplitude, phase):
    position = _tone(6.0, frequency, amplitude, phase)
    run = Runner(wflc.MODEL).run(len(position), {"position": position})
    np.testing.assert_allclose(run["frequency"][-1], frequency, atol=0.05)
    settled = slice(-500, None)
    error = run["tremor"][settled] - position[settled]
    assert np.std(error) < 0.02 * np.std(position)


def test_frequency_settles_with_its_time_constant():
    start, frequency, time_constant = 10.0, 10.5, 1.0
    runner = Runner(wflc.MODEL, {"time_constant": time_constant})
    lead_in = _tone(2.0, start, 100 * MICROMETRE)
    runner.run(len(lead_in), {"position": lead_in})
    step = _tone(time_constant, frequency, 100 * MICROMETRE)
    found = runner.run(len(step), {"position": step})["frequency"][-1]
    reached = (found - start) / (frequency - start)
    np.testing.assert_allclose(reached, 1 - np.exp(-1), atol=0.1)


def test_frequency_rests_without_a_tone():
    noise = 0.1 * MICROMETRE * np.random.default_rng(3).standard_normal((20000, 3))
    run = Runner(wflc.MODEL).run(len(noise), {"position": noise})
    assert np.abs(run["frequency"] - 10.0).max() < 0.1


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(1e-9, 1.0))
def test_frequency_stays_within_its_limits(seed, scale):
    position = scale * np.random.default_rng(seed).uniform(-1, 1, (500, 3))
    run = Runner(wflc.MODEL).run(500, {"position": position})
    assert np.all((run["frequency"] >= 7.0) & (run["frequency"] <= 13.0))
    assert np.isfinite(run["tremor"]).all()
