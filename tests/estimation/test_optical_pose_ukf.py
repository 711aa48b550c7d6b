"""E13's own filter: consistency on motions that follow its model, any attitude, every fault."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from scipy.spatial.transform import Rotation

from fmu_src.estimation.optical_pose_ukf import MODEL, SPACE, Nominal, integrated
from fmu_src.pack.compiled_runner import CompiledRunner
from tests.estimation.handheld import (
    GRAVITY,
    LEVER,
    LIMITS,
    NOISE,
    T,
    World,
    check_fault,
    clipped_force,
    errors,
    frozen_tracker,
    frozen_unit,
    lost_for_half_a_second,
    lost_samples,
    no_attitude,
    rms,
    world,
)

SAMPLED = replace(MODEL, sample_period=T)
PARAMETERS = {
    "lever": LEVER,
    "jerk": 10.0,
    "angular_acceleration": 10.0,
    "rate_noise": NOISE["inertial.rate_noise"] / np.sqrt(2 * T),
    "force_noise": NOISE["inertial.force_noise"] / np.sqrt(2 * T),
    "position_noise": NOISE["tracker.position_noise"],
    "attitude_noise": NOISE["tracker.attitude_noise"],
    **LIMITS,
}
"""For the hand of `handheld`."""


def estimate(true: World, **changed) -> dict[str, np.ndarray]:
    """A run of the filter over a world."""
    return CompiledRunner(SAMPLED, {**PARAMETERS, **changed}).run(len(true.position), true.inputs)


def without_poses(true: World, gone: slice) -> World:
    """The same world with the line of sight lost for some samples."""
    new = true.inputs["optical_new"].copy()
    new[gone] = 0.0
    return replace(true, inputs={**true.inputs, "optical_new": new})


def following(seconds: float, jerk: float, angular: float, seed: int) -> World:
    """A motion of white jerk and white angular acceleration, which is the model of the filter.

    Args:
        seconds: how long.
        jerk: one-sided density [m/s3/Hz0.5].
        angular: that of the angular acceleration [rad/s2/Hz0.5].
        seed: of all draws.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / T)
    # By exact covariances of the integrals, written out: a, v, p and w, q.
    thrice = np.array([[T, T**2 / 2, T**3 / 6], [0, T**3 / 3, T**4 / 8], [0, 0, T**5 / 20]])
    thrice = thrice + np.triu(thrice, 1).T
    pushed = jerk / np.sqrt(2) * rng.normal(size=(n, 3, 3)) @ np.linalg.cholesky(thrice).T
    twice = np.array([[T, T**2 / 2], [T**2 / 2, T**3 / 3]])
    twisted = angular / np.sqrt(2) * rng.normal(size=(n, 3, 2)) @ np.linalg.cholesky(twice).T
    p, v, a, w = np.zeros((4, n, 3))
    rotation = [Rotation.random(random_state=seed)]
    for k in range(1, n):
        p[k] = p[k - 1] + T * v[k - 1] + T**2 / 2 * a[k - 1] + pushed[k, :, 2]
        v[k] = v[k - 1] + T * a[k - 1] + pushed[k, :, 1]
        a[k] = a[k - 1] + pushed[k, :, 0]
        w[k] = w[k - 1] + twisted[k, :, 0]
        turn = Rotation.from_rotvec(w[k - 1] * T) * Rotation.from_rotvec(twisted[k, :, 1])
        rotation.append(rotation[-1] * turn)
    true = Rotation.concatenate(rotation)
    turned = true * Rotation.from_rotvec(PARAMETERS["attitude_noise"] * rng.normal(size=(n, 3)))
    noise = rng.normal(size=(3, n, 3))
    force = true.inv().apply(a + np.array([0, 0, GRAVITY]))
    inputs = {
        "rate": w + PARAMETERS["rate_noise"] * noise[0],
        "force": force + PARAMETERS["force_noise"] * noise[1],
        "optical_position": p + true.apply(LEVER) + PARAMETERS["position_noise"] * noise[2],
        "optical_attitude": turned.as_quat(scalar_first=True),
        "optical_new": (np.arange(n) % 10 == 0).astype(float),
    }
    return World(true, p, inputs)


