"""Optical-inertial filters: consistency, any attitude, every fault by its name.

The world is that of `handheld`: samples with white noise of the densities that the filter is told.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from fmu_src.estimation import optical_inertial_ekf, optical_inertial_ukf
from fmu_src.estimation.optical_inertial.state import SPACE, Nominal
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

MODELS = {
    "extended": replace(optical_inertial_ekf.MODEL, sample_period=T),
    "unscented": replace(optical_inertial_ukf.MODEL, sample_period=T),
}
KNOWN = {
    "mounting.lever": LEVER,
    "mounting.lever_sigma": 0.0,
    "mounting.rotation_sigma": 0.0,
    "mounting.lag_sigma": 0.0,
    "inertial.rate_matrix_sigma": 0.0,
    "inertial.force_matrix_sigma": 0.0,
    "inertial.between": 0.0,
    "gravity_sigma": 0.0,
    **LIMITS,
    "tracker.position_offset_sigma": 0.0,
    "tracker.attitude_offset_sigma": 0.0,
    "tracker.gate": 1e6,
}
"""A calibrated instrument and a tracker with white noise alone."""


def estimate(true: World, kind: str = "extended", **changed) -> dict[str, np.ndarray]:
    """A run of a filter over a world."""
    runner = CompiledRunner(MODELS[kind], {**KNOWN, **NOISE, **changed})
    return runner.run(len(true.position), true.inputs)


@pytest.mark.parametrize("kind", MODELS)
def test_mean_nis_and_nees_lie_in_their_intervals(kind) -> None:
    """Noise as the filter is told: 95 % intervals of chi-squared means, over 60 s."""
    true = world(60.0)
    out = estimate(true, kind, **{"inertial.rate_bias_walk": 0.0, "inertial.force_bias_walk": 0.0})
    counted = out["innovation_size"] > 0
    counted[: round(5 / T)] = False
    squared = out["innovation_squared"][counted]
    freedom = 6 * len(squared)
    low, high = stats.chi2.interval(0.95, freedom)
    assert low < squared.sum() < high
    assert np.all(out["innovation_size"][counted] == 6)
    # Errors of neighbouring samples are alike; poses a second apart are not.
    apart = slice(round(10 / T), None, round(1 / T))
    turned = Rotation.from_quat(out["attitude"], scalar_first=True).inv() * true.rotation
    normal = turned.as_rotvec()[apart] / out["attitude_sigma"][apart]
    place = (out["position"] - true.body)[apart] / out["position_sigma"][apart]
    for errors_ in (normal, place):
        low, high = stats.chi2.interval(0.999, errors_.size)
        assert low < np.sum(errors_**2) < high


@pytest.mark.parametrize("kind", MODELS)
def test_a_sensing_chain_that_is_not_known_is_learnt(kind) -> None:
    """Lever arm, lag, bias and misalignment, from a minute of motion."""
    true = world(60.0, lag=4e-3)
    bias, skew = np.array([0.01, -0.008, 0.005]), np.array([[0, 4e-3, 0], [0, 0, 6e-3], [0, 0, 0]])
    inputs = dict(true.inputs)
    inputs["rate"] = inputs["rate"] @ (np.eye(3) + skew).T + bias
    unknown = {
        "mounting.lever": 0.0,
        "mounting.lever_sigma": 0.05,
        "mounting.lag_sigma": 3e-3,
        "mounting.rotation_sigma": 0.02,
        "inertial.rate_matrix_sigma": 0.01,
        "inertial.force_matrix_sigma": 0.003,
        "gravity_sigma": 0.05,
    }
    out = estimate(replace(true, inputs=inputs), kind, **unknown)
    np.testing.assert_allclose(out["lever"][-1], LEVER, atol=1e-3)
    np.testing.assert_allclose(out["rate_bias"][-1], bias, atol=3e-4)
    assert out["rate_lag"][-1] == pytest.approx(4e-3, abs=3e-4)
    assert out["force_lag"][-1] == pytest.approx(4e-3, abs=3e-4)
    position, attitude = errors(true, out)
    late = slice(round(30 / T), None)
    assert rms(position[late]) < 2e-4
    assert rms(attitude[late]) < np.radians(0.1)


@given(
    axis=st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(
        lambda v: np.linalg.norm(v) > 0.1
    ),
    angle=st.sampled_from([0.3, np.pi / 2, 3.0, np.pi]),
)
@settings(max_examples=8)
def test_start_from_any_attitude(axis, angle) -> None:
    """Upside down and half turns among them: good from the first pose on."""
    start = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    true = world(1.0, start=start)
    out = estimate(true)
    position, attitude = errors(true, out)
    assert attitude.max() < np.radians(0.5)
    assert position[round(0.5 / T) :].max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(out["attitude"], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("start", ["upside down", "half a turn"])
def test_both_filters_start_where_quaternions_change_sign(start) -> None:
    axis = {"upside down": [1, 0, 0], "half a turn": [0, 0, 1]}[start]
    true = world(1.0, start=Rotation.from_rotvec(np.pi * np.array(axis)))
    for kind in MODELS:
        assert errors(true, estimate(true, kind))[1].max() < np.radians(0.5)


@pytest.mark.parametrize("late", [3, 12])
def test_a_late_pose_is_as_good_as_a_prompt_one(late) -> None:
    """Told by its age; what is left is the noise of 15 or 60 ms. Not told, it is far behind."""
    prompt, tardy = world(20.0), world(20.0, late=late)
    settled = slice(round(5 / T), None)
    best = [rms(values[settled]) for values in errors(prompt, estimate(prompt))]
    found = [rms(values[settled]) for values in errors(tardy, estimate(tardy))]
    worse = 1.2 if late == 3 else 2.0
    assert found[0] < worse * best[0]
    assert found[1] < worse * best[1]
    untold = replace(
        tardy, inputs={**tardy.inputs, "optical_age": 0.0 * tardy.inputs["rate"][:, 0]}
    )
    assert rms(errors(untold, estimate(untold))[0][settled]) > 5 * best[0]


def test_occlusion_from_the_first_sample_on_is_told_until_a_pose_comes() -> None:
    true = world(4.0)
    new = true.inputs["optical_new"].copy()
    first = round(2 / T)
    new[:first] = 0.0
    out = estimate(replace(true, inputs={**true.inputs, "optical_new": new}))
    shown = int(np.flatnonzero(new)[0])
    assert not out["valid"][:shown].any()
    assert out["optical_lost"][:shown].all()
    assert out["valid"][shown + round(0.3 / T) :].all()
    assert errors(true, out)[0][shown + round(0.5 / T) :].max() < 1e-3


def test_an_occlusion_is_bridged_then_told() -> None:
    """Ten seconds without a pose: small errors at first, then not valid, then back at once."""
    true = world(20.0)
    new = true.inputs["optical_new"].copy()
    gone = slice(round(8 / T), round(18 / T))
    new[gone] = 0.0
    out = estimate(replace(true, inputs={**true.inputs, "optical_new": new}))
    position, _ = errors(true, out)
    assert position[round(8.4 / T)] < 2e-3
    assert out["optical_lost"][round(8.3 / T) : gone.stop].all()
    assert not out["valid"][gone.stop - 1]
    beyond = position > 0.08
    assert not np.any(out["valid"].astype(bool) & beyond)
    assert position[round(18.5 / T) :].max() < 1e-3
    assert out["valid"][round(18.5 / T) :].all()


def test_single_markers_hold_a_pose_in_partial_occlusion() -> None:
    """One visible marker of four for eight seconds: without it metres, with it a millimetre."""
    true = world(20.0)
    layout = np.array([[0.04, 0, 0], [-0.03, 0.04, 0], [-0.03, -0.04, 0], [0, 0.01, -0.06]])
    new = true.inputs["optical_new"].copy()
    gone = slice(round(8 / T), round(16 / T))
    markers = np.zeros(len(new))
    markers[gone] = new[gone]
    new[gone] = 0.0
    blind = {**true.inputs, "optical_new": new}
    rng = np.random.default_rng(3)
    seen = true.body + true.rotation.apply(layout[1]) + 2e-4 * rng.normal(size=true.body.shape)
    partly = {
        **blind,
        "optical_markers_new": markers,
        "optical_marker2": seen,
        "optical_visible2": np.ones(len(new)),
    }
    errors_blind, _ = errors(true, estimate(replace(true, inputs=blind)))
    out = estimate(replace(true, inputs=partly), **{"tracker.markers": layout})
    position, attitude = errors(true, out)
    assert errors_blind[gone].max() > 0.05
    assert position[gone].max() < 2e-3
    assert attitude[gone].max() < np.radians(0.5)
    assert out["valid"][gone].all()
    assert not out["optical_lost"][gone].any()
    assert set(out["innovation_size"][gone]) == {0.0, 3.0}


FAULTS = {
    "lost samples": (lost_samples, None, 1e-3),
    "inertial lost for half a second": (lost_for_half_a_second, "inertial_lost", 0.08),
    "frozen inertial unit": (frozen_unit, "inertial_lost", 0.08),
    "clipping": (clipped_force, "inertial_lost", 0.4),
    "frozen tracker": (frozen_tracker, "optical_lost", 5e-3),
    "no attitude": (no_attitude, "optical_lost", 5e-3),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_told_bounded_and_over_when_it_is_over(case) -> None:
    change, flag, bound = FAULTS[case]
    true = world(14.0)
    out = estimate(replace(true, inputs=change(true.inputs)))
    check_fault(true, out, flag, bound, turn=20)


def test_one_wild_pose_hardly_moves_the_estimate_and_a_new_truth_is_believed() -> None:
    """A pose 20 cm off, once: damped. The same for good, as after a new registration: followed."""
    true = world(14.0)
    once = true.inputs["optical_position"].copy()
    at = int(np.flatnonzero(true.inputs["optical_new"])[200])
    once[at] += 0.2
    gated = {"tracker.gate": 9.0}
    out = estimate(replace(true, inputs={**true.inputs, "optical_position": once}), **gated)
    assert errors(true, out)[0][round(4 / T) :].max() < 2e-3
    moved = true.inputs["optical_position"].copy()
    moved[at:] += 0.2
    out = estimate(replace(true, inputs={**true.inputs, "optical_position": moved}), **gated)
    new = np.linalg.norm(out["position"] - true.body - 0.2, axis=1)
    assert new[at + round(2 / T) :].max() < 2e-3


def test_a_slow_unit_is_followed_between_its_samples() -> None:
    """Every fourth sample fresh: 50 Hz of inertial samples at 200 Hz of outputs."""
    true = world(14.0)
    valid = np.zeros(len(true.position))
    valid[::4] = 1.0
    out = estimate(replace(true, inputs={**true.inputs, "inertial_valid": valid}))
    assert not out["inertial_lost"][round(1 / T) :].any()
    assert errors(true, out)[0][round(4 / T) :].max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("kind", MODELS)
def test_covariance_and_quaternion_over_half_an_hour_at_1_khz(kind) -> None:
    """The same minute again and again: symmetric, positive, of unit length, no drift of errors."""
    model = replace(MODELS[kind], sample_period=1e-3)
    runner = CompiledRunner(model, {**KNOWN, **NOISE, "mounting.lever_sigma": 0.05})
    n = 60_000
    k = np.arange(n) * 1e-3
    position = 0.01 * np.sin(2 * np.pi * np.outer(k, [0.5, 1.0, 1.5]))
    acceleration = -position * (2 * np.pi * np.array([0.5, 1.0, 1.5])) ** 2
    rng = np.random.default_rng(5)
    inputs = {
        "rate": 5e-4 / np.sqrt(2e-3) * rng.normal(size=(n, 3)),
        "force": acceleration + [0, 0, GRAVITY] + 0.1 * rng.normal(size=(n, 3)),
        "optical_position": position + LEVER + 1e-4 * rng.normal(size=(n, 3)),
        "optical_attitude": np.roll(
            Rotation.from_rotvec(1e-3 * rng.normal(size=(n, 3))).as_quat(), 1, axis=1
        ),
        "optical_new": (np.arange(n) % 20 == 0).astype(float),
    }
    size, at = SPACE.error_size, Nominal.size()
    for minute in range(30 if kind == "extended" else 3):
        out = runner.run(n, inputs)
        P = runner.x[at : at + size**2].reshape(size, size)
        np.testing.assert_allclose(P, P.T, atol=1e-18)
        known = np.diag(P) > 0
        assert np.linalg.eigvalsh(P[np.ix_(known, known)]).min() > 0
        np.testing.assert_allclose(np.linalg.norm(out["attitude"], axis=1), 1.0, atol=1e-12)
        if minute:
            error = np.linalg.norm(out["position"][1000:] - position[1000:] - LEVER, axis=1)
            assert rms(error) < 2e-4
