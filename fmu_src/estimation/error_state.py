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
| nu | normalised innovation squared r^T S^-1 r, chi-squared with m degrees of freedom |

Both filters have the same two steps, `predict` and `correct`, with the same arguments, so that a
model is written once and chooses. `process` and `residual` are functions of the nominal record and
a column of known numbers; they are recorded apart, on single elements, and called from the whole
matrices of the filter, which keeps the C code short.

The extended filter differentiates them by CasADi, at zero error: no Jacobian is written by hand.

The unscented one draws scaled sigma points (E13 3.31 to 3.33, weights with the errata)

    x, x + g L_i, x - g L_i      L L^T = P,  g^2 = n + lambda,  lambda = alpha^2 (n + kappa) - n

takes the mean of what the process makes of them by E13 3.47 to 3.50 - the errors about a mean, the
mean moved by their mean, again - and draws them anew about the predicted state for a measurement.
Cholesky's factor has a zero column where P has no variance: a parameter that is known stays known.

A residual that the filter does not believe, nu above a gate for each degree of freedom, counts with
a covariance so much larger that it lies at the gate: it pulls a little, whatever its size, and a
filter that has gone astray finds back. nu as given out is that before widening.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.kit import rotations
from fmu_src.kit.errors import SteadytipError
from fmu_src.kit.records import Field, Record

MEANS = 3
"""Rounds of the mean of rotations; errors of a radian are exact to rounding after three."""
NOTHING = 1e-40
"""Variance that is added to every one, for its root to have a derivative where it is zero."""
BLOCK = 8
"""Columns of Cholesky's factor that are found at once."""
SMALLEST = 1e-30
"""Pivot of Cholesky's factor, below which a direction has no variance."""

Process = Callable[[Any, Any], Record]
Residual = Callable[[Any, Any], Any]


class Space:
    """What a nominal state is made of, and how errors move it.

    Args:
        record: of the state; its fields are stacked in their order.
        rotations: names of the fields that are unit quaternions, (4,).
    """

    def __init__(self, record: type[Record], *rotations: str) -> None:
        self.record = record
        self.parts: list[tuple[slice, slice, bool]] = []
        self.places: dict[str, slice] = {}
        at = error_at = 0
        for name, field in record.fields.items():
            assert isinstance(field, Field), "nominal states are flat"
            turns = name in rotations
            size = 3 if turns else field.size
            whole, part = slice(at, at + field.size), slice(error_at, error_at + size)
            self.parts.append((whole, part, turns))
            self.places[name] = part
            at, error_at = whole.stop, part.stop
        self.size, self.error_size = at, error_at

    def moved(self, x: Any, e: Any) -> Any:
        """State x + e moved by an error, (N,); likewise of the first fields alone.

        Quaternions keep their length but for rounding, see `scaled`.
        """
        return ca.vertcat(
            *(
                rotations.multiply(x[whole], rotations.from_rotation_vector(e[part]))
                if turns
                else x[whole] + e[part]
                for whole, part, turns in self._first(x)
            )
        )

    def scaled(self, x: Any) -> Any:
        """State with its quaternions of unit length, (N,); likewise of the first fields alone."""
        return ca.vertcat(
            *(
                rotations.normalize(x[whole]) if turns else x[whole]
                for whole, _, turns in self._first(x)
            )
        )

    def _first(self, x: Any) -> list[tuple[slice, slice, bool]]:
        """Parts of a state that may have the first fields alone."""
        return [part for part in self.parts if part[0].start < x.shape[0]]

    def error(self, x: Any, y: Any) -> Any:
        """Error y - x from one state to another, (n,); likewise of the first fields alone."""
        return ca.vertcat(
            *(
                rotations.to_rotation_vector(
                    rotations.multiply(rotations.conjugate(x[whole]), y[whole])
                )
                if turns
                else y[whole] - x[whole]
                for whole, _, turns in self._first(x)
            )
        )

    def error_after(self, point: Any, after: Any, near: Any, moved: Any, e: Any) -> Any:
        """Error after a process, (n,), to the first order: for its Jacobian, short in C.

        Args:
            point: state before the process.
            after: state after it.
            near: point + e.
            moved: what the process makes of that.
            e: error before, (n,); still that of fields which the process leaves alone.
        """
        parts = []
        for whole, part, turns in self.parts:
            alone = ca.is_equal(after[whole], point[whole], 1)
            if alone and ca.is_equal(moved[whole], near[whole], 1):
                parts.append(e[part])
            elif turns:
                turned = rotations.multiply(rotations.conjugate(after[whole]), moved[whole])
                parts.append(2 * turned[1:])
            else:
                parts.append(moved[whole] - after[whole])
        return ca.vertcat(*parts)

    def diagonal(self, **values: Any) -> Any:
        """(n,) from a value, or one for each element, of some fields; zero for all others.

        Raises:
            SteadytipError: no field is called so.
        """
        pieces = []
        for name, place in self.places.items():
            value, size = values.pop(name, 0), place.stop - place.start
            column = isinstance(value, ca.SX | ca.MX | ca.DM) and value.numel() == size
            pieces.append(value if column else ca.repmat(value, size, 1))
        if values:
            raise SteadytipError(f"{self.record.__qualname__} has no field '{next(iter(values))}'")
        return ca.vertcat(*pieces)


