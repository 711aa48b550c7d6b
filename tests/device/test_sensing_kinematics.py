"""The differential kinematics against rigid-body motion written out independently in NumPy."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics

SITES = np.array([[20.2e-3, 0, 0], [0, 20.2e-3, 0], [14.3e-3, 14.3e-3, 116e-3]])
TIP = np.array([0, 0, 0.21])
T = 1e-3
GEOMETRY = kinematics.Geometry.of_design(design.D1, design.D2, design.D3, ca.DM(design.TIP))
NO_PRIOR = (1e-6, 1e12)
vectors = st.lists(st.floats(-3, 3), min_size=3, max_size=3).map(np.array)


def channels(force: np.ndarray, alpha: np.ndarray, w: np.ndarray) -> np.ndarray:
    """What ideal accelerometers read when the body's origin has the specific force `force`."""
    at = [force + np.cross(alpha, p) + np.cross(w, np.cross(w, p)) for p in SITES]
    return np.array([at[0][0], at[0][2], at[1][1], at[1][2], at[2][0], at[2][1]])


def evaluate(expression: ca.SX) -> np.ndarray:
    return np.array(ca.DM(expression)).squeeze()


def test_design_geometry_has_the_determinant_of_the_errata() -> None:
    P_D = evaluate(kinematics.lever_matrix(GEOMETRY))
    assert np.linalg.det(P_D) == pytest.approx(2 * design.D1 * design.D2 * design.D3)


@settings(max_examples=50)
@given(vectors, vectors)
def test_without_prior_the_gain_is_the_inverse_of_the_levers(force, alpha) -> None:
    gain = evaluate(kinematics.rate_gain(GEOMETRY, *NO_PRIOR))
    A_D = evaluate(kinematics.differences(ca.DM(channels(force, alpha, np.zeros(3)))))
    np.testing.assert_allclose(gain @ A_D, alpha, atol=1e-9)


@settings(max_examples=50)
@given(vectors, vectors, vectors)
def test_nonlinear_solution_is_exact_with_centripetal_terms(force, alpha, w) -> None:
    """At 3 rad/s the linear solution errs by the centripetal terms, the nonlinear one does not."""
    f = channels(force, alpha, w + alpha * T)
    A_D = kinematics.differences(ca.DM(f))
    found = evaluate(
        kinematics.angular_acceleration(A_D, ca.DM(w), GEOMETRY, NO_PRIOR, T, iterations=3)
    )
    np.testing.assert_allclose(found, alpha, atol=1e-6)


@settings(max_examples=50)
@given(vectors, vectors, vectors)
def test_tip_force_is_that_of_the_rigid_body(force, alpha, w) -> None:
    f = channels(force, alpha, w)
    expected = force + np.cross(alpha, TIP) + np.cross(w, np.cross(w, TIP))
    found = kinematics.tip_force(ca.DM(f), ca.DM(alpha), ca.DM(w), GEOMETRY, ca.DM.ones(6))
    np.testing.assert_allclose(evaluate(found), expected, atol=1e-12)


def test_elimination_equals_generalised_least_squares_of_all_channels() -> None:
    """Differences, prior and compounding together are one weighted least-squares problem."""
    rng = np.random.default_rng(4)
    density, roll = 1e-3, 0.05
    f = rng.normal(size=6)
    rows = []
    for i, axis in zip((0, 0, 1, 1, 2, 2), (0, 2, 1, 2, 0, 1), strict=True):
        lever = SITES[i] - TIP
        alpha_part = [np.cross(e, lever)[axis] for e in np.eye(3)]
        rows.append(np.r_[np.eye(3)[axis], alpha_part] / density)
    design_matrix = np.vstack([*rows, np.r_[np.zeros(5), 1 / roll]])
    solution = np.linalg.lstsq(design_matrix, np.r_[f / density, 0], rcond=None)[0]
    gain = kinematics.rate_gain(GEOMETRY, density**2, roll**2)
    alpha = gain @ kinematics.differences(ca.DM(f))
    force = kinematics.tip_force(ca.DM(f), alpha, ca.DM.zeros(3), GEOMETRY, ca.DM.ones(6))
    np.testing.assert_allclose(evaluate(alpha), solution[3:], rtol=1e-9)
    np.testing.assert_allclose(evaluate(force), solution[:3], rtol=1e-9)


def test_compounding_follows_the_variances() -> None:
    f = ca.DM([1.0, 0, 0, 0, 3.0, 0])
    unequal = ca.DM([1.0, 1, 1, 1, 3.0, 1])
    assert evaluate(kinematics.compound(f, unequal))[0] == pytest.approx(0.75 * 1 + 0.25 * 3)


def test_prior_trades_noise_of_the_lateral_tip_for_roll() -> None:
    """Inverting the levers alone amplifies noise at the tip sideways by 7; the prior heals it."""
    f = ca.SX.sym("f", 6)

    def amplification(density: float, roll_density: float) -> np.ndarray:
        alpha = kinematics.rate_gain(GEOMETRY, density, roll_density) @ kinematics.differences(f)
        force = kinematics.tip_force(f, alpha, ca.DM.zeros(3), GEOMETRY, ca.DM.ones(6))
        slope = np.array(ca.DM(ca.densify(ca.jacobian(force, f))))
        return np.linalg.norm(slope, axis=1)

    assert amplification(*NO_PRIOR)[:2].min() > 7
    assert amplification(1e-6, 1e-6)[:2].max() < 2.5
