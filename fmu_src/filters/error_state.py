"""Kalman filters on the error of a state that may hold rotations: extended and unscented.

| symbol | meaning |
| --- | --- |
| x | nominal state, a record whose fields are vectors and unit quaternions, stacked (N,) |
| e | its error, (n,): a quaternion's is a rotation vector in the body [rad], q (x) exp(e / 2) |
| x + e, y - x | the state moved by an error; the error that moves x to y |
| P | covariance of e, (n, n) |
| f, Q | process x' = f(x, u) and the covariance it adds |
| r(x, u) | residual: what was measured minus what x predicts, (m,) |
| R, S | covariance of the measurement, of the residual |
| nu, nis | normalised innovation squared r^T S^-1 r, chi-squared with m degrees of freedom |

Both filters have the same two steps, `predict` and `correct`, with the same arguments, so that a
model is written once and chooses. `process` and `residual` are functions of the nominal record and
a column of known numbers; they are recorded apart, on single elements, and called from the whole
matrices of the filter, which keeps the C code short.

The extended filter differentiates them by CasADi, at zero error: no Jacobian is written by hand.

The unscented one draws scaled sigma points (E13 3.31 to 3.33, weights with the errata)

    x, x + g L_i, x - g L_i      L L^T = P,  g^2 = n + lambda,  lambda = alpha^2 (n + kappa) - n

takes the mean of what the process makes of them by E13 3.47 to 3.50 - the errors about a mean, the
mean moved by their mean, again - and draws them anew about the predicted state for a measurement.
Most errors enter straight, or not at all; what their points would give is known without taking them
(`_SigmaPoints`). Cholesky's factor has a zero column where P has no variance: a parameter that is
known stays known.

A residual that the filter does not believe, nu above a gate for each degree of freedom, counts with
a covariance so much larger that it lies at the gate: it pulls a little, whatever its size, and a
filter that has gone astray finds back. nu as given out is that before this robust inflation.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.filters.error_space import (
    Process,
    ProcessEffect,
    Residual,
    Space,
    at_zero,
    jacobian_at_zero,
    nonlinear_errors,
    variables,
)

MEANS = 3
"""Rounds of the mean of rotations; errors of a radian are exact to rounding after three."""
LEAST_VARIANCE = 1e-40
"""Variance that is added to every one, for its root to have a derivative where it is zero."""
BLOCK = 8
"""Columns of Cholesky's factor that are found at once."""
SMALLEST = 1e-30
"""Pivot of Cholesky's factor, below which a direction has no variance."""


class Corrected(NamedTuple):
    """Result of a correction: state, covariance, residual (m,), nu."""

    x: Any
    P: Any
    residual: Any
    nis: Any


class Extended:
    """By Jacobians at the nominal state."""

    def __init__(self, space: Space) -> None:
        self.space = space

    def predict(self, process: Process, x: Any, u: Any, P: Any, Q: Any) -> tuple[Any, Any]:
        """State and covariance after the process."""
        part = ProcessEffect(self.space, process, u)
        small, center = part.small, part.small.stacked(part.alone)
        F = jacobian_at_zero(small.nearly(center, part.after(part.e)), part.e)
        results = [small.scaled(center), ca.densify(F.T)]
        center, F = ca.Function("transition", part.symbols, results, {"cse": True})(x, u)
        across = P @ F
        after, P = part.together(x, u, center, P, across, _symmetric(F.T @ across))
        return after, _plus(P, Q)

    def correct(
        self, residual: Residual, x: Any, u: Any, P: Any, R: Any, gate: Any = np.inf
    ) -> Corrected:
        """Take in a measurement; the covariance in Joseph's form, A P A^T + K R K^T, A = 1 - K H.

        Args:
            residual: measured minus predicted, (m,).
            x: nominal state.
            u: known numbers, the measurement among them.
            P: covariance of the error.
            R: covariance of the measurement, (m, m).
            gate: nu for each degree of freedom, beyond which R is inflated.
        """
        space = self.space
        point, known, e = variables(space, u)
        r = residual(space.record.unpack(space.moved(point, e)), known)
        H = -jacobian_at_zero(r, e)
        found = [at_zero(r, e), H]
        function = ca.Function("measure", [point, known], found, {"cse": True})
        r, H = function(x, u)
        gain = H @ P
        S = gain @ H.T + R
        solved, nis = _solved(S, gain, r)
        extra = _robust_inflation(nis, r, gate)
        K = solved.T / (1 + extra)
        R = R + extra * S
        P = P - K @ gain
        P = P - (P @ H.T) @ K.T + K @ R @ K.T
        return Corrected(_moved(space, x, K @ r), _symmetric(P), r, nis)


