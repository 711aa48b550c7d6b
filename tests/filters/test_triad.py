"""TRIAD against SciPy's rotations and a Monte Carlo of its covariance."""

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.filters import triad

DIP = np.radians(55)
NORTH = np.array([np.cos(DIP), 0, -np.sin(DIP)])


def triad_function() -> ca.Function:
    z, n = ca.SX.sym("z", 3), ca.SX.sym("n", 3)
    return ca.Function("triad", [z, n], [triad.attitude(z, n), triad.covariance(z, n, 1e-3, 3e-3)])


FUNCTION = triad_function()


@given(st.integers(0, 10**6))
def test_attitude_is_recovered_from_exact_vectors(seed) -> None:
    truth = Rotation.random(random_state=seed)
    q = np.array(FUNCTION(truth.inv().apply([0, 0, 1]), truth.inv().apply(NORTH))[0]).ravel()
    error = truth.inv() * Rotation.from_quat(q, scalar_first=True)
    assert error.magnitude() < 1e-7
    assert q[0] >= 0


def test_half_turn_is_no_special_case() -> None:
    """A04 4.27 divides by zero at 180 degrees."""
    for axis in np.eye(3):
        truth = Rotation.from_rotvec(np.pi * axis)
        q = np.array(FUNCTION(truth.inv().apply([0, 0, 1]), truth.inv().apply(NORTH))[0]).ravel()
        assert (truth.inv() * Rotation.from_quat(q, scalar_first=True)).magnitude() < 1e-7


def test_vertical_field_gives_finite_numbers() -> None:
    for result in FUNCTION([0, 0, 1], [0, 0, -1]):
        assert np.isfinite(np.array(result)).all()


def test_covariance_is_that_of_repeated_measurements() -> None:
    rng = np.random.default_rng(3)
    truth = Rotation.random(random_state=8)
    z_B, n_B = truth.inv().apply([0, 0, 1]), truth.inv().apply(NORTH)

    def disturbed(v: np.ndarray, sigma: float) -> np.ndarray:
        e = rng.normal(size=3) * sigma
        v = v + e - v * (v @ e)
        return v / np.linalg.norm(v)

    count = 4000
    inputs = np.array([np.r_[disturbed(z_B, 1e-3), disturbed(n_B, 3e-3)] for _ in range(count)]).T
    q = np.array(FUNCTION.map(count)(inputs[:3], inputs[3:])[0]).T
    errors = (truth.inv() * Rotation.from_quat(q, scalar_first=True)).as_rotvec()
    predicted = np.array(FUNCTION(z_B, n_B)[1])
    # 4000 draws give a variance to about 2 %; three times that.
    np.testing.assert_allclose(np.cov(errors.T), predicted, atol=0.07 * np.trace(predicted))
