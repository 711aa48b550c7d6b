"""Records: the variables of a model, each declared once with unit, range, start and a sentence.

A record class lists fields; an instance holds their values (CasADi expressions while a step is
being recorded, NumPy arrays elsewhere). Everything that needs to know a variable reads it from
here: the model description, the limits in C, error texts, documentation.

| class | FMI causality | name of element i of field `w` |
| --- | --- | --- |
| Parameters | parameter | `w[i]`, nested records `group.w[i]` |
| Derived | calculatedParameter | as Parameters |
| Inputs, Outputs | input, output | `w_1`, or `w_x` with axes="xyz"; tools make buses of dots |
| State | local | as Parameters, under `state.` |
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import casadi as ca
import numpy as np

from fmu_src.errors import SteadytipError, range_text
from fmu_src.kit.units import base_exponents

Kind = Literal["Real", "Integer", "Boolean"]


@dataclass(frozen=True)
class Field:
    """One declared variable, scalar or array. `start` has one value for each element."""

    kind: Kind
    unit: str | None
    description: str
    start: tuple[float, ...]
    min: float
    max: float
    shape: tuple[int, ...]
    axes: tuple[str, ...] | None
    tunable: bool = False
    listed: bool = True
    """False for memory by the hundred, which descriptions leave out."""
    warning: str = ""
    """Message where a condition is false; empty for all other variables."""

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Scalar:
    """One element of a field under the name by which the world knows it."""

    name: str
    field: Field
    start: float


def real(
    unit: str | None,
    description: str,
    *,
    start: float | Sequence[Any] | np.ndarray = 0.0,
    min: float = -math.inf,
    max: float = math.inf,
    within: float | None = None,
    shape: int | tuple[int, ...] = (),
    axes: str | Sequence[str] | None = None,
    tunable: bool = False,
    listed: bool = True,
) -> Any:
    """Declare a real variable.

    Args:
        unit: SI unit as in `m/s2`; None for a number without dimension.
        description: one sentence, with the symbol of the paper where there is one.
        start: one value for all elements, or one for each, in the order of the shape.
        min: smallest value allowed, for every element.
        max: largest value allowed.
        within: largest size of either sign, in place of `min` and `max`.
        shape: () for a scalar, n for a column, (rows, columns) for a matrix.
        axes: suffixes of a column's elements on a port; `1..n` without it.
        tunable: may be set between steps; other parameters are fixed after initialisation.
        listed: for a state, whether the FMU's description names it.
    """
    if unit is not None:
        base_exponents(unit)
    if within is not None:
        min, max = -within, within
    flags = {"tunable": tunable, "listed": listed}
    return _field("Real", unit, description, start, min, max, shape, axes, **flags)


def vector(unit: str | None, description: str, **options: Any) -> Any:
    """Declare a real vector along x, y and z; options as those of `real`."""
    return real(unit, description, shape=3, axes="xyz", **options)


def quaternion(description: str, **options: Any) -> Any:
    """Declare a unit quaternion, w first, starting as no rotation; options as those of `real`."""
    return real(None, description, start=(1, 0, 0, 0), shape=4, axes="wxyz", **options)


def integer(description: str, *, start: int = 0, min: int, max: int, tunable: bool = False) -> Any:
    """Declare an integer variable, as for a choice or a seed."""
    return _field("Integer", None, description, start, min, max, tunable=tunable)


def boolean(description: str, *, start: bool = False, tunable: bool = False) -> Any:
    """Declare a yes or no; 1.0 and 0.0 inside a step."""
    return _field("Boolean", None, description, float(start), 0, 1, tunable=tunable)


def condition(description: str, warning: str) -> Any:
    """Declare a yes or no about the parameters that should be yes; for `Derived` records.

    An FMU whose parameters make it false says so when it is initialised, and goes on.

    Args:
        description: one sentence.
        warning: what is wrong when it is false, and the cure.
    """
    return _field("Boolean", None, description, 1.0, 0, 1, warning=warning)


def _field(
    kind: Kind,
    unit: str | None,
    description: str,
    start: Any,
    low: float,
    high: float,
    shape: int | tuple[int, ...] = (),
    axes: str | Sequence[str] | None = None,
    **more: Any,
) -> Field:
    shape = (shape,) if isinstance(shape, int) else tuple(shape)
    names = None if axes is None else tuple(axes)
    starts = np.broadcast_to(np.asarray(start, dtype=float), shape).flatten(order="F").tolist()
    for value in starts:
        if not low <= value <= high:
            raise SteadytipError(
                f"'{description}': start {value:.9g} must be {range_text(low, high)}"
            )
    if names is not None and shape != (len(names),):
        raise SteadytipError(f"'{description}': {len(names)} axes for the shape {shape}")
    bounds = float(low), float(high)
    return Field(kind, unit, description, tuple(starts), *bounds, shape, names, **more)


class Record:
    """Base of all records; subclasses list their fields as class attributes, in port order.

    A field may itself be a record class: its variables appear under the field's name.
    """

    fields: ClassVar[dict[str, "Field | type[Record]"]] = {}
    flat: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        own = {
            name: value
            for name, value in vars(cls).items()
            if isinstance(value, Field) or (isinstance(value, type) and issubclass(value, Record))
        }
        cls.fields = {**cls.fields, **own}

    def __init__(self, **values: Any) -> None:
        wrong = set(values) ^ set(self.fields)
        if wrong:
            raise SteadytipError(
                f"{type(self).__qualname__} has the fields {', '.join(self.fields)};"
                f" missing or unknown: {', '.join(sorted(wrong))}"
            )
        for name, value in values.items():
            setattr(self, name, value)
        self._whole: Any = None  # the vector that it was cut from

    def replace(self, **values: Any) -> Self:
        """Return a copy with some fields changed."""
        return type(self)(**{**{name: getattr(self, name) for name in self.fields}, **values})

    @classmethod
    def starting(cls, **starts: Any) -> type[Self]:
        """Return a record with other start values, for use as a nested record."""
        changed = {}
        for name, value in starts.items():
            field = cls.fields.get(name)
            if not isinstance(field, Field):
                raise SteadytipError(f"{cls.__qualname__} has no field '{name}' to start elsewhere")
            flat = np.broadcast_to(np.asarray(value, dtype=float), field.shape).flatten(order="F")
            changed[name] = dataclasses.replace(field, start=tuple(float(v) for v in flat))
        return type(cls.__name__, (cls,), changed)

    @classmethod
    def scalars(cls, prefix: str = "") -> Iterator[Scalar]:
        """Yield every element of every field, in the order in which `pack` stacks them."""
        for name, field in cls.fields.items():
            if isinstance(field, Field):
                for index, start in enumerate(field.start):
                    yield Scalar(prefix + name + _suffix(field, index, cls.flat), field, start)
            else:
                yield from field.scalars(f"{prefix}{name}_" if cls.flat else f"{prefix}{name}.")

    @classmethod
    def size(cls) -> int:
        """Return the number of scalars in the record."""
        return sum(f.size if isinstance(f, Field) else f.size() for f in cls.fields.values())

    @classmethod
    def starts(cls) -> np.ndarray:
        """Start values of all scalars, shape (size,)."""
        return np.array([scalar.start for scalar in cls.scalars()])

    @classmethod
    def unpack(cls, vector: Any) -> Self:
        """Cut a stacked vector of `size` elements into a record; the inverse of `pack`."""
        values: dict[str, Any] = {}
        at = 0
        for name, field in cls.fields.items():
            if isinstance(field, Field):
                piece = vector[at : at + field.size]
                values[name] = _shaped(piece, field.shape)
                at += field.size
            else:
                values[name] = field.unpack(vector[at : at + field.size()])
                at += field.size()
        record = cls(**values)
        record._whole = vector if isinstance(vector, ca.MX) else None
        return record

    def pack(self) -> Any:
        """Stack all fields into one column, matrices by columns: SX, or MX where a field is.

        Raises:
            SteadytipError: a value does not have its field's shape.
        """
        if self._whole is not None:
            return self._whole  # not put together again, which would be copied in C
        pieces = []
        for name, field in self.fields.items():
            value = getattr(self, name)
            if not isinstance(field, Field):
                pieces.append(value.pack())
                continue
            value = value if isinstance(value, ca.MX) else ca.SX(value)
            rows, columns = (*field.shape, 1, 1)[:2]
            if value.shape != (rows, columns):
                raise SteadytipError(
                    f"{type(self).__qualname__}.{name}: got the shape {value.shape},"
                    f" declared is ({rows}, {columns})"
                )
            pieces.append(ca.vec(value))
        if any(isinstance(piece, ca.MX) for piece in pieces):
            # The others are numbers then.
            pieces = [p if isinstance(p, ca.MX) else ca.evalf(p) for p in pieces]
        return ca.densify(ca.vertcat(*pieces)) if pieces else ca.SX(0, 1)


def _suffix(field: Field, index: int, flat: bool) -> str:
    if not field.shape:
        return ""
    if field.axes is not None and flat:
        return "_" + field.axes[index]
    place = [str(i + 1) for i in np.unravel_index(index, field.shape, order="F")]
    return "_" + "_".join(place) if flat else f"[{','.join(place)}]"


def _shaped(piece: Any, shape: tuple[int, ...]) -> Any:
    if not shape:
        return piece[0]
    if isinstance(piece, np.ndarray):
        return piece.reshape(shape, order="F")
    return piece if len(shape) == 1 else ca.reshape(piece, *shape)


class Parameters(Record):
    """Settable before a run, the tunable ones between steps."""


class Derived(Record):
    """Computed from the parameters alone, whenever they change."""


class Inputs(Record):
    """Read at every sample instant, held in between."""

    flat = True


class State(Record):
    """Memory of a model, carried from one sample to the next."""


class Outputs(Record):
    """The result of one sample."""

    flat = True