class Unscented:
    """By scaled sigma points (E13 3.4).

    Args:
        space: of the state.
        alpha: spread of the points.
        beta: 2 for a Gaussian.
        kappa: secondary scaling.
    """

    def __init__(
        self, space: Space, alpha: float = 1.0, beta: float = 0.0, kappa: float = 0.0
    ) -> None:
        self.space = space
        n = space.error_size
        self.scale = alpha * float(np.sqrt(n + kappa))
        self.extra = 1 - alpha**2 + beta

    def predict(self, process: Process, x: Any, u: Any, P: Any, Q: Any) -> tuple[Any, Any]:
        """State and covariance after the process.

        Points go through it for the fields that it moves. Errors of the others are only scaled, and
        so are their covariances, exactly.
        """
        part = ProcessEffect(self.space, process, u)
        small, center = part.small, part.small.stacked(part.alone)
        error = small.error(center, part.after(part.e))
        points = _SigmaPoints(error, part.e, P, part.symbols, (x, u))
        images = points.images("through", part.after(points.errors), self.scale)

        # Mean of the part that moves; the others' is where the process takes the state itself.
        about, other = ca.SX.sym("about", small.size), ca.SX.sym("other", small.size)
        e = ca.SX.sym("e", small.error_size)
        apart = ca.Function("apart", [about, other], [small.error(about, other)], {"cse": True})
        apart = apart.map("each_apart", "serial", images.shape[1], [0], [])
        to = ca.Function("to", [about, e], [small.scaled(small.moved(about, e))], {"cse": True})
        mean = images[:, 0]
        for _ in range(MEANS):
            mean = to(mean, self._mean(apart(mean, images)))
        own, across = self._covariance(apart(mean, images), points)
        after, P = part.together(x, u, mean, P, across, own)
        return after, _plus(P, Q)

    def correct(
        self, residual: Residual, x: Any, u: Any, P: Any, R: Any, gate: Any = np.inf
    ) -> Corrected:
        """Take in a measurement; arguments as those of `Extended.correct`."""
        space = self.space
        point, known, e = variables(space, u)

        def left(e: Any) -> Any:
            return residual(space.record.unpack(space.moved(point, e)), known)

        points = _SigmaPoints(left(e), e, P, [point, known], (x, u))
        images = points.images("measure", left(points.errors), self.scale)
        r = self._mean(images)
        spread, across = self._covariance(images - ca.repmat(r, 1, images.shape[1]), points)
        S = spread + R
        solved, nis = _solved(S, -across.T, r)
        wider = 1 + _robust_inflation(nis, r, gate)
        S, K = wider * S, solved.T / wider
        return Corrected(_moved(space, x, K @ r), _symmetric(P - K @ S @ K.T), r, nis)

    def _mean(self, images: Any) -> Any:
        """Return the mean of all points, from the images of those that were taken, (m, 1)."""
        each = 0.5 / self.scale**2
        count = images.shape[1] - 1
        return (1 - count * each) * images[:, 0] + each * ca.sum2(images[:, 1:])

    def _covariance(self, apart: Any, points: "_SigmaPoints") -> tuple[Any, Any]:
        """Return the covariance of the images, (m, m), and with the errors of the state, (n, m).

        Args:
            apart: images less their mean, (m, 1 + 2 bent).
            points: that they are of.
        """
        each = 0.5 / self.scale**2
        count = (apart.shape[1] - 1) // 2
        center, ahead, behind = ca.horzsplit(apart, [0, 1, 1 + count, 1 + 2 * count])
        slopes = ca.horzcat((ahead - behind) * (0.5 / self.scale), points.straight)
        straight, pairs = points.straight, apart[:, 1:]
        own = each * (pairs @ pairs.T) + straight @ straight.T
        own += (1 - 2 * count * each + self.extra) * (center @ center.T)
        return _symmetric(own), (points.root @ slopes.T)[points.back, :]


