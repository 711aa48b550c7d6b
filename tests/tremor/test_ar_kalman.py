"""AR model with Kalman adaptation: its equations, its covariance, and what it reaches on hands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from fmu_src.kit.runner import Runner
from fmu_src.tremor import ar_kalman
from fmu_src.tremor.ar_kalman import AHEAD, AXES, LEAST_MOVE, LOWER, MODEL, NOISE, ORDER, STRIDE
from harness.reproduce.experiments import tremor as bench

T = 1e-3
LEFT = np.exp(-T / 300.0)


def run(position, valid=1.0, **parameters):
    inputs = {"position": position, "valid": valid}
    return Runner(MODEL, parameters).run(len(position), inputs)["tremor"]


def tones(seconds, ahead=0.0):
    """9, 10 and 11 Hz, 30 um, (n, 3) [m]."""
    time = np.arange(round(seconds / T)) * T + ahead
    return 30e-6 * np.sin(2 * np.pi * np.outer(time, [9.0, 10.0, 11.0]))


def walk(samples, seed=1):
    """Something with a spectrum that a few coefficients do not explain, (samples, 3) [m]."""
    steps = np.random.default_rng(seed).standard_normal((samples, 3))
    return 1e-6 * np.cumsum(steps, axis=0) + tones(samples * T)


def learnt(x):
    """Coefficients, (ORDER, AXES), and covariance of each axis, (AXES, ORDER, ORDER)."""
    state = MODEL.state.unpack(x)
    triangle = state.covariance.T
    P = np.zeros((AXES, ORDER, ORDER))
    row, column = (np.array(places) for places in LOWER.get_triplet())
    P[:, row, column] = triangle
    P[:, column, row] = triangle
    return state.coefficients, P


def test_is_the_equations():
    """The Kalman filter in its textbook form in NumPy, one axis, and the forecast step by step."""
    horizon, wash_out, n = 3e-3, 0.5, 1500
    position = walk(n)
    runner = Runner(MODEL, {"horizon": horizon, "wash_out": wash_out})
    found = runner.run(n, {"position": position})["tremor"][:, 1]
    past, later = np.split(runner.d[:-1], [AHEAD + 1])

    s = np.concatenate([np.zeros(STRIDE * (AHEAD + 1)), position[:, 1] - position[0, 1]])
    v = np.concatenate([np.zeros(STRIDE), s[STRIDE:] - s[:-STRIDE]])
    prior = np.eye(ORDER)[0] * ar_kalman.KEEPS
    a, P, unrest, expected = prior, np.eye(ORDER), 0.0, []
    for k in range(STRIDE * (AHEAD + 1), len(s)):
        forecast = list(v[k - STRIDE * (ORDER - 1) : k + 1 : STRIDE])
        largest = ar_kalman.REACH * np.abs(forecast).max()
        for _ in range(AHEAD):
            forecast.append(np.clip(a @ forecast[: -ORDER - 1 : -1], -largest, largest))
        there = s[k] + np.cumsum(forecast[ORDER:])
        weights = later - np.append(later[1:], 0.0)
        expected.append(past @ s[k - STRIDE * AHEAD : k + 1 : STRIDE][::-1] + weights @ there)

        h = v[k - STRIDE * ORDER : k : STRIDE][::-1]
        e = v[k] - a @ h
        R = NOISE * (unrest + e**2 + LEAST_MOVE**2)
        K = P @ h / (h @ P @ h + R)
        whole = np.eye(ORDER) - np.outer(K, h)
        P = whole @ P @ whole.T + R * np.outer(K, K)
        a = a + K * e
        a, P = prior + LEFT * (a - prior), LEFT**2 * P + (1 - LEFT**2) * np.eye(ORDER)
        unrest += T / ar_kalman.INNOVATION * (e**2 - unrest)
    assert np.std(expected) > 1e-6
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.std(expected))
    coefficients, covariance = learnt(runner.x)
    np.testing.assert_allclose(coefficients[:, 1], a, atol=1e-8)
    np.testing.assert_allclose(covariance[1], P, atol=1e-8)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(-9.0, 0.0))
def test_covariance_and_coefficients_stay_within_limits_whatever_comes_in(seed, size):
    """P between (1 - l^2) I and I; a sample moves the coefficients no farther than it may.

    And what is put out is no more than the moves in memory and a forecast within reach allow.
    """
    generator = np.random.default_rng(seed)
    runner, before = Runner(MODEL), learnt(MODEL.state.starts())[0]
    past, later = np.split(runner.d[:-1], [AHEAD + 1])
    of_moves = np.abs(np.cumsum(past)[:-1] + later[0]).sum()
    most = of_moves + ar_kalman.REACH * np.abs(later).sum()
    scale = 10.0 ** generator.choice([size, size / 2, 0.0], 300)
    for k in range(300):
        where = scale[k] * generator.choice([-1.0, 0.0, 0.3, 1.0], 3)
        y = runner.run(1, {"position": where, "valid": generator.integers(0, 2)})["tremor"]
        assert np.all(np.isfinite(runner.x))
        strides = MODEL.state.unpack(runner.x).motion[:, ::STRIDE]
        assert np.abs(y).max() <= most * np.abs(np.diff(strides)).max() + 1e-12
        coefficients, P = learnt(runner.x)
        values = np.linalg.eigvalsh(P)
        assert values.min() > 0.999 * (1 - LEFT**2)
        assert values.max() < 1 + 1e-12
        moved = np.linalg.norm(coefficients - before, axis=0)
        home = (1 - LEFT) * np.linalg.norm(before - ar_kalman.PRIOR[:, None], axis=0)
        assert np.all(moved <= 1 / (2 * np.sqrt(NOISE)) + home + 1e-12)
        before = coefficients


def test_covariance_after_a_long_rest_and_a_long_tone():
    """Neither what is never excited nor what is known without error leaves the limits."""
    for position in (np.zeros((20_000, 3)), tones(20.0)):
        runner = Runner(MODEL)
        runner.run(len(position), {"position": position})
        values = np.linalg.eigvalsh(learnt(runner.x)[1])
        assert values.min() > 0.999 * (1 - LEFT**2)
        assert values.max() < 1 + 1e-12


@pytest.mark.parametrize("horizon", [0.0, 4e-3, 9.5e-3])
def test_a_tone_comes_out_whole_and_a_horizon_ahead(horizon):
    found = run(tones(6.0), horizon=horizon)
    assert np.abs(found - tones(6.0, horizon))[4000:].max() < 0.06 * 30e-6


def test_a_larger_hand_is_learnt_as_fast():
    motion = walk(3000)
    np.testing.assert_allclose(run(5 * motion), 5 * run(motion), atol=1e-3 * 30e-6)


def test_a_wash_out_ahead_of_the_filter_is_undone():
    sections = signal.butter(3, 1.0, "highpass", fs=1 / T, output="sos")
    washed = signal.sosfilt(sections, tones(8.0), axis=0)
    error = np.abs(run(washed, wash_out=1.0) - tones(8.0))[6000:].max()
    assert error < 0.06 * 30e-6
    assert np.abs(run(washed) - tones(8.0))[6000:].max() > 0.15 * 30e-6


def test_positions_count_from_the_first_and_gaps_are_bridged():
    """An offset changes nothing; a gap of 50 ms hardly shows, a long one fades; no steps."""
    tone = tones(8.0)
    known = run(tone)
    np.testing.assert_allclose(run(tone + 0.3), known, atol=1e-10)
    valid = np.ones(8000)
    for gap, within, after in ((50, 0.35, 0.05), (2000, 2.0, 0.3)):
        valid[4000 : 4000 + gap] = 0
        position = np.where(valid[:, None] > 0, tone, 0.7)
        position[4000 + gap :] += 0.02
        found = run(position, valid)
        error = np.abs(found - known) / 30e-6
        assert not error[:4000].any()
        assert error[4000:].max() < within
        assert error[7500:].max() < after
    assert np.abs(found[5500:6000]).max() < 0.05 * 30e-6
    np.testing.assert_array_equal(run(np.full((300, 3), 0.7), 0.0), 0.0)


@pytest.mark.parametrize("motion", list(bench.intents()), ids=lambda motion: motion.name)
def test_intent_alone_is_left_alone(motion):
    assert bench.disturbance(motion, run(motion.position)) < 0.1


@pytest.mark.parametrize(
    ("delay", "mean", "worst"),
    [
        (0, (46.5, 55.4), (36.3, 46.5)),
        pytest.param(4, (43.7, 53.2), (33, 43.8), marks=pytest.mark.slow),
        pytest.param(8, (42, 52), (30.6, 42.3), marks=pytest.mark.slow),
    ],
)
def test_recorded_hands_with_a_delay_of_the_loop(ranked, delay, mean, worst):
    """[ms]; one set of parameters, no training on a trial; a-posteriori and in-band."""
    column = ranked(MODEL.name, delay * T)
    for found, wanted in ((column.mean, mean), (column.worst, worst)):
        assert found.a_posteriori > wanted[0]
        assert found.in_band > wanted[1]