class Corrected(NamedTuple):
    """What a measurement leaves: state, covariance, residual (m,), nu."""

    x: Any
    P: Any
    residual: Any
    squared: Any


class Extended:
    """By Jacobians at the nominal state."""

    def __init__(self, space: Space) -> None:
        self.space = space

    def predict(self, process: Process, x: Any, u: Any, P: Any, Q: Any) -> tuple[Any, Any]:
        """State and covariance after the process."""
        space = self.space
        point, known, e = _symbols(space, u)
        after = process(space.record.unpack(point), known).pack()
        near = space.moved(point, e)
        moved = process(space.record.unpack(near), known).pack()
        F = slope(space.error_after(point, after, near, moved, e), e)
        results = [space.scaled(after), F]
        function = ca.Function("transition", [point, known], results, {"cse": True})
        x, F = function(x, u)
        return x, _symmetric(F @ P @ F.T + Q)

    def correct(
        self, residual: Residual, x: Any, u: Any, P: Any, R: Any, gate: Any = np.inf
    ) -> Corrected:
        """Take in a measurement; the covariance in Joseph's form.

        Args:
            residual: measured minus predicted, (m,).
            x: nominal state.
            u: known numbers, the measurement among them.
            P: covariance of the error.
            R: covariance of the measurement, (m, m).
            gate: nu for each degree of freedom, beyond which R is widened.
        """
        space = self.space
        point, known, e = _symbols(space, u)
        r = residual(space.record.unpack(space.moved(point, e)), known)
        H = -slope(r, e)
        found = [ca.substitute(r, e, ca.DM.zeros(space.error_size)), H]
        function = ca.Function("measure", [point, known], found, {"cse": True})
        r, H = function(x, u)
        gain = H @ P
        S = gain @ H.T + R
        solved, squared = _solved(S, gain, r)
        extra = _widening(squared, r, gate)
        K = solved.T / (1 + extra)
        R = R + extra * S
        A = ca.DM.eye(space.error_size) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        return Corrected(_moved(space, x, K @ r), _symmetric(P), r, squared)


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
        spread = alpha**2 * (n + kappa)
        self.scale = float(np.sqrt(spread))
        mean = np.full(2 * n + 1, 0.5 / spread)
        mean[0] = 1 - n / spread
        covariance = mean.copy()
        covariance[0] += 1 - alpha**2 + beta
        self.mean, self.covariance = ca.DM(mean), ca.DM(covariance)

    def _errors(self, P: Any) -> Any:
        """Of the sigma points, (n, 2 n + 1)."""
        L = self.scale * root(P)
        return ca.horzcat(ca.DM.zeros(self.space.error_size), L, -L)

    def predict(self, process: Process, x: Any, u: Any, P: Any, Q: Any) -> tuple[Any, Any]:
        """State and covariance after the process.

        Points go through it for the part that it moves. Errors of the rest are only scaled, and so
        are their covariances, exactly; put that part of a state last.
        """
        space = self.space
        point, known, e = _symbols(space, u)
        whole, part, scales = _moved_part(space, process, point, known, e)
        after = process(space.record.unpack(space.moved(point, e)), known).pack()
        through = ca.Function("through", [point, known, e], [after[:whole]], {"cse": True})
        errors = self._errors(P)
        count = errors.shape[1]
        points = _each(through, count, [0, 1])(x, u, errors)

        # Mean of the part that moves; the others' is where the process takes the state itself.
        center, other = ca.SX.sym("center", whole), ca.SX.sym("other", whole)
        error = space.error(center, other)
        moved = space.scaled(space.moved(center, e[:part]))
        apart = ca.Function("apart", [center, other], [error], {"cse": True})
        apart = _each(apart, count, [0])
        to = ca.Function("to", [center, e[:part]], [moved], {"cse": True})
        mean = points[:, 0]
        for _ in range(MEANS):
            mean = to(mean, apart(mean, points) @ self.mean)
        weighted = apart(mean, points) * ca.repmat(self.covariance.T, part, 1)
        alone = process(space.record.unpack(point), known).pack()[whole:]
        rest = ca.Function("rest", [point, known], [alone, scales], {"cse": True})
        rest_after, scale = rest(x, u)

        spread = weighted @ apart(mean, points).T
        if part < space.error_size:
            across = weighted @ errors[part:, :].T * ca.repmat(scale.T, part, 1)
            left = P[part:, part:] * (scale @ scale.T)
            spread = ca.vertcat(ca.horzcat(spread, across), ca.horzcat(across.T, left))
        return ca.vertcat(mean, rest_after), _symmetric(spread + Q)

    def correct(
        self, residual: Residual, x: Any, u: Any, P: Any, R: Any, gate: Any = np.inf
    ) -> Corrected:
        """Take in a measurement; arguments as those of `Extended.correct`."""
        space = self.space
        point, known, e = _symbols(space, u)
        r = residual(space.record.unpack(space.moved(point, e)), known)
        function = ca.Function("measure", [point, known, e], [r], {"cse": True})
        errors = self._errors(P)
        residuals = _each(function, errors.shape[1], [0, 1])(x, u, errors)
        r = residuals @ self.mean
        apart = ca.repmat(r, 1, errors.shape[1]) - residuals  # predicted minus their mean
        weighted = apart * ca.repmat(self.covariance.T, apart.shape[0], 1)
        S = weighted @ apart.T + R
        gain = weighted @ errors.T
        solved, squared = _solved(S, gain, r)
        wider = 1 + _widening(squared, r, gate)
        S, K = wider * S, solved.T / wider
        return Corrected(_moved(space, x, K @ r), _symmetric(P - K @ S @ K.T), r, squared)


