"""Parameter files of identified operators."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.kit import Parameters
from fmu_src.kit.records import Field, Scalar
from fmu_src.pack.discovery import load_model, model_names
from harness.identify.hysteresis.operators import OperatorFit
from harness.identify.parameter_files import write_parameters

__all__ = ["find_prefixes", "write_operators"]


def find_prefixes(model: str, record: type[Parameters]) -> list[str]:
    """Return the prefixes under which a model takes a record: `""`, or `stack_1.`, `stack_2.`, ...

    Raises:
        SteadytipError: no such model, or it takes no such record; the message names those that do.
    """
    found = list(_prefixes(load_model(model).parameters, record))
    if not found:
        others = [
            name
            for name in model_names()
            if any(True for _ in _prefixes(load_model(name).parameters, record))
        ]
        raise SteadytipError(
            f"--model {model}: takes no parameters of this operator; those that do are "
            f"{', '.join(others)}"
        )
    return found


def _prefixes(parameters: type, record: type[Parameters], prefix: str = "") -> Iterator[str]:
    if issubclass(parameters, record):
        yield prefix
        return
    for name, field in parameters.fields.items():  # type: ignore[attr-defined]
        if not isinstance(field, Field):
            yield from _prefixes(field, record, f"{prefix}{name}.")


def write_operators(path: Path, record: type[Parameters], fits: Mapping[str, OperatorFit]) -> Path:
    """Write a parameter file of one or several operators.

    Args:
        path: file to write.
        record: record class of the operator's parameters.
        fits: fits by the prefix under which the model takes them.

    Raises:
        ProblemsError: the model would refuse values.
        SteadytipError: the file cannot be written.
    """
    scalars: list[Scalar] = []
    values: list[float] = []
    for prefix, fit in fits.items():
        scalars += record.scalars(prefix)
        for name in record.fields:
            values += np.ravel(fit.parameters[name], order="F").astype(float).tolist()
    return write_parameters(
        path,
        scalars,
        dict(zip((scalar.name for scalar in scalars), values, strict=True)),
        "the recording does not suit the operator (is its voltage that ahead of an amplifier? give "
        "--gain; --operator modulated-stops takes any range)",
    )
