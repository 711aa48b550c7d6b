"""CasADi rotations against SciPy's."""

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.math import rotations

seeds = st.integers(0, 2**31 - 1)


def value(expression: ca.SX) -> np.ndarray:
    return np.array(ca.DM(expression)).squeeze()


def quaternion(rotation: Rotation) -> ca.SX:
    return ca.SX(ca.DM(rotation.as_quat(scalar_first=True)))


@given(seeds, seeds)
def test_product_and_matrix(a, b) -> None:
    one, two = Rotation.random(random_state=a), Rotation.random(random_state=b)
    product = rotations.multiply(quaternion(one), quaternion(two))
    np.testing.assert_allclose(
        value(rotations.matrix(product)), (one * two).as_matrix(), atol=1e-14
    )
    back = rotations.multiply(product, rotations.conjugate(product))
    np.testing.assert_allclose(value(back), [1, 0, 0, 0], atol=1e-14)


@given(seeds)
def test_matrix_and_back_has_a_scalar_part_that_is_not_negative(seed) -> None:
    rotation = Rotation.random(random_state=seed)
    q = value(rotations.from_matrix(ca.SX(ca.DM(rotation.as_matrix()))))
    assert q[0] >= 0
    np.testing.assert_allclose(
        Rotation.from_quat(q, scalar_first=True).as_matrix(), rotation.as_matrix(), atol=1e-13
    )


def test_half_turns_about_every_axis() -> None:
    for axis in [*np.eye(3), np.ones(3) / np.sqrt(3)]:
        R = Rotation.from_rotvec(np.pi * axis).as_matrix()
        q = value(rotations.from_matrix(ca.SX(ca.DM(R))))
        np.testing.assert_allclose(np.abs(q), [0, *np.abs(axis)], atol=1e-8)


def test_rotation_vectors_of_every_size() -> None:
    direction = np.array([0.36, -0.48, 0.8])
    for angle in (0.0, 1e-12, 1e-8, 1e-5, 0.9e-4, 1.1e-4, 1e-2, 1.0, 3.14):
        theta = angle * direction
        q = rotations.from_rotation_vector(ca.SX(ca.DM(theta)))
        expected = Rotation.from_rotvec(theta)
        np.testing.assert_allclose(value(q), expected.as_quat(scalar_first=True), atol=1e-16)
        np.testing.assert_allclose(value(rotations.to_rotation_vector(q)), theta, atol=1e-14)


def test_skew_is_the_cross_product() -> None:
    a, b = np.array([1.0, -2, 3]), np.array([0.5, 4, -1])
    np.testing.assert_allclose(value(rotations.skew(ca.SX(ca.DM(a)))) @ b, np.cross(a, b))
