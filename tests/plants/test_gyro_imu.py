"""Kinematics, errors, delay, limits and faults of the inertial unit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from plants.gyro_imu import MODEL, SOFT, Params

T = 1e-3
TRIADS = ("gyro", "accelerometer", "magnetometer")
QUIET = {f"{triad}_{kind}": 0.0 for triad in TRIADS for kind in ("noise", "walk")}
IDEAL = QUIET | {f"{triad}_{kind}": 0.0 for triad in TRIADS for kind in ("bias", "matrix")}
FINE = {"bits": 32}
NORTH = 50e-6 * np.array([np.cos(np.radians(55)), 0, -np.sin(np.radians(55))])
VECTOR = arrays(float, 3, elements=st.floats(-3, 3))


def run(samples, parameters, **inputs):
    return Runner(MODEL, parameters).run(samples, inputs)


@settings(max_examples=40)
@given(VECTOR, VECTOR, VECTOR, st.integers(0, 10**6))
def test_ideal_unit_feels_its_own_place(rate, turning, push, seed):
    """Specific force from the second difference of where the lever's end goes."""
    attitude, lever = Rotation.random(random_state=seed), np.array([0.05, -0.1, 0.2])
    out = run(
        1,
        IDEAL | FINE | {"lever": lever, "accelerometer_range": 1e3, "magnet_moment": 0.0},
        body_acceleration=push,
        attitude=attitude.as_quat(scalar_first=True),
        body_rate=rate,
        angular_acceleration=turning,
    )
    h = 1e-4

    def place(t):
        # Attitude to second order in time: body rate and its derivative.
        turned = attitude * Rotation.from_rotvec(rate * t + turning * t**2 / 2)
        return push * t**2 / 2 + turned.apply(lever)

    acceleration = (place(h) - 2 * place(0) + place(-h)) / h**2
    force = attitude.inv().apply(acceleration + np.array([0, 0, design.SITE_GRAVITY]))
    np.testing.assert_allclose(out["force"][0], force, atol=1e-5)
    np.testing.assert_allclose(out["rate"][0], rate, atol=1e-8)
    np.testing.assert_allclose(out["field"][0], attitude.inv().apply(NORTH), atol=1e-11)


def test_errors_of_scale_misalignment_and_bias():
    rng = np.random.default_rng(4)
    matrix, bias = rng.uniform(-0.1, 0.1, (3, 3)), rng.uniform(-0.3, 0.3, 3)
    rate = np.array([1.0, -2.0, 0.5])
    out = run(1, IDEAL | FINE | {"gyro_matrix": matrix, "gyro_bias": bias}, body_rate=rate)
    np.testing.assert_allclose(out["rate"][0], rate + matrix @ rate + bias, atol=1e-7)


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.0027, 0.03])
def test_delay_is_that_of_a_straight_line_between_samples(delay):
    t = T * np.arange(200)
    rate = np.sin(2 * np.pi * 5 * t)
    parameters = IDEAL | FINE | {"gyro_delay": delay, "lever": 0.0}
    out = run(200, parameters, body_rate=np.outer(rate, [1, 0, 0]))
    expected = np.interp(t - delay, t, rate)
    np.testing.assert_allclose(out["rate"][40:, 0], expected[40:], atol=1e-7)
    np.testing.assert_allclose(out["force"][:, 2], design.SITE_GRAVITY, atol=1e-5)


def test_noise_is_that_of_the_data_sheet():
    out = run(20_000, {"seed": 5} | FINE)
    half = np.sqrt(500.0)
    np.testing.assert_allclose(out["rate"].std(axis=0), np.radians(0.01) * half, rtol=0.03)
    np.testing.assert_allclose(
        out["force"].std(axis=0), 300e-6 * design.STANDARD_GRAVITY * half, rtol=0.03
    )
    np.testing.assert_allclose(out["field"].std(axis=0), 0.6e-6 * np.sqrt(10), rtol=0.03)
    bias = Params.unpack(Params.starts()).gyro_bias
    np.testing.assert_allclose(out["rate"].mean(axis=0), bias, atol=2e-4)


def test_bias_walks_as_far_as_its_density_says():
    """Spread of what has been walked after a second over 60 seeds and three channels."""
    walk = 0.02
    ends = [
        run(1001, IDEAL | FINE | {"gyro_walk": walk, "seed": s})["rate"][[0, -1]] for s in range(60)
    ]
    walked = np.array([end[1] - end[0] for end in ends])
    assert walked.std() == pytest.approx(walk, rel=0.15)


def test_clipping_at_the_range_and_its_flag():
    out = run(1, IDEAL, body_rate=[10.0, -10.0, 1.0])
    np.testing.assert_allclose(out["rate"][0], [np.radians(250), -np.radians(250), 1.0], atol=2e-4)
    assert out["clipped"][0]
    assert not run(1, IDEAL, body_rate=[4.0, 0.0, 0.0])["clipped"][0]
    out = run(1, IDEAL, body_acceleration=[0.0, 0.0, 30.0])
    assert out["force"][0, 2] == pytest.approx(2 * design.STANDARD_GRAVITY, abs=1e-3)
    assert out["clipped"][0]


def test_converter_has_steps():
    rate = np.outer(np.linspace(-1, 1, 500), [1, 1, 1])
    out = run(500, IDEAL | {"bits": 10}, body_rate=rate)["rate"]
    step = 2 * np.radians(250) / 2**10
    np.testing.assert_allclose(out / step, np.round(out / step), atol=1e-9)
    assert np.abs(out - rate).max() <= step / 2 + 1e-9


def test_magnet_brought_near_is_a_dipole():
    """On its axis 2 mu m / r^3, beside it half of that and against it."""
    moment = {"magnet_moment": (0.0, 1.0, 0.0), "lever": 0.0}
    for place, factor in (([0, 0.1, 0], 2.0), ([0.1, 0, 0], -1.0)):
        field = run(1, IDEAL | FINE | moment, magnet=place)["field"][0] - NORTH
        size = 1e-7 * factor / 0.1**3
        np.testing.assert_allclose(field, [0, size, 0], atol=0.03 * abs(size))
    inside = run(1, IDEAL | FINE | moment, magnet=[0.0, 0.0, 0.0])["field"][0]
    assert np.linalg.norm(inside) < 1e-7 / SOFT**3 + 1e-4


def test_slow_unit_has_samples_of_its_own_rate_and_less_noise():
    out = run(8000, {"sample_rate": 125.0, "gyro_noise": 0.01, "gyro_walk": 0.0})
    fresh = out["inertial_valid"] > 0
    assert fresh.sum() == 1000
    np.testing.assert_array_equal(np.flatnonzero(fresh)[:3], [0, 8, 16])
    assert (np.diff(out["rate"][:, 0])[~fresh[1:]] == 0).all()
    spread = out["rate"][fresh].std(axis=0)
    np.testing.assert_allclose(spread, 0.01 * np.sqrt(125 / 2), rtol=0.08)


def test_lost_and_frozen_samples_are_held():
    samples = 60
    lost, frozen = np.zeros(samples), np.zeros(samples)
    lost[20:30], frozen[40:50] = 1, 1
    out = run(samples, {}, lost=lost, frozen=frozen)
    np.testing.assert_array_equal(out["inertial_valid"], 1 - lost)
    for held in (slice(19, 30), slice(39, 50)):
        assert np.ptp(out["rate"][held], axis=0).max() == 0
    assert np.ptp(out["rate"][29:32], axis=0).min() > 0