Filter = Extended | Unscented


def deviation(variance: Any) -> Any:
    """Standard deviation, with a derivative everywhere."""
    return ca.sqrt(ca.fmax(variance, 0) + NOTHING)


def root(P: Any) -> Any:
    """Lower triangular L with L L^T = P, (n, n): Cholesky's, by blocks.

    A direction without variance gives a column of zeros, so P may be singular.
    """
    n, left, columns = P.shape[0], P, []
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        L, inverse = _small_root(size)(left[:size, :size])
        below = left[size:, :size] @ inverse.T
        columns.append(ca.vertcat(ca.DM.zeros(start, size), L, below))
        left = left[size:, size:] - below @ below.T
    return ca.horzcat(*columns)


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


def chosen(condition: Any, function: Callable[..., tuple[Any, ...]], *values: Any) -> list[Any]:
    """`function(*values)` where a condition holds, else its first results as they came.

    It is skipped where the condition does not hold. The first values are the ones that it changes;
    results beyond the values are zero where it is skipped.

    Args:
        condition: scalar.
        function: of matrices, giving a tuple.
        values: what it is called with.
    """
    symbols = [ca.MX.sym(f"v{i}", *value.shape) for i, value in enumerate(map(ca.MX, values))]
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
            ca.MX(ca.DM.zeros(*result.shape)) if symbol is None else symbol
            for symbol, result in zip(kept, results, strict=True)
        ],
    )
    switch = ca.Function.if_else("choose", recorded, passed)
    return list(switch.call([ca.MX(condition), *map(ca.MX, values)], False, True))


def _symbols(space: Space, u: Any) -> tuple[Any, Any, Any]:
    return (
        ca.SX.sym("x", space.size),
        ca.SX.sym("u", *u.shape),
        ca.SX.sym("e", space.error_size),
    )


def _moved_part(
    space: Space, process: Process, point: Any, known: Any, e: Any
) -> tuple[int, int, Any]:
    """What of a state the process moves by more than a factor: its first fields.

    Returns:
        Size of that part in the state and in the error, and the factors of the other errors.
    """
    x = space.record.unpack(space.moved(point, e))
    after = process(x, known)
    whole = part = 0
    factors: list[Any] = []
    for (name, place), (full, _, turns) in zip(space.places.items(), space.parts, strict=True):
        size = place.stop - place.start
        before, now = getattr(x, name), getattr(after, name)
        if now is before:
            factors.append(ca.DM.ones(size))
            continue
        J = ca.jacobian(ca.vec(now), e)
        own = ca.diag(J[:, place.start : place.stop]) if not turns else None
        if own is None or J.nnz() > own.nnz() or ca.depends_on(own, e):
            whole, part, factors = full.stop, place.stop, []
        else:
            factors.append(own)
    return whole, part, ca.vertcat(*factors)


def slope(expression: Any, e: Any) -> Any:
    """Jacobian of an expression by an error e, at zero error."""
    return ca.simplify(ca.substitute(ca.jacobian(expression, e), e, ca.DM.zeros(*e.shape)))


def _each(function: ca.Function, count: int, held: list[int]) -> ca.Function:
    """The function over `count` columns of its arguments but those that are held."""
    return function.map(f"each_{function.name()}", "serial", count, held, [])


def _moved(space: Space, x: Any, e: Any) -> Any:
    point, error = ca.SX.sym("x", space.size), ca.SX.sym("e", space.error_size)
    moved = space.scaled(space.moved(point, error))
    return ca.Function("moved", [point, error], [moved], {"cse": True})(x, e)


def _symmetric(P: Any) -> Any:
    return (P + P.T) / 2


def _solved(S: Any, gain: Any, r: Any) -> tuple[Any, Any]:
    """S^-1 gain, (m, n), and r^T S^-1 r, for a symmetric positive S."""
    found = ca.solve(S, ca.horzcat(gain, r), "ldl")
    return found[:, :-1], ca.dot(r, found[:, -1])


def _widening(squared: Any, r: Any, gate: Any) -> Any:
    """By how much S grows, so that r lies at the gate: 0 inside it."""
    return ca.fmax(squared / (r.shape[0] * gate) - 1, 0)
