"""C23's filter on data of its own model, at hard places and with bad samples."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.estimation.optical_ekf import MODEL, SPACE, optical_residual, process, then
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from tests.estimation.motions import (
    T,
    error,
    interval,
    quaternion,
    residual_function,
    slopes,
    swaying,
    there_and_back,
    turning,
    white,
)

BIAS = np.array([0.01, -0.02, 0.005])
NOISE, SIGMA = 2e-4, 2e-3
AGE, EVERY = 16, 16


def sensors(rates, truth, seed=1, age=AGE, every=EVERY, walk=0.0, noise=NOISE, sigma=SIGMA):
    """Inputs of the filter: gyro at every sample, attitude each `every`, `age` samples late."""
    rng = np.random.default_rng(seed)
    samples = len(rates)
    bias = BIAS + np.cumsum(rng.normal(size=(samples, 3)) * walk * np.sqrt(T), axis=0)
    new = (np.arange(samples) % every == 0) & (np.arange(samples) >= age)
    then = np.maximum(np.arange(samples) - age, 0)
    measured = truth[then] * Rotation.from_rotvec(rng.normal(size=(samples, 3)) * sigma)
    return {
        "rate": rates + bias + white(rng, noise, samples),
        "optical_attitude": quaternion(measured),
        "optical_new": new.astype(float),
        "optical_age": age * T,
    }


def still(samples, attitude=None):
    rates = np.zeros((samples, 3))
    return rates, Rotation.concatenate([attitude or Rotation.identity()] * samples)


def degrees(out, truth):
    return np.degrees(np.linalg.norm(error(out, truth), axis=1))


def test_prediction_is_c23_equation_11_with_the_body_rate_on_the_right():
    x = ca.SX.sym("x", SPACE.size)
    f = ca.Function("f", [x], [process(SPACE.record.unpack(x), 0.016).pack()])
    attitude, rate = Rotation.random(random_state=3), np.array([0.4, -2.0, 1.0])
    after = np.array(f(np.r_[quaternion(attitude), rate, BIAS, 0.004])).ravel()
    expected = quaternion(attitude * Rotation.from_rotvec(rate * 0.016))
    np.testing.assert_allclose(after, [*expected, *rate, *BIAS, 0.004], atol=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_residual_of_a_late_attitude_is_its_error(seed):
    f = residual_function(SPACE, optical_residual, then, 5)
    rng = np.random.default_rng(seed)
    past, since = Rotation.random(random_state=rng), Rotation.from_rotvec(rng.normal(size=3))
    noise = rng.normal(size=3) * 0.3
    measured = past * Rotation.from_rotvec(noise)
    state = np.r_[quaternion(past * since), np.zeros(7)]
    found = np.array(f(state, [*quaternion(since), 0.0], quaternion(measured))).ravel()
    np.testing.assert_allclose(found, noise, atol=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_slope_of_the_residual_is_that_of_the_prediction(seed):
    """Errors of attitude, rate and lag at once, small: both differ by their square."""
    rng = np.random.default_rng(seed)
    now, since = (quaternion(Rotation.random(random_state=rng)) for _ in range(2))
    state = [*now, *rng.normal(size=3), *BIAS, 0.004]
    error = rng.normal(size=SPACE.error_size) * 1e-4
    found, exact = SLOPES(state, error, [*since, -0.002])
    assert np.abs(np.array(exact)).max() > 1e-6
    np.testing.assert_allclose(np.array(found), np.array(exact), atol=3e-7)


SLOPES = slopes(SPACE, optical_residual, then, 5)


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_filter_starts_from_any_attitude(seed):
    rates, truth = still(200, Rotation.random(random_state=seed))
    out = Runner(MODEL).run(200, sensors(rates, truth, seed))
    assert degrees(out, truth)[100:].max() < 0.4
    assert out["valid"][100:].all()


@pytest.mark.parametrize("axis", [*np.eye(3), np.ones(3) / np.sqrt(3)])
def test_filter_starts_upside_down_and_at_a_half_turn(axis):
    """Where the scalar part is zero, and on either side of it."""
    for angle in (np.pi, np.pi - 1e-9, np.pi + 1e-9):
        rates, truth = still(200, Rotation.from_rotvec(angle * axis))
        out = Runner(MODEL).run(200, sensors(rates, truth))
        assert degrees(out, truth)[100:].max() < 0.4


def test_attitude_rate_and_bias_of_a_swaying_hand():
    rates = swaying(6000)
    truth = turning(rates)
    out = Runner(MODEL).run(6000, sensors(rates, truth))
    after = slice(3000, None)
    assert np.sqrt(np.mean(degrees(out, truth)[after] ** 2)) < 0.1
    assert np.abs(out["body_rate"] - rates)[after].max() < 0.02
    np.testing.assert_allclose(out["rate_bias"][-1], BIAS, atol=1e-3)
    assert (np.abs(out["rate_bias"][-1] - BIAS) < 4 * out["rate_bias_sigma"][-1]).all()


@pytest.mark.parametrize("length", [0.275, 0.5, 1.0])
def test_occlusion_is_bridged_and_flagged(length):
    """C23 Fig. 11: half a second; the held attitude is wrong by what was turned through."""
    samples, begin = 5000, 3500
    rates = swaying(samples)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    end = begin + round(length / T)
    inputs["optical_new"][begin:end] = 0
    out = Runner(MODEL).run(samples, inputs)
    held = np.degrees((truth[begin].inv() * truth[end]).magnitude())
    assert degrees(out, truth)[begin:end].max() < 0.3
    assert held > 5
    assert out["optical_lost"][begin + 150 : end].all()
    assert not out["optical_lost"][begin - 200 : begin].any()
    assert not out["optical_lost"][end + 20 :].any()


def test_occlusion_from_the_first_sample_on_is_never_valid():
    rates, truth = still(2000)
    inputs = sensors(rates, truth)
    inputs["optical_new"][:] = 0
    out = Runner(MODEL).run(2000, inputs)
    assert not out["valid"].any()
    assert out["optical_lost"][200:].all()
    np.testing.assert_array_equal(out["attitude"], np.tile([1, 0, 0, 0], (2000, 1)))


def test_late_attitudes_are_compared_with_then():
    """At 60 deg/s and 100 ms, six degrees would be wrong otherwise."""
    rates = np.tile([0.0, np.radians(60), 0.0], (3000, 1))
    truth = turning(rates)
    out = Runner(MODEL).run(3000, sensors(rates, truth, age=100))
    assert degrees(out, truth)[1500:].max() < 0.3


@pytest.mark.parametrize("age", [0, 16])
def test_lag_of_the_gyro_is_found(age):
    """The gyro is 4 ms late; at 3 rad/s that is 0.7 deg, and the filter does not know it."""
    samples, lag = 8000, 4
    rates = swaying(samples, 2.5)
    truth = turning(rates)
    inputs = sensors(rates, truth, age=age)
    inputs["rate"][lag:] = inputs["rate"][:-lag].copy()
    wide = {"limits.rate_range": 50.0}
    out = Runner(MODEL, wide | {"lag_sigma": 0.01}).run(samples, inputs)
    assert out["lag_seen"][-1] == pytest.approx(lag * T, abs=3e-4)
    assert abs(out["lag_seen"][-1] - lag * T) < 4 * out["lag_seen_sigma"][-1]
    known = Runner(MODEL, wide | {"lag": lag * T}).run(samples, inputs)
    unknown = Runner(MODEL, wide).run(samples, inputs)
    for found in (out, known):
        assert degrees(found, truth)[4000:].max() < 0.25
    assert degrees(unknown, truth)[4000:].max() > 0.5


def test_attitude_older_than_what_is_kept_is_not_taken():
    rates, truth = still(1000)
    out = Runner(MODEL).run(1000, sensors(rates, truth) | {"optical_age": 0.5})
    assert not out["valid"].any()
    assert out["optical_lost"][200:].all()


def test_duplicated_and_frozen_attitudes_are_taken_once():
    samples = 3000
    rates = np.tile([0.0, 0.0, 0.5], (samples, 1))
    truth = turning(rates)
    inputs = sensors(rates, truth)
    frozen = inputs["optical_attitude"].copy()
    frozen[2000:] = frozen[1984]
    out = Runner(MODEL).run(samples, inputs | {"optical_attitude": frozen})
    assert out["optical_lost"][2150:].all()
    assert degrees(out, truth)[1000:].max() < 0.4
    assert out["innovation_size"][2000:].max() == 3


@pytest.mark.parametrize("fault", ["lost", "frozen", "clipped"])
def test_gyro_that_is(fault):
    """From 2 s to 2.5 s; the tracker goes on, so the error stays small."""
    samples, bad = 4000, slice(2000, 2500)
    rates = swaying(samples, 0.3)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    valid = np.ones(samples)
    if fault == "lost":
        valid[bad], inputs["rate"][bad] = 0, 7.0
    elif fault == "frozen":
        inputs["rate"][bad] = inputs["rate"][1999]
    else:
        inputs["rate"][bad] = 4.36
    out = Runner(MODEL).run(samples, inputs | {"inertial_valid": valid})
    assert out["inertial_lost"][2030:2500].all()
    assert not out["inertial_lost"][1000:2000].any()
    assert not out["inertial_lost"][2510:].any()
    assert degrees(out, truth)[1000:].max() < 1.5
    assert degrees(out, truth)[3000:].max() < 0.4


def test_garbage_of_the_tracker_is_bounded():
    """An attitude that is wrong by a half turn, once; and four numbers that are none."""
    samples = 3000
    rates, truth = still(samples)
    inputs = sensors(rates, truth)
    inputs["optical_attitude"][2000] = [0, 0, 0, 1]
    inputs["optical_attitude"][2016] = 0
    out = Runner(MODEL).run(samples, inputs)
    assert out["innovation_squared"][2000] > 1e4
    assert degrees(out, truth)[1000:].max() < 0.6
    assert out["innovation_size"][2016] == 3  # the gyro's alone


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_normalised_innovations_are_consistent(seed):
    """Mean NIS of tracker and gyro in its 95 % interval, angular acceleration as modelled."""
    samples, walk, push = 60_000, 1e-4, 3.0
    rng = np.random.default_rng(100 + seed)
    rates = np.cumsum(white(rng, push, samples) * T, axis=0)
    # Between two samples the rate is a Brownian bridge about a straight line.
    bridge = rng.normal(size=(samples - 1, 3)) * push * np.sqrt(T**3 / 24)
    truth = turning(rates, beside=bridge)
    inputs = sensors(rates, truth, seed, walk=walk, age=0)
    parameters = {"bias_walk": walk, "angular_acceleration": push, "limits.rate_range": 1e3}
    out = CompiledRunner(MODEL, parameters).run(samples, inputs)
    after = slice(5000, None)
    size = out["innovation_size"][after]
    mean = out["innovation_squared"][after].sum() / size.sum()
    low, high = interval(size.sum())
    print(f"mean NIS {mean:.4f} in [{low:.4f}, {high:.4f}]")
    assert low < mean < high
    # And against the truth: errors last for about a tenth of a second.
    normalised = error(out, truth)[after] / out["attitude_sigma"][after]
    assert np.mean(normalised**2) == pytest.approx(1, abs=0.1)


@pytest.mark.slow
def test_covariance_stays_positive_and_the_quaternion_unit_for_half_an_hour():
    rates = there_and_back(60_000, 0.3)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    runner = CompiledRunner(MODEL, {"lag_sigma": 5e-3})
    at = _place(MODEL, "P")
    for _ in range(30):
        out = runner.run(len(rates), inputs)
        length = np.linalg.norm(out["attitude"], axis=1)
        assert np.abs(length - 1).max() < 1e-12
        P = runner.x[at].reshape(10, 10)
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() > 0
        assert out["valid"][200:].all()
        assert degrees(out, truth)[5000:].max() < 0.4


def _place(model, name):
    """Elements of a field in the stacked state, among them ones that are not listed."""
    names = [scalar.name.partition("[")[0] for scalar in model.state.scalars()]
    return np.flatnonzero(np.array(names) == name)
