"""RK's filter on data of its own model, at hard places and with bad samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.estimation.em_ekf.model import MODEL
from fmu_src.estimation.em_ekf.state import SPACE, coils, tracker_residual
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from tests.estimation.motions import (
    GRAVITY,
    NORTH,
    T,
    error,
    interval,
    quaternion,
    residual_function,
    rotation,
    slopes,
    swaying,
    there_and_back,
    turning,
    white,
)

BIAS = np.array([0.01, -0.02, 0.005])
SIGMA = np.radians(0.1)
AGE, EVERY = 25, 25
RATE_NOISE, FORCE_NOISE, FIELD_NOISE = 1.75e-4, 3e-3, 8.5e-8


def sensors(rates, truth, seed=1, age=AGE, distortion=None, noise=1.0, force_bias=0.0):
    """Inputs of the filter: inertial unit at every sample, tracker each 25 ms, `age` samples late.

    Args:
        rates: body rates, (n, 3) [rad/s].
        truth: attitudes, n.
        seed: of the noise.
        age: of the tracker's attitudes, samples.
        distortion: rotation vectors of the tracker's error in W, (n, 3) or (3,) [rad].
        noise: factor of all noise.
        force_bias: of the accelerometer [m/s2].
    """
    rng = np.random.default_rng(seed)
    samples = len(rates)
    up, north = truth.inv().apply([0, 0, GRAVITY]), truth.inv().apply(NORTH)
    at = np.arange(samples)
    then = np.maximum(at - age, 0)
    bent = (
        np.zeros((samples, 3)) if distortion is None else np.broadcast_to(distortion, (samples, 3))
    )
    measured = Rotation.from_rotvec(bent[then]) * truth[then]
    measured = measured * Rotation.from_rotvec(rng.normal(size=(samples, 3)) * SIGMA * noise)
    return {
        "rate": rates + BIAS + noise * white(rng, RATE_NOISE, samples),
        "force": up + force_bias + noise * white(rng, FORCE_NOISE, samples),
        "field": north + noise * white(rng, FIELD_NOISE, samples),
        "em_attitude": quaternion(measured),
        "em_new": ((at % EVERY == 0) & (at >= age)).astype(float),
        "em_position": [0.3, 0.0, 0.0],
        "em_age": age * T,
    }


def still(samples, attitude=None):
    rates = np.zeros((samples, 3))
    return rates, Rotation.concatenate([attitude or Rotation.identity()] * samples)


def run(inputs, parameters=None):
    return Runner(MODEL, parameters).run(len(inputs["rate"]), inputs)


def degrees(out, truth):
    return np.degrees(np.linalg.norm(error(out, truth), axis=1))


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_residual_is_the_error_of_a_late_distorted_attitude(seed):
    """RK III.B by SciPy: coil in tracker's frame through registration, body and hand-eye."""
    f = residual_function(SPACE, tracker_residual, coils)
    rng = np.random.default_rng(seed)
    then, since, hand_eye, registration = (Rotation.random(random_state=rng) for _ in range(4))
    bent, noise = rng.normal(size=3) * 0.2, rng.normal(size=3) * 0.3
    coil = Rotation.from_rotvec(bent) * registration.inv() * then * hand_eye
    measured = coil * Rotation.from_rotvec(noise)
    state = [*quaternion(then * since), *np.zeros(6), *bent]
    state += [*quaternion(hand_eye), *quaternion(registration)]
    found = np.array(f(state, quaternion(since), quaternion(measured))).ravel()
    np.testing.assert_allclose(found, noise, atol=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_slope_of_the_residual_is_that_of_the_prediction(seed):
    """Errors of all states at once, small: both differ by their square."""
    rng = np.random.default_rng(seed)
    then, since, hand_eye, registration = (
        quaternion(Rotation.random(random_state=rng)) for _ in range(4)
    )
    state = [*then, *np.zeros(6), *rng.normal(size=3) * 0.2, *hand_eye, *registration]
    error = rng.normal(size=SPACE.error_size) * 1e-4
    found, exact = SLOPES(state, error, since)
    assert np.abs(np.array(exact)).max() > 1e-6
    np.testing.assert_allclose(np.array(found), np.array(exact), atol=3e-7)


SLOPES = slopes(SPACE, tracker_residual, coils)


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_filter_starts_from_any_attitude(seed):
    rates, truth = still(400, Rotation.random(random_state=seed))
    out = run(sensors(rates, truth, seed))
    assert degrees(out, truth)[200:].max() < 0.5
    assert out["valid"][200:].all()


@pytest.mark.parametrize("axis", [*np.eye(3), np.ones(3) / np.sqrt(3)])
def test_filter_starts_upside_down_and_at_a_half_turn(axis):
    """From the tracker, and without one from gravity and field."""
    for angle in (np.pi, np.pi - 1e-9, np.pi + 1e-9):
        rates, truth = still(700, Rotation.from_rotvec(angle * axis))
        inputs = sensors(rates, truth)
        out = run(inputs)
        assert degrees(out, truth)[200:].max() < 0.5
        inputs["em_new"] *= 0
        out = run(inputs)
        assert degrees(out, truth)[400:].max() < 3.0


def test_swaying_hand_with_distorted_tracker():
    """Distortion of a degree that comes and goes as the instrument turns: the filter halves it."""
    samples = 12_000
    rates = swaying(samples)
    truth = turning(rates)
    bent = np.radians(1.0) * truth.apply([0, 0, 1])[:, [1, 2, 0]]
    out = run(sensors(rates, truth, distortion=bent), {"tracker.distortion_sigma": 0.015})
    after = slice(4000, None)
    rms = np.sqrt(np.mean(degrees(out, truth)[after] ** 2))
    assert rms < 0.5
    np.testing.assert_allclose(out["rate_bias"][-1], BIAS, atol=1e-3)
    np.testing.assert_allclose(
        out["body_rate"][after], rates[after], atol=6 * RATE_NOISE * np.sqrt(500)
    )


@pytest.mark.slow
def test_hand_eye_rotation_and_registration_are_found_as_states():
    """Known to 3 deg only; gravity and field tell B's attitude, the tracker C's."""
    samples = 20_000
    rates = swaying(samples, 0.8)
    truth = turning(rates)
    hand_eye = Rotation.from_rotvec([0.03, -0.04, 0.02])
    inputs = sensors(rates, truth)
    coils = rotation(inputs["em_attitude"]) * hand_eye
    inputs["em_attitude"] = quaternion(coils)
    parameters = {
        "tracker.mounting_sigma": 0.05,
        "tracker.distortion_sigma": 0.0,
        "magnetic.heading_density": 0.01,
        "inertial.hand_density": 0.005,
    }
    out = run(inputs, parameters)
    found = rotation(out["mounting"][-1])
    assert np.degrees((found.inv() * hand_eye).magnitude()) < 0.25
    assert np.degrees(out["mounting_sigma"][-1]).max() < 0.2
    assert degrees(out, truth)[-5000:].max() < 0.5


def test_tracker_lost_for_ten_seconds_is_flagged_and_bridged():
    """RK IV.B: the unit alone gives the attitude of slow motions."""
    samples = 15_000
    rates = swaying(samples, 0.3)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    inputs["em_new"][4000:14_000] = 0
    out = run(inputs)
    assert out["em_lost"][4300:14_000].all()
    assert not out["em_lost"][1000:4000].any()
    assert not out["em_lost"][14_030:].any()
    assert degrees(out, truth)[2000:].max() < 1.0


def test_tracker_lost_from_the_first_sample_on():
    """Gravity and field start the filter after the wait; the tracker is flagged."""
    rates, truth = still(3000, Rotation.from_euler("xyz", [30, 20, 10], degrees=True))
    inputs = sensors(rates, truth)
    inputs["em_new"][:] = 0
    out = run(inputs)
    assert out["em_lost"][300:].all()
    assert not out["valid"][:290].any()
    assert degrees(out, truth)[1000:].max() < 3.0
    # Heading by the magnetometer is not sure to a degree: it says so.
    assert (np.degrees(out["attitude_sigma"][-1]) > 0.3).any()


def test_everything_lost_from_the_first_sample_on_is_never_valid():
    rates, truth = still(2000)
    inputs = sensors(rates, truth) | {"inertial_valid": 0.0, "em_new": 0.0}
    out = run(inputs)
    assert not out["valid"].any()
    assert out["inertial_lost"][100:].all()
    assert out["em_lost"][300:].all()


def test_late_attitudes_are_compared_with_then():
    """At 60 deg/s and 100 ms, six degrees would be wrong otherwise."""
    rates = np.tile([0.0, 0.0, np.radians(60)], (3000, 1))
    truth = turning(rates)
    out = run(sensors(rates, truth, age=100))
    assert degrees(out, truth)[1500:].max() < 0.6


def test_lag_of_the_inertial_unit_that_is_known_is_made_good():
    """4 ms at 3 rad/s are 0.7 deg."""
    samples, lag = 4000, 4
    rates = swaying(samples, 2.5)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    for name in ("rate", "force", "field"):
        inputs[name][lag:] = inputs[name][:-lag].copy()
    wide = {"limits.rate_range": 50.0}
    known = run(inputs, wide | {"tracker.lag": lag * T})
    unknown = run(inputs, wide)
    rms = [np.sqrt(np.mean(degrees(out, truth)[2000:] ** 2)) for out in (known, unknown)]
    assert rms[0] < 0.25
    assert rms[0] < 0.4 * rms[1]


def test_attitudes_older_than_what_is_kept_are_not_taken():
    rates, truth = still(1000)
    out = run(sensors(rates, truth) | {"em_age": 0.5})
    assert out["em_lost"][300:].all()


def test_duplicated_and_frozen_attitudes_are_taken_once():
    samples = 4000
    rates = np.tile([0.0, 0.0, 0.3], (samples, 1))
    truth = turning(rates)
    inputs = sensors(rates, truth)
    inputs["em_attitude"][2000:] = inputs["em_attitude"][1975]
    out = run(inputs)
    assert out["em_lost"][2300:].all()
    assert degrees(out, truth)[1000:].max() < 1.5


@pytest.mark.parametrize("fault", ["lost", "frozen"])
def test_inertial_unit_that_is(fault):
    """From 2 s to 2.5 s; only the tracker goes on, so what turns within 50 ms is not seen."""
    samples, bad = 5000, slice(2000, 2500)
    rates = swaying(samples, 0.3)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    valid = np.ones(samples)
    if fault == "lost":
        valid[bad] = 0
        inputs["rate"][bad] = 3.0
    else:
        for name in ("rate", "force", "field"):
            inputs[name][bad] = inputs[name][1999]
    out = run(inputs | {"inertial_valid": valid})
    assert out["inertial_lost"][2030:2500].all()
    assert not out["inertial_lost"][1000:2000].any()
    assert not out["inertial_lost"][2510:].any()
    assert not out["valid"][2100:2500].all()
    assert degrees(out, truth)[1000:].max() < 5.0
    assert degrees(out, truth)[3500:].max() < 0.8


def test_clipped_gyro_is_flagged_and_made_good():
    """A jerk of 7 rad/s about one axis where the gyro ends at 4.36."""
    samples = 5000
    t = T * np.arange(samples)
    rates = np.outer(7 * np.exp(-(((t - 2) / 0.04) ** 2)), [1, 0, 0])
    truth = turning(rates)
    inputs = sensors(rates, truth)
    inputs["rate"] = np.clip(inputs["rate"], -4.36, 4.36)
    beyond = inputs["rate"][:, 0] >= 4.36
    missed = np.degrees((rates[:, 0] - 4.36 + BIAS[0])[beyond].sum() * T)
    out = run(inputs)
    np.testing.assert_array_equal(out["inertial_lost"], beyond)
    assert missed > 4
    assert degrees(out, truth)[1000:].max() < missed + 0.5
    assert degrees(out, truth)[2300:].max() < 1.0


def test_magnet_brought_near_is_flagged_and_left_out():
    """70 uT across for two seconds, without a tracker: the field alone gives the heading.

    It counts again once it has been right for as long as may be asked for, two seconds.
    """
    samples, near = 8000, slice(3000, 5000)
    rates, truth = still(samples)
    inputs = sensors(rates, truth)
    inputs["em_new"][1000:] = 0
    inputs["field"][near] += [0.0, 7e-5, 0.0]
    out = run(inputs)
    assert out["magnetic_disturbance"][3020:6980].all()
    assert not out["magnetic_disturbance"][1000:3000].any()
    assert not out["magnetic_disturbance"][7030:].any()
    before = degrees(out, truth)[2900:3000].max()
    assert degrees(out, truth)[3000:].max() < before + 0.5


def test_magnet_of_a_moment_is_doubted_for_a_moment():
    """A tenth of a second of iron, three tenths of doubt."""
    rates, truth = still(4000)
    inputs = sensors(rates, truth)
    inputs["field"][2000:2100] += [0.0, 7e-5, 0.0]
    flagged = run(inputs)["magnetic_disturbance"]
    assert flagged[2020:2380].all()
    assert not flagged[1000:2000].any()
    assert not flagged[2450:].any()


def test_magnet_on_a_turning_instrument_does_not_turn_the_heading():
    """Strength and dip are right by chance now and then; 15 s on the gyro, and 5 s after it.

    Each such moment believed, the heading is off by degrees.
    """
    samples, tracked, on = 25000, 5000, slice(5000, 20000)
    apart = {0.0: [], 2.0: []}
    for seed, magnet in ((1, [0, 0, 30e-6]), (2, [30e-6, 0, 0]), (4, [0, 20e-6, 10e-6])):
        rates = swaying(samples, 0.8, seed)
        truth = turning(rates)
        inputs = sensors(rates, truth, seed)
        inputs["em_new"][tracked:] = 0
        inputs["field"][on] += magnet
        for hold, worst in apart.items():
            out = CompiledRunner(MODEL, {"magnetic.hold": hold}).run(samples, inputs)
            worst.append(degrees(out, truth)[tracked:].max())
        assert out["magnetic_disturbance"][on][20:].all()
    assert min(apart[0.0]) > 2.0
    assert max(apart[2.0]) < 0.4


def test_field_that_stays_another_gives_the_heading_in_the_end():
    """Half as strong again and 20 deg to the east, for good: a heading is better than none."""
    samples = 60000
    rates, truth = still(samples)
    inputs = sensors(rates, truth)
    inputs["em_new"][1000:] = 0
    inputs["field"][5000:] = 1.5 * Rotation.from_euler("z", -20, degrees=True).apply(
        inputs["field"][5000:]
    )
    out = CompiledRunner(MODEL).run(samples, inputs)
    assert out["magnetic_disturbance"][5020:].all()
    west = np.degrees(error(out, truth)[:, 2])  # so it turns to have the field in the north
    assert abs(west[6000]) < 1.0
    assert 10.0 < west[-1] < 20.0


def test_push_does_not_tilt():
    """Two metres per square second sideways for 0.3 s: eleven degrees of gravity's direction."""
    samples = 5000
    rates, truth = still(samples)
    inputs = sensors(rates, truth)
    inputs["em_new"][2500:] = 0
    inputs["force"][3000:3300] += [2.0, 0.0, 0.0]
    out = run(inputs)
    assert out["accelerated"][3020:3300].all()
    assert not out["accelerated"][2000:3000].any()
    assert degrees(out, truth)[2000:].max() < 0.6


def test_metal_beside_the_tracker_pulls_little():
    """Ten degrees for a second, as RK I report of a small tool; the angle is back at once."""
    samples = 6000
    rates, truth = still(samples)
    bent = np.zeros((samples, 3))
    bent[3000:4000] = np.radians([7, 5, 5])
    out = run(sensors(rates, truth, distortion=bent))
    assert out["innovation_squared"][3000:4100].max() > 100
    assert degrees(out, truth)[2000:].max() < 1.5
    assert degrees(out, truth)[5000:].max() < 0.6


def test_filter_that_has_gone_astray_finds_back():
    """It started without a tracker, in a field that pointed south."""
    samples = 9000
    rates, truth = still(samples)
    inputs = sensors(rates, truth)
    inputs["em_new"][:2000] = 0
    inputs["field"][:2000] *= [-1, -1, 1]
    out = run(inputs)
    assert degrees(out, truth)[1000:2000].min() > 150
    assert degrees(out, truth)[6000:].max() < 0.7


def model_data(samples, seed, parameters, sway=0.4):
    """Distortion, heading and gravity disturbed as the filter's model has it."""
    rng = np.random.default_rng(seed)
    rates = swaying(samples, sway, seed)
    truth = turning(rates)
    size = parameters["tracker.distortion_sigma"]
    angle = np.linalg.norm(rates, axis=1) * T / parameters["tracker.distortion_angle"]
    left = np.exp(-angle - T / parameters["tracker.distortion_time"])
    drive = rng.normal(size=(samples, 3)) * size * np.sqrt(1 - left**2)[:, None]
    bent = np.empty((samples, 3))
    bent[0] = rng.normal(size=3) * size
    for k in range(1, samples):
        bent[k] = left[k] * bent[k - 1] + drive[k]
    bias = rng.normal(size=3) * 0.01
    inputs = sensors(rates, truth, seed, distortion=bent, force_bias=bias, age=0)
    push = white(rng, parameters["inertial.hand_density"], samples)
    inputs["force"] = inputs["force"] + push
    swing = white(rng, parameters["magnetic.heading_density"], samples, 1)[:, 0]
    turn = Rotation.from_rotvec(np.outer(swing, [0, 0, 1]))
    noise = inputs["field"] - truth.inv().apply(NORTH)
    inputs["field"] = truth.inv().apply(turn.apply(NORTH)) + noise
    return inputs, truth


MODELLED = {
    "tracker.distortion_sigma": 0.01,
    "tracker.distortion_angle": 0.35,
    "tracker.distortion_time": 20.0,
    "inertial.hand_density": 0.02,
    "inertial.hand_gain": 0.0,
    "inertial.rate_scale": 0.0,
    "inertial.bias_walk": 0.0,
    "inertial.force_bias_walk": 0.0,
    "magnetic.heading_density": 0.002,
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_normalised_innovations_are_consistent(seed):
    """Mean NIS of gravity, heading and tracker in its 95 % interval."""
    inputs, truth = model_data(80_000, seed, MODELLED)
    out = CompiledRunner(MODEL, MODELLED).run(len(truth), inputs)
    after = slice(5000, None)
    size = out["innovation_size"][after]
    mean = out["innovation_squared"][after].sum() / size.sum()
    low, high = interval(size.sum())
    print(f"mean NIS {mean:.4f} in [{low:.4f}, {high:.4f}]")
    assert low < mean < high


@pytest.mark.slow
@pytest.mark.parametrize("sway", [0.1, 0.4])
def test_errors_are_as_large_as_the_filter_says(sway):
    """Thirty hands, each from the start: their mean square over sigma is one."""
    squares = []
    for seed in range(20, 50):
        inputs, truth = model_data(15_000, seed, MODELLED, sway)
        out = CompiledRunner(MODEL, MODELLED).run(len(truth), inputs)
        late = [7000, 11_000, 14_999]
        squares.append((error(out, truth)[late] / out["attitude_sigma"][late]) ** 2)
    print(f"mean square of error over sigma {np.mean(squares):.2f}")
    assert 0.5 < np.mean(squares) < 1.3
    # Of each axis: noise of the field once tilted the attitude, always to the same side.
    assert np.mean(squares, axis=(0, 1)).max() < 1.6


@pytest.mark.slow
def test_inconsistent_data_leave_the_interval():
    """The check above can fail: a tracker twice as noisy as it says."""
    inputs, truth = model_data(40_000, 4, MODELLED)
    halved = MODELLED | {"tracker.sigma": SIGMA / 4}
    out = CompiledRunner(MODEL, halved).run(len(truth), inputs)
    size = out["innovation_size"][5000:].sum()
    assert out["innovation_squared"][5000:].sum() / size > interval(size)[1]


@pytest.mark.slow
def test_covariance_stays_positive_and_the_quaternion_unit_for_half_an_hour():
    rates = there_and_back(60_000, 0.3)
    truth = turning(rates)
    inputs = sensors(rates, truth)
    parameters = {
        "tracker.mounting_sigma": 0.05,
        "tracker.registration_sigma": 0.05,
        "attitude_limit": 0.1,
    }
    runner = CompiledRunner(MODEL, parameters)
    names = [scalar.name.partition("[")[0] for scalar in MODEL.state.scalars()]
    at = np.flatnonzero(np.array(names) == "P")
    for _ in range(30):
        out = runner.run(len(rates), inputs)
        assert np.abs(np.linalg.norm(out["attitude"], axis=1) - 1).max() < 1e-12
        P = runner.x[at].reshape(18, 18)
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() > 0
        assert out["valid"][1000:].all()
        assert degrees(out, truth)[10_000:].max() < 1.5
