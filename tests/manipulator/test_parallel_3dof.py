"""The kinematics against itself, differences and the constraint equations; limits against SciPy."""

import itertools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares, root
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from fmu_src.manipulator import parallel_3dof
from fmu_src.manipulator.parallel_3dof import Geometry
from plants import instrument

NANOMETRE, MICROMETRE = 1e-9, 1e-6
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
LEANING = {"base_radius": 20e-3, "platform_radius": 2e-3, "shaft_length": 0.1}
WIDE = {"base_radius": 20e-3, "platform_radius": 20e-3, "shaft_length": 20e-3}
"""The shortest shaft for its radius that can be asked for."""
SLENDER = {"base_radius": 1e-3, "platform_radius": 1e-3, "shaft_length": 0.2}
"""The longest."""
SHAPES = ({}, UNEQUAL, LEANING, WIDE, SLENDER)


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


@settings(max_examples=50)
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


@settings(max_examples=50)
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


@settings(max_examples=200)
@given(st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_any_demand_gives_strokes_within_their_range(displacement):
    strokes = Runner(parallel_3dof.MODEL).run(1, {"displacement": np.array(displacement)})
    assert np.all((strokes["strokes"] >= 0) & (strokes["strokes"] <= STROKE))


def _slope_at_rest(**changes: float) -> np.ndarray:
    """Displacement of the tip by stroke at zero stroke, (3, 3)."""
    return np.array(_compiled(parallel_3dof.forward, _geometry(**changes)).jacobian()([0, 0, 0], 0))


@pytest.mark.parametrize("changes", SHAPES)
def test_metric_of_the_strokes_is_that_of_the_tip_at_rest(changes):
    """The form whose minimum the limits take, with the constants of the module's equation."""
    slope = _slope_at_rest(**changes)
    p = {**dict(zip(Geometry.fields, Geometry.starts(), strict=True)), **changes}
    rest = np.sqrt(p["leg_length"] ** 2 - (p["base_radius"] - p["platform_radius"]) ** 2)
    q = (p["shaft_length"] / p["platform_radius"]) ** 2
    metric = 2 / 3 * q * np.eye(3) + (1 - 2 * q) / 9 * np.ones((3, 3))
    metric *= (p["lever_gain"] * p["leg_length"] / rest) ** 2
    np.testing.assert_allclose(slope.T @ slope, metric, rtol=1e-12, atol=1e-12 * metric.max())


def _nearest_strokes(slope: np.ndarray, strokes: np.ndarray) -> np.ndarray:
    """Of all ways to have each stroke free or at a limit, the one that moves the tip least."""
    best, least = np.zeros(3), np.inf
    for fixed in itertools.product([np.nan, 0.0, STROKE], repeat=3):
        tried = np.array(fixed)
        free = np.isnan(tried)
        held = slope[:, ~free] @ (tried - strokes)[~free]
        tried[free] = strokes[free] - np.linalg.lstsq(slope[:, free], held)[0]
        gap = np.linalg.norm(slope @ (tried - strokes))
        inside = np.all((tried >= -1e-9 * STROKE) & (tried <= STROKE * (1 + 1e-9)))
        if inside and gap < least:
            best, least = tried, gap
    return best


SLOPES = [_slope_at_rest(**changes) for changes in SHAPES]
LIMITED = [
    ca.Function("limited", [argument], [*parallel_3dof.limited(_geometry(**changes), argument)])
    for changes in SHAPES
    for argument in [ca.SX.sym("argument", 3)]
]
anywhere = st.sampled_from([0.0, STROKE, 2 * STROKE, -STROKE]) | st.floats(
    -10 * STROKE, 10 * STROKE
)


@settings(max_examples=300)
@given(st.integers(0, len(SHAPES) - 1), st.tuples(*[anywhere] * 3).map(np.array))
def test_limited_strokes_are_the_minimum_of_the_metric(shape, strokes):
    within = _column(LIMITED[shape](strokes)[0])
    expected = _nearest_strokes(SLOPES[shape], strokes)
    np.testing.assert_allclose(within, expected, atol=1e-8 * STROKE)


@settings(max_examples=100)
@given(st.integers(0, len(SHAPES) - 1), strokes_in_range)
def test_strokes_in_range_are_returned_to_the_last_bit(shape, strokes):
    within, reachable = LIMITED[shape](strokes)
    np.testing.assert_array_equal(_column(within), strokes)
    assert reachable == 1


def _plant(**changes: float) -> tuple[ca.Function, ca.Function]:
    """Deflection of the instrument by strokes, (3,) [m], and its slope; shares no code."""
    p = instrument.Params.unpack(ca.SX(instrument.Params.starting(**changes).starts()))
    strokes = ca.SX.sym("strokes", 3)
    tip = instrument.shaft_tip(p, strokes) - instrument.shaft_tip(p, ca.SX.zeros(3))
    return (
        ca.Function("tip", [strokes], [tip]),
        ca.Function("slope", [strokes], [ca.jacobian(tip, strokes)]),
    )


def _nearest_place(plant: tuple[ca.Function, ca.Function], wanted: np.ndarray) -> np.ndarray:
    """Where the instrument's tip comes nearest to a place, (3,) [m]; in units of a stroke."""
    tip, slope = plant
    found = least_squares(
        lambda x: (_column(tip(STROKE * x)) - wanted) / STROKE,
        np.full(3, 0.5),
        jac=lambda x: np.array(slope(STROKE * x)),
        bounds=(0, 1),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return _column(tip(STROKE * found.x))


@pytest.mark.parametrize(
    ("geometry", "plant"),
    [
        ({}, {}),
        ({"shaft_length": 0.1}, {"shaft_length": 0.1}),
        (WIDE, {"radius": 20e-3, "shaft_length": 20e-3}),
    ],
)
def test_tip_comes_as_near_as_it_can_to_what_cannot_be_reached(geometry, plant):
    """Demands up to twice the size of the workspace.

    It stays within 0.1 um of the least distance (found: 0.01 um); the place itself, which that
    distance leaves free to move sideways, is within 1 % of the overshoot and 0.5 um.
    """
    kinematics = _plant(**plant)
    corners = np.array(kinematics[0](_workspace(2)))
    low, high = corners.min(axis=1), corners.max(axis=1)
    draws = np.random.default_rng(9).uniform(-1, 1, (80, 3))
    wanted = (low + high) / 2 + 2 * draws * (high - low) / 2
    run = Runner(parallel_3dof.MODEL, geometry).run(len(wanted), {"displacement": wanted})
    beyond = run["reachable"] == 0
    assert beyond.sum() > 60
    for place, strokes in zip(wanted[beyond], run["strokes"][beyond], strict=True):
        reached = _column(kinematics[0](strokes))
        nearest = _nearest_place(kinematics, place)
        overshoot = np.linalg.norm(nearest - place)
        assert np.linalg.norm(reached - place) < overshoot + 0.1 * MICROMETRE
        assert np.linalg.norm(reached - nearest) < 0.01 * overshoot + 0.5 * MICROMETRE


@pytest.mark.parametrize("angle", np.radians([0.0, 75.0, 200.0]))
@pytest.mark.parametrize("height", [-40e-6, 160e-6])
def test_lateral_part_is_kept_when_only_the_axial_one_is_out_of_range(angle, height):
    """The faces of the workspace lean by r / l, some eighth, and so does the way to them."""
    lateral = 200e-6 * np.array([np.cos(angle), np.sin(angle)])
    run = Runner(parallel_3dof.MODEL).run(1, {"displacement": np.append(lateral, height)})
    assert run["reachable"][0] == 0
    lost = _column(FORWARD(run["strokes"][0])) - np.append(lateral, height)
    assert np.abs(lost[2]) > 40e-6
    assert np.linalg.norm(lost[:2]) < 0.16 * np.abs(lost[2])


def test_strokes_follow_a_demand_across_the_limit_without_a_jump():
    """Along the axis a stroke moves by 1 / k of the demand, in other directions hardly more."""
    path = np.linspace(0.0, 1.0, 1500)[:, None] * [1.2e-3, 0.7e-3, 0.3e-3]
    run = Runner(parallel_3dof.MODEL).run(len(path), {"displacement": path})
    assert run["reachable"][-1] == 0
    step = np.linalg.norm(path[1])
    assert np.abs(np.diff(run["strokes"], axis=0)).max() < 1.1 * step / design.LEVER_GAIN
