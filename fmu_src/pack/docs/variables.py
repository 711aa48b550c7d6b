"""Variables of a model as rows of a table."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from fmu_src.kit.model import Model
from fmu_src.kit.places import namespace
from fmu_src.kit.records import Field, Record

_TYPED = "a notebook or an interpreter"


@dataclass(frozen=True)
class VariableRow:
    """A field as people read it: name, shape, unit, start values, limits, what it is."""

    name: str
    shape: str
    unit: str
    start: str
    limits: str
    sentence: str


def rows(record: type[Record], prefix: str = "") -> Iterator[VariableRow]:
    """Yield the fields of a record, nested ones under their dotted path."""
    for name, field in record.fields.items():
        if not isinstance(field, Field):
            yield from rows(field, f"{prefix}{name}.")
            continue
        low, high = (
            "" if math.isinf(value) else f"{value:.6g}" for value in (field.min, field.max)
        )
        yield VariableRow(
            name=prefix + name,
            shape=" x ".join(map(str, field.shape)),
            unit=(field.unit or "1") if field.kind == "Real" else field.kind,
            start=_start(field.start),
            limits=f"{low} .. {high}" if low or high else "",
            sentence=field.description + (" Tunable." if field.tunable else ""),
        )


def source(model: Model) -> str:
    """Return the path of the model's module in its project, or the name of a file by itself.

    A model that was typed into an interpreter or a notebook has no file.
    """
    module = namespace(model.step)
    if module.get("__package__"):
        return str(module["__name__"]).replace(".", "/") + ".py"
    return Path(module.get("__file__") or _TYPED).name


def _start(values: Iterable[float]) -> str:
    """Format start values, runs of equal ones once."""
    runs = [(value, len(list(same))) for value, same in groupby(values)]
    if len(runs) > 12:
        return "see source"
    return ", ".join(f"{value:.6g}" + (f" x {n}" if n > 1 else "") for value, n in runs)