class _SigmaPoints:
    """Sigma points of a covariance, as far as a function of the errors needs them.

    The order of errors in Cholesky's factor is ours to choose. First come those that bend the
    function, then those in which it is straight while the first are zero, last those that it does
    not depend on. A column has zeros above its diagonal: images of points along the second kind lie
    on a line whose slope is known, those along the third are all that of the center. Only points
    along the first kind go through the function; the moments are those of all.

    Attributes:
        errors: (n,) expression of the errors that act, for the function.
        root: L (n, acting), rows in that order.
        back: where each error stands in it.
        straight: slope of the function times L, (m, straight).
    """

    def __init__(self, value: Any, e: Any, P: Any, given: list[Any], arguments: Any) -> None:
        """Find the order, and the root.

        Args:
            value: of the function, (m,), zero or not at e = 0.
            e: errors (n,).
            P: their covariance.
            given: what else `value` is made of.
            arguments: the same in the filter.
        """
        J = ca.jacobian(value, e)
        bent, straight = nonlinear_errors(J, e)
        acting = bent + straight
        order = acting + [i for i in range(e.numel()) if i not in acting]
        self.back = list(np.argsort(order))
        self.root = root(P[order, order], len(acting))
        self._bent, self._given, self._arguments = len(bent), given, arguments
        self._acting = ca.SX.sym("acting", len(acting))
        self.errors = ca.SX.zeros(e.numel())
        self.errors[acting] = self._acting
        along = ca.densify(at_zero(J[:, straight], e))
        along = ca.Function("along", given, [along], {"cse": True})(*arguments)
        self.straight = along @ self.root[len(bent) : len(acting), len(bent) :]

    def images(self, name: str, value: Any, scale: float) -> Any:
        """(N, 1 + 2 bent) of the center, and of the points ahead and behind along bent errors.

        Args:
            name: of the function in C.
            value: of the function at `errors`.
            scale: g.
        """
        function = ca.Function(name, [*self._given, self._acting], [value], {"cse": True})
        far = scale * self.root[: self._acting.numel(), : self._bent]
        errors = ca.horzcat(ca.DM.zeros(self._acting.numel()), far, -far)
        each = function.map(f"each_{name}", "serial", errors.shape[1], [0, 1], [])
        return each(*self._arguments, errors)


Filter = Extended | Unscented


def deviation(variance: Any) -> Any:
    """Return the standard deviation, with a derivative everywhere."""
    return ca.sqrt(ca.fmax(variance, 0) + LEAST_VARIANCE)


def root(P: Any, count: int) -> Any:
    """First columns of the lower triangular L with L L^T = P, (n, count): Cholesky's, by blocks.

    A direction without variance gives a column of zeros, so P may be singular.
    """
    L = ca.MX(ca.DM.zeros(P.shape[0], count))
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        left = P[start:, start:stop] - L[start:, :start] @ L[start:stop, :start].T
        L[start:stop, start:stop], inverse = _small_root(stop - start)(left[: stop - start, :])
        L[stop:, start:stop] = left[stop - start :, :] @ inverse.T
    return L


