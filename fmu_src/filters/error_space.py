"""States that may hold rotations, and functions of their error.

| symbol | meaning |
| --- | --- |
| x | nominal state, a record whose fields are vectors and unit quaternions, stacked (N,) |
| e | its error, (n,): a quaternion's is a rotation vector in the body [rad], q (x) exp(e / 2) |
| x + e, y - x | the state moved by an error; the error that moves x to y |
"""

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import casadi as ca

from fmu_src.errors import SteadytipError
from fmu_src.kit.records import Field, Record, real
from fmu_src.math import rotations

Process = Callable[[Any, Any], Record]
Residual = Callable[[Any, Any], Any]


class ErrorPart(NamedTuple):
    """Place of a field in the state and in its error; `turns` for a rotation."""

    whole: slice
    error: slice
    turns: bool


class Space:
    """Fields of a nominal state, and errors that move it.

    Args:
        record: of the state; its fields are stacked in their order.
        rotations: names of the fields that are unit quaternions, (4,).
        fields: only these of the record's, in its order; all by default.
    """

    def __init__(
        self, record: type[Record], *rotations: str, fields: Collection[str] | None = None
    ) -> None:
        self.record, self._rotations = record, rotations
        self.parts: dict[str, ErrorPart] = {}
        at = error_at = 0
        for name, field in record.fields.items():
            assert isinstance(field, Field), "nominal states are flat"
            if fields is not None and name not in fields:
                continue
            turns = name in rotations
            end, error_end = at + field.size, error_at + (3 if turns else field.size)
            self.parts[name] = ErrorPart(slice(at, end), slice(error_at, error_end), turns)
            at, error_at = end, error_end
        self.size, self.error_size = at, error_at

    @property
    def places(self) -> dict[str, slice]:
        """Place of each field's error."""
        return {name: part.error for name, part in self.parts.items()}

    def covariance(self) -> Any:
        """Declare the covariance of the error, for the record of a model's state."""
        shape = (self.error_size, self.error_size)
        return real(None, "covariance of the error", shape=shape, listed=False)

    def only(self, fields: Collection[str]) -> "Space":
        """Space of some of the fields."""
        return Space(self.record, *self._rotations, fields=fields)

    def errors(self, fields: Collection[str]) -> list[int]:
        """Return the places of some fields' errors in that of the state."""
        places = (part.error for name, part in self.parts.items() if name in fields)
        return [i for place in places for i in range(place.start, place.stop)]

    def stacked(self, x: Record) -> Any:
        """Stack the fields of this space from a whole record, (N,)."""
        return ca.vertcat(*(ca.vec(getattr(x, name)) for name in self.parts))

    def moved(self, x: Any, e: Any) -> Any:
        """State x + e moved by an error, (N,).

        Quaternions keep their length but for rounding, see `scaled`.
        """
        return ca.vertcat(
            *(
                rotations.multiply(x[whole], rotations.from_rotation_vector(e[error]))
                if turns
                else x[whole] + e[error]
                for whole, error, turns in self.parts.values()
            )
        )

    def scaled(self, x: Any) -> Any:
        """State with its quaternions of unit length, (N,)."""
        return ca.vertcat(
            *(
                rotations.normalize(x[whole]) if turns else x[whole]
                for whole, _, turns in self.parts.values()
            )
        )

    def error(self, x: Any, y: Any) -> Any:
        """Error y - x from one state to another, (n,)."""
        return ca.vertcat(
            *(
                rotations.to_rotation_vector(
                    rotations.multiply(rotations.conjugate(x[whole]), y[whole])
                )
                if turns
                else y[whole] - x[whole]
                for whole, _, turns in self.parts.values()
            )
        )

    def nearly(self, x: Any, y: Any) -> Any:
        """Error y - x of states that are near, (n,): for Jacobians, short in C."""
        return ca.vertcat(
            *(
                2 * rotations.multiply(rotations.conjugate(x[whole]), y[whole])[1:]
                if turns
                else y[whole] - x[whole]
                for whole, _, turns in self.parts.values()
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


class ProcessEffect:
    """Effect of a process on each field: it moves it, scales its error, or leaves it alone.

    Attributes:
        symbols: x (N,) and u, what `alone` is made of.
        e: symbol of the error of x, (n,).
        alone: record after the process, without error.
        small: space of the fields that are moved.
    """

    def __init__(self, space: Space, process: Process, u: Any) -> None:
        """Look at the process.

        Args:
            space: of the state.
            process: of it.
            u: what is known, for its shape.
        """
        self._space, self._process = space, process
        point, self._known, self.e = variables(space, u)
        self.symbols = [point, self._known]
        self.alone = process(space.record.unpack(point), self._known)
        moved, self._scaled, self._factors = self._effects()
        self.small = space.only(moved)

    def _at(self, e: Any) -> Record:
        return self._space.record.unpack(self._space.moved(self.symbols[0], e))

    def _effects(self) -> tuple[list[str], list[int], list[Any]]:
        """Fields that are moved; which errors of others are scaled, and by what."""
        x = self._at(self.e)
        after = self._process(x, self._known)
        moved: list[str] = []
        scaled: list[int] = []
        factors: list[Any] = []
        for name, (_, error, turns) in self._space.parts.items():
            before, now = getattr(x, name), getattr(after, name)
            if now is before:
                continue
            J = ca.jacobian(ca.vec(now), self.e)
            own = ca.diag(J[:, error]) if not turns else None
            if own is None or J.nnz() > own.nnz() or ca.depends_on(own, self.e):
                moved.append(name)
            else:
                scaled += range(error.start, error.stop)
                factors.append(own)
        return moved, scaled, factors

    def after(self, e: Any) -> Any:
        """Return the fields that are moved, after the process of a state with an error."""
        return self.small.stacked(self._process(self._at(e), self._known))

    def together(self, x: Any, u: Any, moved: Any, P: Any, across: Any, own: Any) -> Any:
        """State and covariance after the process.

        Args:
            x: state before.
            u: what is known.
            moved: the fields that are moved.
            P: covariance before.
            across: between the errors before and those of these fields after it, (n, m).
            own: covariance of the latter.
        """
        results = [self.alone.pack(), ca.densify(ca.vertcat(*self._factors))]
        rest, factors = ca.Function("rest", self.symbols, results, {"cse": True})(x, u)
        after = (
            moved[self.small.parts[name].whole] if name in self.small.parts else rest[part.whole]
            for name, part in self._space.parts.items()
        )
        # Copies: what is assigned to changes.
        P, across, scaled, n = ca.MX(P), ca.MX(across), self._scaled, self._space.error_size
        if scaled:
            P[:, scaled] = P[:, scaled] * ca.repmat(factors.T, n, 1)
            P[scaled, :] = P[scaled, :] * ca.repmat(factors, 1, n)
            across[scaled, :] = across[scaled, :] * ca.repmat(factors, 1, across.shape[1])
        places = self._space.errors(self.small.parts)
        P[:, places], P[places, :], P[places, places] = across, across.T, own
        return ca.vertcat(*after), P


def jacobian_at_zero(expression: Any, e: Any) -> Any:
    """Jacobian of an expression by an error e, at zero error."""
    return at_zero(ca.jacobian(expression, e), e)


def at_zero(expression: Any, e: Any) -> Any:
    """Evaluate an expression where the error e is zero."""
    return ca.simplify(ca.substitute(expression, e, ca.DM.zeros(*e.shape)))


def nonlinear_errors(J: Any, e: Any) -> tuple[list[int], list[int]]:
    """Find the errors that bend a function of the Jacobian J, and the others it depends on.

    While the first ones are zero, the function is straight in the second. It may have kinks, but no
    steps: a Jacobian does not tell of those.
    """
    acting = sorted(set(J.sparsity().get_triplet()[1]))
    pairs = set()
    for column in acting:
        by = ca.jacobian_sparsity(ca.vcat(J[:, column].nonzeros()), e).get_triplet()[1]
        pairs |= {(min(column, i), max(column, i)) for i in by}
    bent = {i for i, j in pairs if i == j}
    bent |= {i for i, j in pairs if not {i, j} & bent}
    return sorted(bent), [i for i in acting if i not in bent]


def variables(space: Space, u: Any) -> tuple[Any, Any, Any]:
    """Symbols of x (N,), of what is known and of e (n,)."""
    return (
        ca.SX.sym("x", space.size),
        ca.SX.sym("u", *u.shape),
        ca.SX.sym("e", space.error_size),
    )
