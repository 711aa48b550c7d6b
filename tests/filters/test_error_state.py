"""The extended and the unscented filter, against independent solutions in NumPy and SciPy."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.errors import SteadytipError
from fmu_src.filters.error_space import Space
from fmu_src.filters.error_state import Extended, Unscented, lazy_update, root
from fmu_src.kit import State
from fmu_src.kit.records import real
from fmu_src.math import rotations


class Straight(State):
    """Position and velocity on a line, and a known constant."""

    position = real("m", "position")
    velocity = real("m/s", "velocity")
    known = real(None, "a number without variance")


class Turning(State):
    """Attitude and rate."""

    attitude = real(None, "q_WB", shape=4, start=(1, 0, 0, 0))
    rate = real("rad/s", "body rate", shape=3)


class Flying(State):
    """All kinds of errors: straight, scaled, bent, and without effect."""

    position = real("m", "position", shape=3)
    velocity = real("m/s", "velocity", shape=3)
    offset = real("m", "a sensor's, fading", shape=2)
    attitude = real(None, "q_WB", shape=4, start=(1, 0, 0, 0))
    lever = real("m", "from where forces act to what is seen, in B", shape=3)
    rate = real("rad/s", "body rate", shape=3)


LINE, TURN, FLIGHT = Space(Straight), Space(Turning, "attitude"), Space(Flying, "attitude")
T = 0.1
vectors = st.lists(st.floats(-1.8, 1.8), min_size=3, max_size=3).map(np.array)
"""Shorter than half a turn, beyond which a rotation vector is not the shortest."""


def drive(x, u):
    return x.replace(position=x.position + T * x.velocity, velocity=x.velocity + u[0])


def seen(x, u):
    return u[0] - x.position - x.known


def turn(x, u):
    turned = rotations.multiply(x.attitude, rotations.from_rotation_vector(T * x.rate))
    return x.replace(attitude=turned)


def fly(x, u):
    force = rotations.matrix(x.attitude) @ u
    turned = rotations.multiply(x.attitude, rotations.from_rotation_vector(T * x.rate))
    return x.replace(
        position=x.position + T * x.velocity + T * T / 2 * force,
        velocity=x.velocity + T * force,
        offset=0.9 * x.offset,
        attitude=turned,
    )


def sighted(x, u):
    lever = rotations.matrix(x.attitude) @ x.lever
    return u - x.position - lever - ca.vertcat(x.offset, 0)


def vertical(x, u):
    return u - rotations.matrix(x.attitude).T @ ca.DM([0, 0, 1])


def numbers(call, *arguments):
    """Results of a step of a filter as arrays."""
    symbols = [ca.MX.sym(f"a{i}", *ca.DM(a).shape) for i, a in enumerate(arguments)]
    results = ca.Function("call", symbols, list(call(*symbols))).call(list(map(ca.DM, arguments)))
    return [np.array(result) for result in results]


def scattered(size, seed=0):
    """A covariance without structure."""
    A = np.random.default_rng(seed).normal(size=(size, size))
    return A @ A.T / size


@pytest.mark.parametrize("method", [Extended(LINE), Unscented(LINE)], ids=["extended", "unscented"])
def test_a_linear_system_gets_the_kalman_filter(method) -> None:
    P = scattered(3)
    P[2] = P[:, 2] = 0.0
    Q, R, x = np.diag([0.1, 0.2, 0.0]), np.array([[0.3]]), np.array([1.0, -2.0, 0.5])
    F = np.array([[1, T, 0], [0, 1, 0], [0, 0, 1]])
    H = np.array([[1.0, 0, 1]])
    after, P_after = numbers(lambda x, P: method.predict(drive, x, ca.MX(ca.DM([0.7])), P, Q), x, P)
    np.testing.assert_allclose(after.ravel(), F @ x + [0, 0.7, 0], atol=1e-12)
    np.testing.assert_allclose(P_after, F @ P @ F.T + Q, atol=1e-12)

    found, P_found, r, squared = numbers(
        lambda x, P: method.correct(seen, x, ca.MX(ca.DM([0.9])), P, R), x, P
    )
    S = H @ P @ H.T + R
    K = P @ H.T / S
    np.testing.assert_allclose(r, 0.9 - 1.5, atol=1e-12)
    np.testing.assert_allclose(found.ravel(), x + (K * (0.9 - 1.5)).ravel(), atol=1e-12)
    np.testing.assert_allclose(P_found, P - K @ S @ K.T, atol=1e-12)
    np.testing.assert_allclose(squared, 0.36 / S, atol=1e-12)
    assert found[2, 0] == x[2], "what is known stays"


@pytest.mark.parametrize("method", [Extended(LINE), Unscented(LINE)], ids=["extended", "unscented"])
def test_what_a_gate_does_not_believe_lies_at_the_gate(method) -> None:
    P, R, x = np.diag([1.0, 1.0, 0.0]), np.array([[3.0]]), np.zeros(3)
    found, P_found, r, squared = numbers(
        lambda x, P: method.correct(seen, x, ca.MX(ca.DM([100.0])), P, R, 9.0), x, P
    )
    assert r[0, 0] == pytest.approx(100.0)
    assert squared[0, 0] == pytest.approx(100.0**2 / 4)
    S = 100.0**2 / 9
    np.testing.assert_allclose(found.ravel(), [100.0 / S, 0, 0], rtol=1e-9)
    assert P_found[0, 0] == pytest.approx(1 - 1 / S)


@given(vectors, vectors, vectors)
@settings(max_examples=25)
def test_an_error_moves_a_state_to_where_it_was_measured(start, error, rate) -> None:
    q = np.roll(Rotation.from_rotvec(start).as_quat(), 1)
    x, e = np.concatenate([q, rate]), np.concatenate([error, -rate])
    moved = np.array(ca.evalf(TURN.moved(ca.DM(x), ca.DM(e)))).ravel()
    other = Rotation.from_rotvec(start) * Rotation.from_rotvec(error)
    assert abs(np.dot(np.roll(other.as_quat(), 1), moved[:4])) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(
        np.array(ca.evalf(TURN.error(ca.DM(x), ca.DM(moved)))).ravel(), e, atol=1e-7
    )


@pytest.mark.parametrize("method", [Extended(TURN), Unscented(TURN)], ids=["extended", "unscented"])
@given(vectors, vectors)
@settings(max_examples=10)
def test_small_errors_of_an_attitude_spread_as_samples_do(method, start, rate) -> None:
    """Ten thousand samples, moved by SciPy: mean and covariance within their own scatter."""
    q = np.roll(Rotation.from_rotvec(start).as_quat(), 1)
    x, P = np.concatenate([q, rate]), 4e-4 * scattered(6, 1)
    after, P_after = numbers(
        lambda x, P: method.predict(turn, x, ca.MX(ca.DM.zeros(1)), P, np.zeros((6, 6))), x, P
    )
    rng = np.random.default_rng(2)
    errors = rng.multivariate_normal(np.zeros(6), P, 10_000)
    turned = Rotation.from_rotvec(start) * Rotation.from_rotvec(errors[:, :3])
    turned = turned * Rotation.from_rotvec(T * (rate + errors[:, 3:]))
    mean = Rotation.from_quat(np.roll(after[:4, 0], -1))
    samples = np.hstack([(mean.inv() * turned).as_rotvec(), errors[:, 3:]])
    sigma = np.sqrt(np.diag(P_after))
    assert np.all(np.abs(samples.mean(axis=0)) < 5 * sigma / 100)
    scale = np.outer(sigma, sigma)
    assert np.abs((np.cov(samples.T) - P_after) / scale).max() < 0.06


def test_wide_spreads_are_where_the_unscented_filter_is_better() -> None:
    """A vertical through an attitude known to 40 degrees: its mean is shorter than one.

    Only the unscented residual knows: the mean of the cosine, exp(-sigma^2 / 2), to 0.01.
    """
    sigma = 0.7
    P = np.diag([sigma**2, 0, 0, 0, 0, 0])
    x, z = np.array([1.0, 0, 0, 0, 0, 0, 0]), np.zeros(3)
    residuals = {}
    for method in (Extended(TURN), Unscented(TURN, kappa=-3.0)):
        _, _, r, _ = numbers(
            lambda x, P, method=method: method.correct(vertical, x, ca.MX(ca.DM(z)), P, np.eye(3)),
            x,
            P,
        )
        residuals[type(method)] = -r[2, 0]
    assert residuals[Extended] == pytest.approx(1.0)
    assert residuals[Unscented] == pytest.approx(np.exp(-(sigma**2) / 2), abs=0.01)


def flown(x, force):
    """`fly` and the position that is seen, in SciPy."""
    q = Rotation.from_quat(np.roll(x[8:12], -1))
    a = q.apply(force)
    p, v = x[:3] + T * x[3:6] + T * T / 2 * a, x[3:6] + T * a
    turned = q * Rotation.from_rotvec(T * x[15:])
    after = np.concatenate([p, v, 0.9 * x[6:8], np.roll(turned.as_quat(), 1), x[12:]])
    return after, x[:3] + q.apply(x[12:15]) + [*x[6:8], 0]


def flown_from(x, e):
    """State moved by an error."""
    q = Rotation.from_quat(np.roll(x[8:12], -1)) * Rotation.from_rotvec(e[8:11])
    return np.concatenate([x[:8] + e[:8], np.roll(q.as_quat(), 1), x[12:] + e[11:]])


def between(x, y):
    """Error from a state to another."""
    q, r = (Rotation.from_quat(np.roll(state[8:12], -1)) for state in (x, y))
    return np.concatenate([y[:8] - x[:8], (q.inv() * r).as_rotvec(), y[12:] - x[12:]])


@pytest.mark.parametrize("kappa", [0.0, -14.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_points_that_are_not_taken_change_nothing(kappa, seed) -> None:
    """All 35 sigma points, one after the other, give the same mean and covariances."""
    method, rng = Unscented(FLIGHT, kappa=kappa), np.random.default_rng(seed)
    n, force, z = FLIGHT.error_size, rng.normal(size=3), rng.normal(size=3)
    q = Rotation.random(random_state=seed)
    x = np.concatenate([rng.normal(size=8), np.roll(q.as_quat(), 1), rng.normal(size=6)])
    P, R = 0.1 * scattered(n, seed), 0.01 * np.eye(3)

    def points(*first):
        """Those errors come first in Cholesky's factor that bend what is done with them."""
        order = np.concatenate([np.arange(n)[list(first)], np.delete(np.arange(n), list(first))])
        root = np.zeros((n, n))
        root[order] = np.linalg.cholesky(P[np.ix_(order, order)])
        far = np.sqrt(n + kappa) * root.T
        weights = np.full(2 * n + 1, 0.5 / (n + kappa))
        weights[0] = kappa / (n + kappa)
        errors = np.vstack([np.zeros(n), far, -far])
        return errors, [flown(flown_from(x, e), force) for e in errors], weights

    after, P_after = numbers(
        lambda x, P: method.predict(fly, x, ca.MX(ca.DM(force)), P, np.zeros((n, n))), x, P
    )
    _, images, weights = points(*range(8, 11), *range(14, 17))
    mean = images[0][0]
    for _ in range(3):
        mean = flown_from(mean, weights @ [between(mean, image) for image, _ in images])
    apart = np.array([between(mean, image) for image, _ in images])
    np.testing.assert_allclose(between(mean, after.ravel()), 0, atol=1e-9)
    np.testing.assert_allclose(P_after, apart.T @ (apart * weights[:, np.newaxis]), atol=1e-9)

    found, P_found, r, _ = numbers(
        lambda x, P: method.correct(sighted, x, ca.MX(ca.DM(z)), P, R), x, P
    )
    errors, images, weights = points(*range(8, 11))
    seen = np.array([position for _, position in images])
    apart = (seen - weights @ seen) * weights[:, np.newaxis]
    S = apart.T @ (seen - weights @ seen) + R
    K = np.linalg.solve(S, apart.T @ errors).T
    np.testing.assert_allclose(r.ravel(), z - weights @ seen, atol=1e-9)
    np.testing.assert_allclose(between(x, found.ravel()), K @ r.ravel(), atol=1e-8)
    np.testing.assert_allclose(P_found, P - K @ S @ K.T, atol=1e-9)


@given(st.integers(1, 6), st.integers(0, 5))
@settings(max_examples=25)
def test_a_root_squares_to_its_matrix_singular_or_not(size, seed) -> None:
    A = np.random.default_rng(seed).normal(size=(size, max(size - 2, 1)))
    P = A @ A.T
    P[0] = P[:, 0] = 0.0
    (L,) = numbers(lambda P: (root(P, size),), P)
    np.testing.assert_allclose(L @ L.T, P, atol=1e-7 * max(1.0, np.abs(P).max()))
    np.testing.assert_array_equal(L, np.tril(L))


def test_what_is_not_chosen_stays() -> None:
    def double(a, b):
        return 2 * a, a + b, b[0]

    for condition, wanted in ((1.0, (2.0, 4.0, 3.0)), (0.0, (1.0, 3.0, 0.0))):
        results = numbers(lambda c, a, b: lazy_update(c, double, a, b), condition, [1.0], [3.0])
        assert tuple(float(r[0, 0]) for r in results) == wanted


def test_a_field_that_is_not_there_is_told() -> None:
    with pytest.raises(SteadytipError, match="Straight has no field 'speed'"):
        LINE.diagonal(speed=1.0)