@cache
def _small_root(n: int) -> ca.Function:
    """Cholesky's factor and its inverse, element by element; 0 where there is no variance."""
    A = ca.SX.sym("A", n, n)
    L, inverse = ca.SX.zeros(n, n), ca.SX.zeros(n, n)
    for j in range(n):
        pivot = A[j, j] - ca.sumsqr(L[j, :])
        some = pivot > SMALLEST
        over = ca.if_else(some, 1 / ca.sqrt(ca.if_else(some, pivot, 1)), 0)
        L[j, j] = pivot * over
        inverse[j, j] = over
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - ca.dot(L[i, :], L[j, :])) * over
        for i in range(j):
            inverse[j, i] = -over * ca.dot(L[j, i:j], inverse[i:j, i].T)
    return ca.Function("small_root", [A], [L, inverse], {"cse": True})


def lazy_update(
    condition: Any, function: Callable[..., tuple[Any, ...]], *values: Any
) -> list[Any]:
    """`function(*values)` where a condition holds, else its first results as they came.

    It is skipped where the condition does not hold. The first values are the ones that it changes;
    results beyond the values are zero where it is skipped.

    Args:
        condition: scalar.
        function: of matrices, giving a tuple.
        values: what it is called with.
    """
    symbols = [ca.MX.sym(f"v{i}", value.sparsity()) for i, value in enumerate(map(ca.MX, values))]
    results = [ca.densify(result) for result in function(*symbols)]
    recorded = ca.Function("taken", symbols, results)
    kept: list[Any] = [
        symbols[i] if i < len(symbols) and symbols[i].shape == result.shape else None
        for i, result in enumerate(results)
    ]
    passed = ca.Function(
        "passed",
        symbols,
        [
            ca.MX(ca.DM.zeros(*result.shape)) if symbol is None else ca.densify(symbol)
            for symbol, result in zip(kept, results, strict=True)
        ],
    )
    switch = ca.Function.if_else("choose", recorded, passed)
    return list(switch.call([ca.MX(condition), *map(ca.MX, values)], False, True))


def correct_if(
    condition: Any, method: Filter, residual: Residual, x: Any, P: Any, u: Any, R: Any, *gate: Any
) -> list[Any]:
    """Take in a measurement where a condition holds; elsewhere its work is skipped.

    Args:
        condition: scalar.
        method: filter to correct by.
        residual: measured minus predicted, (m,).
        x: nominal state.
        P: covariance of the error.
        u: known numbers, the measurement among them.
        R: covariance of the measurement, (m, m).
        gate: nu for each degree of freedom, beyond which R is inflated; none without it.

    Returns:
        State, covariance, and nu, which is 0 where nothing is taken in.
    """

    def corrected(x: Any, P: Any, u: Any, R: Any, *gate: Any) -> tuple[Any, Any, Any]:
        found = method.correct(residual, x, u, P, R, *gate)
        return found.x, found.P, found.nis

    return lazy_update(condition, corrected, x, P, u, R, *gate)


def _moved(space: Space, x: Any, e: Any) -> Any:
    point, error = ca.SX.sym("x", space.size), ca.SX.sym("e", space.error_size)
    moved = space.scaled(space.moved(point, error))
    return ca.Function("moved", [point, error], [moved], {"cse": True})(x, e)


def _plus(P: Any, Q: Any) -> Any:
    """Sum, of which only what is not zero in Q is added."""
    total, Q = ca.MX(P), ca.MX(Q)
    places = Q.sparsity().find()
    total.nz[places] = total.nz[places] + Q.nz[:]
    return total


def _symmetric(P: Any) -> Any:
    return (P + P.T) / 2


def _solved(S: Any, gain: Any, r: Any) -> tuple[Any, Any]:
    """S^-1 gain, (m, n), and r^T S^-1 r, for a symmetric positive S."""
    found = ca.solve(S, ca.horzcat(gain, r), "ldl")
    return found[:, :-1], ca.dot(r, found[:, -1])


def _robust_inflation(nis: Any, r: Any, gate: Any) -> Any:
    """By how much S grows, so that r lies at the gate: 0 inside it."""
    return ca.fmax(nis / (r.shape[0] * gate) - 1, 0)
