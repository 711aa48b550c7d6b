"""The kinematics against itself, against differences, and against the constraint equations."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from fmu_src.kit import Runner, design
from fmu_src.manipulator import parallel_3dof
from fmu_src.manipulator.parallel_3dof import Geometry

NANOMETRE = 1e-9
STROKE = design.STACK_STROKE
strokes_in_range = st.tuples(*[st.floats(0.0, STROKE)] * 3).map(np.array)


def _geometry(**changes: float) -> Geometry:
    return Geometry.unpack(ca.SX(Geometry.starting(**changes).starts()))


def _compiled(kinematics, geometry: Geometry) -> ca.Function:
    argument = ca.SX.sym("argument", 3)
    return ca.Function("kinematics", [argument], [kinematics(geometry, argument)])


FORWARD = _compiled(parallel_3dof.forward, _geometry())
INVERSE = _compiled(parallel_3dof.inverse, _geometry())
UNEQUAL = {"base_radius": 8e-3, "platform_radius": 6e-3, "leg_length": 25e-3}


def _column(value) -> np.ndarray:
    return np.array(value).ravel()


def _workspace(points: int) -> np.ndarray:
    """Strokes on a grid over the whole range, (3, points cubed)."""
    grid = np.linspace(0.0, STROKE, points)
    return np.array(np.meshgrid(grid, grid, grid)).reshape(3, -1)


@pytest.mark.parametrize("changes", [{}, UNEQUAL])
def test_inverse_undoes_forward_over_the_whole_workspace(changes):
    forward = _compiled(parallel_3dof.forward, _geometry(**changes))
    inverse = _compiled(parallel_3dof.inverse, _geometry(**changes))
    strokes = _workspace(9)
    tips = forward(strokes)
    assert np.abs(np.array(inverse(tips)) - strokes).max() < NANOMETRE
    assert np.abs(np.array(forward(inverse(tips))) - np.array(tips)).max() < NANOMETRE


def test_zero_stroke_is_the_origin_and_equal_strokes_push_the_tip_along_z():
    np.testing.assert_allclose(_column(FORWARD([0, 0, 0])), 0.0, atol=1e-15)
    lifted = _column(FORWARD([STROKE] * 3))
    np.testing.assert_allclose(lifted, [0, 0, design.LEVER_GAIN * STROKE], atol=1e-15)


def test_longer_leg_1_tips_the_shaft_away_from_it():
    assert _column(FORWARD([STROKE, 0, 0]))[0] < -100e-6


def test_reach_is_that_of_the_thesis():
    """A04 Table 6.1: some 1000 um sideways, more than 100 um along the shaft."""
    tips = np.array(FORWARD(_workspace(2)))
    wide, deep, high = np.ptp(tips, axis=1)
    assert wide > 1000e-6
    assert deep > 950e-6
    assert high > 100e-6


def _constraints(unknowns: np.ndarray, strokes: np.ndarray) -> np.ndarray:
    """Three pin planes and three leg lengths, of a platform with six free coordinates.

    In radii and radians.
    """
    radius, leg = design.PLATFORM_RADIUS, Geometry.fields["leg_length"].start[0]
    centre = unknowns[:3] * radius
    rotation = Rotation.from_rotvec(unknowns[3:]).as_matrix()
    residuals = []
    for angle, stroke in zip(np.radians([0, 120, 240]), strokes, strict=True):
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.array([-np.sin(angle), np.cos(angle), 0.0])
        ball = centre + rotation @ (radius * outward)
        length = leg + design.LEVER_GAIN * stroke
        residuals += [ball @ across, np.linalg.norm(ball - radius * outward) - length]
    return np.array(residuals) / radius


@settings(deadline=None, max_examples=50)
@given(strokes_in_range)
def test_forward_solves_the_constraint_equations(strokes):
    leg = Geometry.fields["leg_length"].start[0]
    guess = np.array([0, 0, leg / design.PLATFORM_RADIUS, 0, 0, 0])
    solution = root(_constraints, guess, args=(strokes,), tol=1e-14).x
    assert np.abs(_constraints(solution, strokes)).max() < 1e-10
    axis = Rotation.from_rotvec(solution[3:]).as_matrix()[:, 2]
    tip = solution[:3] * design.PLATFORM_RADIUS + design.SHAFT_LENGTH * axis
    tip[2] -= leg + design.SHAFT_LENGTH
    np.testing.assert_allclose(_column(FORWARD(strokes)), tip, atol=NANOMETRE)


@settings(deadline=None, max_examples=50)
@given(strokes_in_range)
def test_jacobians_agree_with_differences_and_with_each_other(strokes):
    tip = _column(FORWARD(strokes))
    strokes_from_tip = np.array(INVERSE.jacobian()(tip, 0))
    tip_from_strokes = np.array(FORWARD.jacobian()(strokes, 0))
    np.testing.assert_allclose(strokes_from_tip @ tip_from_strokes, np.eye(3), atol=1e-9)
    h = 1e-7
    differences = np.column_stack(
        [_column(INVERSE(tip + h * e) - INVERSE(tip - h * e)) / (2 * h) for e in np.eye(3)]
    )
    np.testing.assert_allclose(strokes_from_tip, differences, rtol=1e-5, atol=1e-7)


def test_tremor_sphere_lies_within_the_workspace():
    """A04 Fig. 6.7: a sphere of 50 um about the middle."""
    rest = _column(FORWARD([STROKE / 2] * 3))
    directions = np.random.default_rng(6).standard_normal((200, 3))
    sphere = 25e-6 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    run = Runner(parallel_3dof.MODEL).run(200, {"displacement": rest + sphere})
    assert np.all(run["reachable"] == 1)


def test_model_limits_and_flags_what_cannot_be_reached():
    far = {"displacement": np.array([0.0, 0.0, 200e-6])}
    run = Runner(parallel_3dof.MODEL).run(1, far)
    np.testing.assert_array_equal(run["strokes"][0], STROKE)
    assert run["reachable"][0] == 0


@settings(deadline=None, max_examples=200)
@given(st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_any_demand_gives_strokes_within_their_range(displacement):
    strokes = Runner(parallel_3dof.MODEL).run(1, {"displacement": np.array(displacement)})
    assert np.all((strokes["strokes"] >= 0) & (strokes["strokes"] <= STROKE))
