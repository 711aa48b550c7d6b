"""The rigid body and the 3-RPS manipulator against SciPy."""

import itertools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from plants import instrument
from plants.instrument import MODEL, Params

LEG = 20e-3
"""Leg length at zero stroke that the model declares [m]."""


def vectors(size, count=3):
    return arrays(float, count, elements=st.floats(-size, size))


def run(**inputs):
    return {name: value[0] for name, value in Runner(MODEL).run(1, inputs).items()}


def scipy_tip(stroke):
    """Tip by the platform's pose: balls in the legs' planes, at the legs' lengths."""
    radius, shaft = design.PLATFORM_RADIUS, design.SHAFT_LENGTH
    angles = np.radians([0, 120, 240])
    radial = np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    tangent = np.stack([-np.sin(angles), np.cos(angles), np.zeros(3)], axis=1)
    legs = LEG + design.LEVER_GAIN * np.asarray(stroke)

    def residual(pose):
        balls = LEG * pose[:3] + Rotation.from_rotvec(pose[3:]).apply(radius * radial)
        lengths = np.linalg.norm(balls - radius * radial, axis=1)
        return np.concatenate([(balls * tangent).sum(axis=1), lengths - legs]) / LEG

    pose = root(residual, [0, 0, 1, 0, 0, 0], tol=1e-14).x
    assert np.abs(residual(pose)).max() < 1e-13
    return LEG * pose[:3] + Rotation.from_rotvec(pose[3:]).apply([0, 0, shaft])


@settings(max_examples=60)
@given(arrays(float, 3, elements=st.floats(0, 15e-6)))
def test_deflection_is_that_of_the_platform_pose_found_by_scipy(stroke):
    expected = scipy_tip(stroke) - scipy_tip(np.zeros(3))
    np.testing.assert_allclose(run(stroke=stroke)["deflection"], expected, atol=1e-11)


def test_newton_has_converged_over_the_workspace_and_beyond(monkeypatch):
    p = Params.unpack(Params.starts())
    strokes = [np.array(s) for s in itertools.product([-3e-6, 0, 7e-6, 15e-6, 25e-6], repeat=3)]

    def tips():
        s = ca.SX.sym("s", 3)
        tip = ca.Function("tip", [s], [instrument.shaft_tip(p, s)])
        return np.array([tip(stroke).full().ravel() for stroke in strokes])

    few = tips()
    monkeypatch.setattr(instrument, "NEWTON_STEPS", 10)
    assert np.abs(few - tips()).max() < 1e-13


def test_range_of_the_tip_is_that_of_the_design():
    corners = np.array(list(itertools.product([0, design.STACK_STROKE], repeat=3)))
    deflection = Runner(MODEL).run(len(corners), {"stroke": corners})["deflection"]
    lateral = 160e-6 * design.SHAFT_LENGTH / design.PLATFORM_RADIUS
    assert np.ptp(deflection[:, 0]) == pytest.approx(lateral, rel=1e-3)
    assert np.ptp(deflection[:, 2]) == pytest.approx(
        design.LEVER_GAIN * design.STACK_STROKE, rel=1e-6
    )
    # A04 Table 6.1 says more than 1000 um; notation.md's 160 l/r is across x, y has its cosine.
    assert np.ptp(deflection[:, 1]) == pytest.approx(lateral * np.cos(np.pi / 6), rel=1e-3)


def test_one_leg_up_moves_the_tip_away_from_it():
    assert run(stroke=[10e-6, 0, 0])["deflection"][0] < -300e-6


def test_zero_stroke_leaves_the_tip_where_it_is():
    out = run(body=[0.01, -0.02, 0.03], attitude=[0.5, 0.5, -0.5, 0.5])
    np.testing.assert_array_equal(out["deflection"], 0)
    np.testing.assert_array_equal(out["tip"], out["free_tip"])


@settings(max_examples=40)
@given(vectors(1.0), vectors(3.0), vectors(30.0), vectors(20.0), vectors(500.0))
def test_specific_force_is_the_second_derivative_of_each_site_less_gravity(
    start, turn, rate, acceleration, angular
):
    """Five-point differences of the sites' paths; the body rate's derivative at 0 is `angular`."""
    first = Rotation.from_rotvec(turn)
    sites = np.array([[design.D1, 0, 0], [0, design.D1, 0], [design.D2, design.D2, design.D3]])

    def path(t):
        body = first * Rotation.from_rotvec(rate * t + angular * t * t / 2)
        return start + acceleration * t * t / 2 + body.apply(sites)

    h = 1e-4
    second = (-path(2 * h) + 16 * path(h) - 30 * path(0.0) + 16 * path(-h) - path(-2 * h)) / (
        12 * h * h
    )
    gravity = np.array([0, 0, -design.SITE_GRAVITY])
    expected = first.inv().apply(second - gravity)
    out = run(
        attitude=first.as_quat(scalar_first=True),
        body_acceleration=acceleration,
        rate=rate,
        angular_acceleration=angular,
    )
    felt = np.array([out["force1"], out["force2"], out["force3"]])
    np.testing.assert_allclose(felt, expected, atol=1e-4)


@settings(max_examples=40)
@given(vectors(3.0), vectors(0.1), arrays(float, 3, elements=st.floats(0, 15e-6)))
def test_field_and_tip_turn_with_the_body(turn, body, stroke):
    R = Rotation.from_rotvec(turn)
    out = run(attitude=R.as_quat(scalar_first=True), body=body, stroke=stroke)
    down = np.sin(design.MAGNETIC_INCLINATION)
    north = np.cos(design.MAGNETIC_INCLINATION)
    world = design.MAGNETIC_FIELD * np.array([north, 0, -down])
    np.testing.assert_allclose(R.apply(out["field"]), world, atol=1e-18)
    np.testing.assert_allclose(out["free_tip"], body + R.apply(design.TIP), atol=1e-15)
    np.testing.assert_allclose(out["tip"] - out["free_tip"], R.apply(out["deflection"]), atol=1e-15)


def test_attitude_of_another_length_is_scaled_and_none_at_all_stays_finite():
    q = np.array([0.8, 0.1, -0.5, 0.3])
    unit, short = run(attitude=q / np.linalg.norm(q)), run(attitude=0.9 * q)
    for name, value in unit.items():
        np.testing.assert_allclose(short[name], value, rtol=1e-12, atol=1e-18)
    assert all(np.isfinite(value).all() for value in run(attitude=np.zeros(4)).values())