def test_process_noise_is_that_of_integrated_white_noise() -> None:
    """E13 3.18 against the integral of the impulse response's products."""
    for order in (1, 2):
        found = integrated(order, 0.3)

        def response(t, k):
            return t**k / [1, 1, 2][k]

        for i in range(order + 1):
            for j in range(order + 1):
                wanted, _ = integrate.quad(
                    lambda t, i, j: response(t, i) * response(t, j), 0, 0.3, (order - i, order - j)
                )
                assert found[i, j] == pytest.approx(wanted, rel=1e-9)


def test_mean_nis_and_nees_lie_in_their_intervals() -> None:
    """A motion as the filter has it: 95 % of chi-squared of all corrections, 99.9 % of poses."""
    true = following(40.0, jerk=0.5, angular=0.5, seed=1)
    out = estimate(true, jerk=0.5, angular_acceleration=0.5, gate=1e6)
    counted = out["innovation_size"] > 0
    counted[: round(1 / T)] = False
    assert set(out["innovation_size"][counted]) == {6.0, 12.0}
    low, high = stats.chi2.interval(0.95, out["innovation_size"][counted].sum())
    assert low < out["innovation_squared"][counted].sum() < high
    apart = slice(round(1 / T), None, round(0.5 / T))
    turned = Rotation.from_quat(out["attitude"], scalar_first=True).inv() * true.rotation
    for normal in (
        turned.as_rotvec()[apart] / out["attitude_sigma"][apart],
        (out["position"] - true.body)[apart] / out["position_sigma"][apart],
    ):
        low, high = stats.chi2.interval(0.999, normal.size)
        assert low < np.sum(normal**2) < high


@given(
    axis=st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(
        lambda v: np.linalg.norm(v) > 0.1
    ),
    angle=st.sampled_from([0.3, np.pi / 2, 3.0, np.pi]),
)
@settings(max_examples=6)
def test_start_from_any_attitude(axis, angle) -> None:
    """Upside down and half turns among them: good from the first pose on."""
    start = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    true = world(1.0, start=start)
    out = estimate(true)
    position, attitude = errors(true, out)
    assert attitude.max() < np.radians(0.7)
    assert position[round(0.5 / T) :].max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(out["attitude"], axis=1), 1.0, atol=1e-12)


def test_a_late_pose_is_moved_by_its_age_only_straight_on() -> None:
    """Better than untold, worse than prompt: at constant velocity 15 ms cost tenths of mm."""
    settled = slice(round(5 / T), None)
    prompt, late = world(14.0), world(14.0, late=3)
    untold = replace(late, inputs={**late.inputs, "optical_age": np.zeros(len(late.position))})
    best, told, bad = (
        rms(errors(true, estimate(true))[0][settled]) for true in (prompt, late, untold)
    )
    assert best < told < 5 * best
    assert bad > 2 * told


def test_occlusion_from_the_first_sample_on_is_told_until_a_pose_comes() -> None:
    first = round(2 / T)
    true = without_poses(world(4.0), slice(first))
    out = estimate(true)
    shown = int(np.flatnonzero(true.inputs["optical_new"])[0])
    assert not out["valid"][:shown].any()
    assert out["optical_lost"][:shown].all()
    assert out["valid"][shown + round(0.3 / T) :].all()
    assert errors(true, out)[0][shown + round(0.5 / T) :].max() < 1e-3


def test_an_occlusion_is_bridged_then_told() -> None:
    """By the inertial unit alone: millimetres after a second, then not valid, then back at once."""
    gone = slice(round(8 / T), round(16 / T))
    true = without_poses(world(18.0), gone)
    out = estimate(true)
    position, _ = errors(true, out)
    assert position[round(8.5 / T)] < 5e-3
    assert out["optical_lost"][round(8.3 / T) : gone.stop].all()
    assert not out["optical_lost"][round(1 / T) : gone.start].any()
    assert not out["valid"][gone.stop - 1]
    assert not np.any(out["valid"].astype(bool) & (position > 0.1))
    assert position[round(16.5 / T) :].max() < 1e-3
    assert out["valid"][round(16.5 / T) :].all()


