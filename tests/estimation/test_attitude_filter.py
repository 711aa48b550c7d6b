"""The error-state filter against numerical derivatives and SciPy's batch least squares."""

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fmu_src.estimation.micron import attitude_filter as filters
from fmu_src.filters import triad
from fmu_src.math import rotations

T = 1e-3


def function(build, *sizes) -> ca.Function:
    symbols = [ca.SX.sym(f"s{i}", *np.atleast_1d(size)) for i, size in enumerate(sizes)]
    result = build(*symbols)
    return ca.Function("f", symbols, list(result) if isinstance(result, tuple) else [result])


PREDICT = function(lambda q, w: filters.predict_attitude(q, w, T), 4, 3)
TRANSITION = function(lambda w: filters.transition(w, T), 3)
INNOVATION = function(filters.innovation, 4, 4)
COVARIANCE = function(lambda P, w, W: filters.predict_covariance(P, w, W, T), (6, 6), 3, (6, 6))
TILT = function(filters.tilt_innovation, 3)
NORTH = function(filters.north_innovation, 3)
TRIAD = np.hstack([np.eye(3), np.zeros((3, 3))])


def corrected(q, b, P, residual, V):
    """(q, b, P, normalised innovation squared) after an attitude measured by TRIAD."""
    done = filters.correct(P, residual, ca.SX(ca.DM(TRIAD)), V)
    return filters.moved(q, done.change), b + done.change[3:], done.P, done.nis


CORRECT = function(corrected, 4, 3, (6, 6), 3, (3, 3))


