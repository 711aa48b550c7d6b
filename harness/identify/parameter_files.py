"""Parameter files (`.ssv`) of identified values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from fmu_src.errors import range_text
from fmu_src.kit.records import Scalar
from harness.common.errors import ProblemsError
from harness.common.files import write_text
from harness.parts.ports import unit_of
from harness.parts.ssv import SsvValue, write_ssv

__all__ = ["write_parameters"]


def write_parameters(
    path: Path, scalars: Iterable[Scalar], found: Mapping[str, float], refusal: str
) -> Path:
    """Write values of parameters to a file that any run accepts, all at once or not at all.

    Args:
        path: file to write.
        scalars: parameters of the model; those that were not found are left out.
        found: values in SI, by name of the parameter.
        refusal: clause that tells why values can be out of range, and a cure.

    Raises:
        ProblemsError: the model would refuse values.
        SteadytipError: the file cannot be written.
    """
    values: dict[str, SsvValue] = {}
    problems: list[str] = []
    for scalar in scalars:
        if scalar.name not in found:
            continue
        field, value = scalar.field, found[scalar.name]
        if not field.min <= value <= field.max:
            problems.append(
                f"{scalar.name} = {value:.6g} {field.unit or ''} must be "
                f"{range_text(field.min, field.max)}"
            )
        typed = int(value) if field.kind == "Integer" and value == value else float(value)
        unit = unit_of(field.unit) if field.unit else None
        values[scalar.name] = SsvValue(typed, field.unit, unit)
    if problems:
        raise ProblemsError(f"{path} is not written, {refusal}", problems)
    return write_text(path, write_ssv(path.stem, values).decode())