def duplicated_poses(inputs):
    """Each pose told twice, 5 ms apart; the second one is old."""
    new = inputs["optical_new"].copy()
    again = np.flatnonzero(new[:-1]) + 1
    position, attitude = inputs["optical_position"].copy(), inputs["optical_attitude"].copy()
    position[again], attitude[again] = position[again - 1], attitude[again - 1]
    new[again] = 1.0
    return {**inputs, "optical_position": position, "optical_attitude": attitude} | {
        "optical_new": new
    }


FAULTS = {
    "lost samples": (lost_samples, None, 2e-3),
    "inertial lost for half a second": (lost_for_half_a_second, "inertial_lost", 0.02),
    "frozen inertial unit": (frozen_unit, "inertial_lost", 0.02),
    "clipping": (clipped_force, "inertial_lost", 0.02),
    "frozen tracker": (frozen_tracker, "optical_lost", 0.02),
    "no attitude": (no_attitude, "optical_lost", 0.02),
    "duplicated poses": (duplicated_poses, None, 1e-3),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_told_bounded_and_over_when_it_is_over(case) -> None:
    change, flag, bound = FAULTS[case]
    true = world(12.0)
    out = estimate(replace(true, inputs=change(true.inputs)))
    check_fault(true, out, flag, bound, turn=10)


def test_a_duplicated_pose_is_taken_once() -> None:
    """Expected Result: the same estimate as without its repetition."""
    true = world(2.0)
    once = estimate(true)
    twice = estimate(replace(true, inputs=duplicated_poses(true.inputs)))
    np.testing.assert_array_equal(once["position"], twice["position"])


def test_one_wild_pose_hardly_moves_the_estimate_and_a_new_truth_is_believed() -> None:
    """A pose 20 cm off, once: damped. The same for good, as after a new registration: followed."""
    true = world(12.0)
    at = int(np.flatnonzero(true.inputs["optical_new"])[200])
    once = true.inputs["optical_position"].copy()
    once[at] += 0.2
    out = estimate(replace(true, inputs={**true.inputs, "optical_position": once}))
    assert errors(true, out)[0][round(4 / T) :].max() < 3e-3
    moved = true.inputs["optical_position"].copy()
    moved[at:] += 0.2
    out = estimate(replace(true, inputs={**true.inputs, "optical_position": moved}))
    new = np.linalg.norm(out["position"] - true.body - 0.2, axis=1)
    assert new[at + round(2 / T) :].max() < 2e-3


@pytest.mark.slow
def test_covariance_and_quaternion_over_half_an_hour_at_1_khz() -> None:
    """The same minute again and again: symmetric, positive, of unit length, no drift of errors.

    The unit has 250 Hz, the tracker 50 Hz.
    """
    runner = CompiledRunner(MODEL, {**PARAMETERS, "force_noise": 0.1, "rate_noise": 0.01})
    n = 60_000
    k = np.arange(n) * 1e-3
    position = 0.01 * np.sin(2 * np.pi * np.outer(k, [0.5, 1.0, 1.5]))
    acceleration = -position * (2 * np.pi * np.array([0.5, 1.0, 1.5])) ** 2
    rng = np.random.default_rng(5)
    noise = rng.normal(size=(4, n, 3))
    turned = Rotation.from_rotvec(PARAMETERS["attitude_noise"] * noise[3])
    inputs = {
        "rate": 0.01 * noise[0],
        "force": acceleration + [0, 0, GRAVITY] + 0.1 * noise[1],
        "inertial_valid": (np.arange(n) % 4 == 0).astype(float),
        "optical_position": position + LEVER + PARAMETERS["position_noise"] * noise[2],
        "optical_attitude": turned.as_quat(scalar_first=True),
        "optical_new": (np.arange(n) % 20 == 0).astype(float),
    }
    size, at = SPACE.error_size, Nominal.size()
    for minute in range(30):
        out = runner.run(n, inputs)
        P = runner.x[at : at + size**2].reshape(size, size)
        np.testing.assert_allclose(P, P.T, atol=1e-18)
        assert np.linalg.eigvalsh(P).min() > 0
        np.testing.assert_allclose(np.linalg.norm(out["attitude"], axis=1), 1.0, atol=1e-12)
        if minute:
            error = np.linalg.norm(out["position"][1000:] - position[1000:] - LEVER, axis=1)
            assert rms(error) < 3e-4
