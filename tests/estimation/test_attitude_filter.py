"""The error-state filter against numerical derivatives and SciPy's batch least squares."""

import casadi as ca
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fmu_src.estimation import attitude_filter as filters
from fmu_src.kit import rotations

T = 1e-3


def function(build, *sizes) -> ca.Function:
    symbols = [ca.SX.sym(f"s{i}", *np.atleast_1d(size)) for i, size in enumerate(sizes)]
    result = build(*symbols)
    return ca.Function("f", symbols, list(result) if isinstance(result, tuple) else [result])


PREDICT = function(lambda q, w: filters.predict_attitude(q, w, T), 4, 3)
TRANSITION = function(lambda w: filters.transition(w, T), 3)
INNOVATION = function(filters.innovation, 4, 4)
COVARIANCE = function(lambda P, w, W: filters.predict_covariance(P, w, W, T), (6, 6), 3, (6, 6))
CORRECT = function(filters.correct, 4, 3, (6, 6), 3, (3, 3))


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
