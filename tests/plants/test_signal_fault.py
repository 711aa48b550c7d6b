"""The fault in a wire: nothing at first, and then what its parameters say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.kit.runner import Runner
from plants.signal_fault import MODEL

STEPS = 4000


def through(signal: np.ndarray, **parameters) -> np.ndarray:
    runner = Runner(MODEL, {"seed": 5, **parameters})
    return runner.run(len(signal), {"signal": signal})["faulty"]


@pytest.fixture(scope="module")
def ramp() -> np.ndarray:
    return np.linspace(-3.0, 7.0, STEPS)


@given(st.floats(allow_nan=False, allow_infinity=False, width=64))
def test_as_it_starts_it_passes_a_value_to_the_last_digit(value):
    assert through(np.array([value]))[0] == value


def test_gain_and_offset(ramp):
    assert np.allclose(through(ramp, gain=2.0, offset=0.5), 2.0 * ramp + 0.5, rtol=1e-15)


def test_noise_is_white_and_as_large_as_it_says(ramp):
    noise = through(ramp, noise=0.3) - ramp
    # Five standard deviations of a mean, a standard deviation and a correlation of so many samples.
    assert abs(noise.mean()) < 5 * 0.3 / np.sqrt(STEPS)
    assert abs(noise.std() / 0.3 - 1) < 5 / np.sqrt(2 * STEPS)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 5 / np.sqrt(STEPS)


def test_lost_samples_hold_the_last_one_as_often_as_it_says(ramp):
    faulty = through(ramp, dropout=0.25)
    held = np.flatnonzero(faulty[1:] != ramp[1:]) + 1
    assert np.array_equal(faulty[held], faulty[held - 1])
    share = len(held) / STEPS
    assert abs(share - 0.25) < 5 * np.sqrt(0.25 * 0.75 / STEPS)


def test_with_every_sample_lost_it_is_stuck(ramp):
    assert not through(ramp, dropout=1.0).any()


def test_losses_and_noise_are_independent(ramp):
    clean, noisy = through(ramp, dropout=0.25), through(ramp, dropout=0.25, noise=1e-9)
    lost = np.diff(clean) == 0.0
    assert np.array_equal(lost, np.diff(noisy) == 0.0)