def quaternion(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def test_transition_is_the_derivative_of_the_prediction() -> None:
    """Central differences of the nonlinear prediction, at rates up to 5 rad/s."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        truth, w, b = Rotation.random(random_state=rng), rng.normal(size=3) * 5, rng.normal(size=3)
        nominal = np.array(PREDICT(quaternion(truth), w - b)).ravel()

        def error_after(e: np.ndarray, truth=truth, w=w, b=b, nominal=nominal) -> np.ndarray:
            start = quaternion(truth * Rotation.from_rotvec(e[:3]))
            moved = np.array(PREDICT(start, w - b - e[3:])).ravel()
            return np.r_[np.array(INNOVATION(nominal, moved)).ravel(), e[3:]]

        h = 1e-4
        numeric = np.column_stack(
            [(error_after(h * e) - error_after(-h * e)) / (2 * h) for e in np.eye(6)]
        )
        # The right Jacobian is taken as the identity: it differs by half the angle, w T.
        np.testing.assert_allclose(np.array(TRANSITION(w - b)), numeric, atol=T * 10 * T)


def test_innovation_has_the_identity_as_jacobian() -> None:
    q = quaternion(Rotation.random(random_state=2))
    h = 1e-5
    for i, e in enumerate(np.eye(3)):
        z = quaternion(Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(h * e))
        np.testing.assert_allclose(np.array(INNOVATION(q, z)).ravel() / h, np.eye(3)[i], atol=1e-6)


@given(st.integers(0, 10**6))
def test_vertical_and_north_are_what_triad_measures(seed) -> None:
    """A04's measurement reachable: same residual, and the covariance (4.34) of any attitude.

    Two numbers of the vertical and one of the field determine the attitude, so its covariance is
    (H^T V^-1 H)^-1; that of TRIAD is written down without them.
    """
    rng = np.random.default_rng(seed)
    truth = Rotation.random(random_state=seed)
    dip = np.radians(rng.uniform(-75, 75))
    z_B, n_B = truth.inv().apply([[0, 0, 1], [np.cos(dip), 0, -np.sin(dip)]])
    predicted = truth * Rotation.from_rotvec(1e-5 * rng.normal(size=3))
    R = predicted.as_matrix()
    north, slope = (np.array(v) for v in NORTH(R @ n_B))
    H = np.vstack([R[:2], slope @ R])
    residual = np.r_[np.array(TILT(R @ z_B)).ravel(), north.ravel()]
    z = quaternion(truth)
    measured = np.array(INNOVATION(quaternion(predicted), z)).ravel()
    np.testing.assert_allclose(np.linalg.solve(H, residual), measured, atol=1e-8)

    G, N = 9e-3, 2e-3
    V = np.diag([G**2, G**2, (N / np.cos(dip)) ** 2])
    z_sym, n_sym = ca.SX.sym("z", 3), ca.SX.sym("n", 3)
    theirs = ca.Function("c", [z_sym, n_sym], [triad.covariance(z_sym, n_sym, G, N)])(z_B, n_B)
    ours = np.linalg.inv(H.T @ np.linalg.inv(V) @ H)
    np.testing.assert_allclose(ours, np.array(theirs), atol=1e-3 * np.trace(ours))


@given(st.integers(0, 10**6), st.floats(0, np.pi))
def test_tilt_innovation_turns_to_the_measured_vertical_from_any_angle(seed, angle) -> None:
    """Also upside down: after the turn that it asks for, the vertical is where it was measured."""
    axis = np.random.default_rng(seed).normal(size=2)
    wrong = Rotation.from_rotvec(np.r_[angle * axis / np.linalg.norm(axis), 0])
    up = wrong.inv().apply([0, 0, 1])
    asked = np.r_[np.array(TILT(up)).ravel(), 0]
    np.testing.assert_allclose(Rotation.from_rotvec(asked).apply(up), [0, 0, 1], atol=1e-7)


def test_what_a_measurement_may_not_change_keeps_its_covariance_honest() -> None:
    """Corrections projected on one axis: the others stay, and P is that of a Monte Carlo."""
    rng = np.random.default_rng(4)
    root = np.tril(rng.normal(size=(6, 6))) * 1e-2
    P0, V, H = root @ root.T, np.array([[1e-4]]), rng.normal(size=(1, 6))
    onto = np.zeros((6, 6))
    onto[2, 2] = onto[5, 5] = 1
    change = function(
        lambda P, r: filters.correct(
            P, r, ca.SX(ca.DM(H)), ca.SX(ca.DM(V)), onto=ca.SX(ca.DM(onto))
        )[:2],
        (6, 6),
        1,
    )
    errors = rng.multivariate_normal(np.zeros(6), P0, size=40000)
    residuals = errors @ H.T + rng.normal(size=(40000, 1)) * 1e-2
    gain, P = (np.array(v) for v in change(P0, 1.0))
    assert not gain[[0, 1, 3, 4]].any()
    left = errors - residuals @ gain.T
    np.testing.assert_allclose(np.cov(left.T), P, atol=0.03 * np.trace(P0))
    assert P[2, 2] < P0[2, 2]


def test_filter_is_batch_least_squares_on_a_short_window() -> None:
    """Same data, same covariances: the last state of a batch fit is the filter's state."""
    rng = np.random.default_rng(7)
    count = 15
    W = np.diag([1e-8] * 3 + [1e-5] * 3)
    V = np.array([[4e-6, 1e-6, 0], [1e-6, 3e-6, 0], [0, 0, 9e-6]])
    P0 = np.diag([1e-5] * 3 + [1e-2] * 3)
    rates = rng.normal(size=(count, 3))
    truth, bias = Rotation.random(random_state=5), np.zeros(3)
    start, measured = truth, []
    for w in rates:
        noise = rng.multivariate_normal(np.zeros(6), W)
        truth = truth * Rotation.from_rotvec((w - bias) * T + noise[:3])
        bias = bias + noise[3:]
        measured.append(truth * Rotation.from_rotvec(rng.multivariate_normal(np.zeros(3), V)))
    first = start * Rotation.from_rotvec([1e-3, -2e-3, 1e-3])

    q, b, P = quaternion(first), np.zeros(3), P0
    for w, z in zip(rates, measured, strict=True):
        q_predicted = PREDICT(q, w - b)
        P = COVARIANCE(P, w - b, W)
        residual = INNOVATION(q_predicted, quaternion(z))
        q, b, P, _ = (np.array(v).squeeze() for v in CORRECT(q_predicted, b, P, residual, V))

    whiten = {
        name: np.linalg.inv(np.linalg.cholesky(C))
        for name, C in zip("WVP", (W, V, P0), strict=True)
    }

    def residuals(unknown: np.ndarray) -> np.ndarray:
        """Noise of every sample is unknown; the states follow from it."""
        noise = unknown.reshape(count + 1, 6)
        attitude, drift = first * Rotation.from_rotvec(noise[0, :3]), noise[0, 3:]
        cost = [whiten["P"] @ noise[0]]
        for w, z, n in zip(rates, measured, noise[1:], strict=True):
            attitude = attitude * Rotation.from_rotvec((w - drift) * T + n[:3])
            drift = drift + n[3:]
            cost += [whiten["W"] @ n, whiten["V"] @ (attitude.inv() * z).as_rotvec()]
        residuals.last = attitude, drift
        return np.concatenate(cost)

    fit = least_squares(residuals, np.zeros((count + 1) * 6), method="lm")
    residuals(fit.x)
    attitude, drift = residuals.last
    gap = attitude.inv() * Rotation.from_quat(q, scalar_first=True)
    # What is left is of second order in errors of 2 mrad: a hundredth of the standard deviation.
    sigma = np.sqrt(np.diag(P))
    assert gap.magnitude() < 0.01 * sigma[:3].min()
    assert np.abs(b - drift).max() < 0.01 * sigma[3:].min()
    assert np.linalg.eigvalsh(P).min() > 0


def test_normalised_innovation_has_the_mean_of_a_chi_square() -> None:
    """With noise as modelled, the squared innovation averages its three degrees of freedom."""
    rng = np.random.default_rng(11)
    W, V = np.diag([1e-8] * 3 + [1e-6] * 3), 4e-6 * np.eye(3)
    truth, bias = Rotation.identity(), np.zeros(3)
    q, b, P = np.array([1.0, 0, 0, 0]), np.zeros(3), np.diag([4e-6] * 3 + [1e-4] * 3)
    squares = []
    for _ in range(4000):
        noise = rng.multivariate_normal(np.zeros(6), W)
        truth, bias = truth * Rotation.from_rotvec(-bias * T + noise[:3]), bias + noise[3:]
        z = truth * Rotation.from_rotvec(rng.normal(size=3) * 2e-3)
        predicted = PREDICT(q, -b)
        P = COVARIANCE(P, -b, W)
        q, b, P, squared = (
            np.array(v).squeeze()
            for v in CORRECT(predicted, b, P, INNOVATION(predicted, quaternion(z)), V)
        )
        squares.append(float(squared))
    assert abs(np.mean(squares[200:]) - 3) < 0.25


def test_unscented_covariance_is_exact_for_linear_maps() -> None:
    rng = np.random.default_rng(0)
    gain, root = rng.normal(size=(3, 4)), np.diag(rng.uniform(0.1, 2, 4))
    found = ca.DM(filters.unscented_covariance(lambda s: ca.DM(gain) @ s, ca.SX(ca.DM(root))))
    np.testing.assert_allclose(np.array(found), gain @ root @ root.T @ gain.T, rtol=1e-12)


def test_unscented_covariance_of_a_square_matches_monte_carlo() -> None:
    """A map with curvature, as A04 uses it for: s + s^2 of a standard normal has variance 3."""
    found = filters.unscented_covariance(lambda s: s + s**2, ca.SX.eye(1), kappa=2.0)
    assert abs(float(ca.DM(found)) - 3.0) < 1e-12


def test_rotation_vector_survives_small_and_large_angles() -> None:
    there_and_back = function(
        lambda v: rotations.to_rotation_vector(rotations.from_rotation_vector(v)), 3
    )
    for angle in (0.0, 1e-9, 1e-5, 1e-3, 1.0, 3.1):
        v = angle * np.array([0.6, -0.8, 0.0])
        np.testing.assert_allclose(np.array(there_and_back(v)).ravel(), v, atol=1e-12)
