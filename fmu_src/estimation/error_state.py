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
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.kit import rotations
from fmu_src.kit.errors import SteadytipError
from fmu_src.kit.records import Field, Record

MEANS = 3
"""Rounds of the mean of rotations; errors of a radian are exact to rounding after three."""
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
        self._parts: list[tuple[slice, slice, bool]] = []
        self.places: dict[str, slice] = {}
        at = error_at = 0
        for name, field in record.fields.items():
            assert isinstance(field, Field), "nominal states are flat"
            turns = name in rotations
            size = 3 if turns else field.size
            whole, part = slice(at, at + field.size), slice(error_at, error_at + size)
            self._parts.append((whole, part, turns))
            self.places[name] = part
            at, error_at = whole.stop, part.stop
        self.size, self.error_size = at, error_at

    def moved(self, x: Any, e: Any) -> Any:
        """x + e, (N,)."""
        parts = []
        for whole, part, turns in self._parts:
            if turns:
                turned = rotations.multiply(x[whole], rotations.from_rotation_vector(e[part]))
                parts.append(rotations.normalize(turned))
            else:
                parts.append(x[whole] + e[part])
        return ca.vertcat(*parts)

    def error(self, x: Any, y: Any) -> Any:
        """y - x, (n,)."""
        return ca.vertcat(
            *(
                rotations.to_rotation_vector(
                    rotations.multiply(rotations.conjugate(x[whole]), y[whole])
                )
                if turns
                else y[whole] - x[whole]
                for whole, _, turns in self._parts
            )
        )

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
        moved = process(space.record.unpack(space.moved(point, e)), known).pack()
        F = _slope(space.error(after, moved), e)
        function = ca.Function("transition", [point, known], [after, F], {"cse": True})
        x, slope = function(x, u)
        return x, _symmetric(slope @ P @ slope.T + Q)

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
        H = -_slope(r, e)
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
        """State and covariance after the process."""
        space = self.space
        point, known, e = _symbols(space, u)
        after = process(space.record.unpack(space.moved(point, e)), known).pack()
        through = ca.Function("through", [point, known, e], [after], {"cse": True})
        errors = self._errors(P)
        points = _each(through, errors.shape[1], [0, 1])(x, u, errors)

        other = ca.SX.sym("other", space.size)
        apart = ca.Function("apart", [point, other], [space.error(point, other)], {"cse": True})
        apart = _each(apart, errors.shape[1], [0])
        mean = points[:, 0]
        for _ in range(MEANS):
            mean = _moved(space, mean, apart(mean, points) @ self.mean)
        deviations = apart(mean, points)
        weighted = deviations * ca.repmat(self.covariance.T, space.error_size, 1)
        return mean, _symmetric(weighted @ deviations.T + Q)

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


def root(P: Any) -> Any:
    """Lower triangular L with L L^T = P, (n, n), by Cholesky's columns.

    A direction without variance gives a column of zeros, so P may be singular.
    """
    n = P.shape[0]
    left, columns = P, []
    for j in range(n):
        pivot = left[0, 0]
        inverse = ca.if_else(pivot > SMALLEST, 1 / ca.sqrt(ca.fmax(pivot, SMALLEST)), 0)
        column = left[:, 0] * inverse
        columns.append(ca.vertcat(ca.DM.zeros(j), column) if j else column)
        if j < n - 1:
            left = left[1:, 1:] - column[1:] @ column[1:].T
    return ca.horzcat(*columns)


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


def _slope(expression: Any, e: Any) -> Any:
    return ca.simplify(ca.substitute(ca.jacobian(expression, e), e, ca.DM.zeros(*e.shape)))


def _each(function: ca.Function, count: int, held: list[int]) -> ca.Function:
    """The function over `count` columns of its arguments but those that are held."""
    return function.map(f"each_{function.name()}", "serial", count, held, [])


def _moved(space: Space, x: Any, e: Any) -> Any:
    point, error = ca.SX.sym("x", space.size), ca.SX.sym("e", space.error_size)
    return ca.Function("moved", [point, error], [space.moved(point, error)], {"cse": True})(x, e)


def _symmetric(P: Any) -> Any:
    return (P + P.T) / 2


def _solved(S: Any, gain: Any, r: Any) -> tuple[Any, Any]:
    """S^-1 gain, (m, n), and r^T S^-1 r, for a symmetric positive S."""
    found = ca.solve(S, ca.horzcat(gain, r), "ldl")
    return found[:, :-1], ca.dot(r, found[:, -1])


def _widening(squared: Any, r: Any, gate: Any) -> Any:
    """By how much S grows, so that r lies at the gate: 0 inside it."""
    return ca.fmax(squared / (r.shape[0] * gate) - 1, 0)
