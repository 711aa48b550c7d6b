"""The fixed filter: against SciPy, exact where it says so, and what it reaches on hands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from fmu_src.kit.runner import Runner
from fmu_src.tremor.shelving import CENTRE, LARGEST_LEAD, MODEL, QUALITY, SECTIONS
from harness.reproduce.experiments import tremor as bench

T = 1e-3
GAIN = MODEL.parameters.fields["gain"].start[0]


def run(position, valid=1.0, **parameters):
    inputs = {"position": position, "valid": valid}
    return Runner(MODEL, parameters).run(len(position), inputs)["tremor"]


def response(frequency, **parameters):
    """From the position to what is put out, complex, at frequencies [Hz]."""
    b, a_1, a_2, gain = Runner(MODEL, parameters).d
    _, section = signal.freqz([b, 0, -b], [1, a_1, a_2], frequency, fs=1 / T)
    return gain * section**SECTIONS


def test_is_the_band_pass_of_scipy():
    """Analogue prototype with its centre prewarped, by the bilinear transform, twice."""
    w = 2 / T * np.tan(np.pi * CENTRE * T)
    section = signal.bilinear([w / QUALITY, 0], [1, w / QUALITY, w**2], 1 / T)
    position = 1e-5 * np.cumsum(np.random.default_rng(1).standard_normal((600, 3)), axis=0)
    expected = GAIN * (position - position[0])
    for _ in range(SECTIONS):
        expected = signal.lfilter(*section, expected, axis=0)
    np.testing.assert_allclose(run(position), expected, atol=1e-12)


@settings(max_examples=50)
@given(horizon=st.floats(0.0, 0.034), wash_out=st.floats(0.0, 5.0), gain=st.floats(0.1, 1.0))
def test_a_tone_of_the_centre_is_exact_whatever_lies_around_the_filter(horizon, wash_out, gain):
    found = response([CENTRE], horizon=horizon, wash_out=wash_out, gain=gain)
    lag = -1j * wash_out / CENTRE
    washed = 1 / ((1 + lag) * (1 + lag + lag**2))
    wanted = gain * np.exp(2j * np.pi * CENTRE * horizon)
    np.testing.assert_allclose(found * washed, wanted, atol=1e-9)


def test_beyond_the_largest_lead_the_filter_stays_as_it_is():
    frequencies = np.linspace(1.0, 500.0, 1000)[:-1]
    most = response(frequencies, horizon=0.05)
    edge = SECTIONS * LARGEST_LEAD / (2 * np.pi * CENTRE)
    np.testing.assert_allclose(most, response(frequencies, horizon=edge), atol=1e-9)
    assert np.abs(most).max() < 3


def test_tones_beside_the_centre_are_off_in_phase_as_a_fixed_filter_must():
    for horizon, off in ((0.0, 31), (8e-3, 40)):
        tones = np.array([8.0, 12.0])
        found = response(tones, horizon=horizon) * np.exp(-2j * np.pi * tones * horizon)
        assert np.all(np.abs(np.degrees(np.angle(found))) < off)
        assert np.all((np.abs(found) > 0.6) & (np.abs(found) < 0.8))


def test_nothing_is_learnt():
    """Linear, and the same at any time: twice the motion is twice the tremor, later is later."""
    motion = 1e-6 * np.cumsum(np.random.default_rng(3).standard_normal((800, 3)), axis=0)
    motion -= motion[0]
    np.testing.assert_allclose(run(2 * motion), 2 * run(motion), atol=1e-15)
    later = np.vstack((np.zeros((500, 3)), motion))
    np.testing.assert_allclose(run(later)[500:], run(motion), atol=1e-15)
    np.testing.assert_allclose(run(motion + 0.3), run(motion), atol=1e-12)


def test_the_output_dies_away_while_the_position_is_not_valid():
    """Garbage is not looked at, and coming back somewhere else is no step."""
    time = np.arange(4000) * T
    tone = 20e-6 * np.sin(2 * np.pi * 10 * time[:, None] + np.arange(3.0))
    valid = np.ones(4000)
    valid[2000:2400] = 0
    position = np.where(valid[:, None] > 0, tone, 0.7)
    position[2400:] += 0.02
    found = run(position, valid)
    assert np.abs(found[2200:2400]).max() < 0.02 * 20e-6
    assert np.abs(found).max() < 1.5 * 20e-6
    np.testing.assert_allclose(found[2800:], run(tone)[2800:], atol=0.01 * 20e-6)
    np.testing.assert_array_equal(run(np.full((300, 3), 0.7), 0.0), 0.0)


@pytest.mark.parametrize(
    ("motion", "most"),
    list(zip(bench.intents(), (2.1, 0.01, 0.4, 1.4), strict=True)),
    ids=lambda each: getattr(each, "name", None),
)
def test_intent_alone_passes_but_for_two_per_cent(motion, most):
    assert bench.disturbance(motion, run(motion.position)) < most


@pytest.mark.parametrize(
    ("delay", "mean", "worst"),
    [(0, (35, 48.5), (22.7, 44.2)), (4, (35.9, 46), (25.2, 41.6)), (8, (35.6, 43.7), (26, 39.4))],
)
def test_recorded_hands_with_a_delay_of_the_loop(ranked, delay, mean, worst):
    """[ms]; a-posteriori and in-band."""
    column = ranked(MODEL.name, delay * T)
    for found, wanted in ((column.mean, mean), (column.worst, worst)):
        assert found.a_posteriori > wanted[0]
        assert found.in_band > wanted[1]
