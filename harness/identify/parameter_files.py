"""Files of identification: parameter sets (`.ssv`) of what was found, tables to find it in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError, range_text
from fmu_src.kit.records import Scalar
from fmu_src.kit.units import BASE, OFFSETS, base_exponents
from harness.common.errors import ProblemsError
from harness.common.files import reason, replacing
from harness.common.types import FloatArray
from harness.parts.ports import Unit
from harness.parts.ssv import SsvValue, write_ssv

__all__ = ["write_scalars", "write_table"]


def write_scalars(path: Path, found: Iterable[tuple[Scalar, float]], refusal: str) -> Path:
    """Write values of parameters as a set that any run accepts, all at once or not at all.

    Args:
        path: file to write.
        found: parameters under the names that the model has for them, and their values in SI.
        refusal: why values can be out of range, and a cure.

    Raises:
        ProblemsError: values that the model would refuse.
        SteadytipError: the file cannot be written.
    """
    values: dict[str, SsvValue] = {}
    problems: list[str] = []
    for scalar, value in found:
        field = scalar.field
        if not field.min <= value <= field.max:
            problems.append(
                f"{scalar.name} = {value:.6g} {field.unit or ''} must be "
                f"{range_text(field.min, field.max)}"
            )
        typed = int(value) if field.kind == "Integer" and value == value else float(value)
        values[scalar.name] = SsvValue(typed, field.unit, _unit(field.unit))
    if problems:
        raise ProblemsError(f"{path} is not written, {refusal}", problems)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            part.write_bytes(write_ssv(path.stem, values))
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
    return path


def write_table(
    path: Path, headings: Sequence[str], table: FloatArray, formats: Sequence[str]
) -> Path:
    """Write a recording as CSV, or as Parquet where the file's ending says so.

    Args:
        path: file to write.
        headings: one for each column, as in `volts [V]`.
        table: (rows, columns).
        formats: of the columns in CSV, as in `%.5f`.

    Raises:
        SteadytipError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            if path.suffix == ".parquet":
                import pyarrow as pa
                from pyarrow import parquet

                columns = {name: table[:, i] for i, name in enumerate(headings)}
                parquet.write_table(pa.table(columns), part)
            else:
                np.savetxt(part, table, list(formats), ",", header=",".join(headings), comments="")
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
    return path


def _unit(name: str | None) -> Unit | None:
    exponents = base_exponents(name) if name else None
    if name is None or exponents is None:
        return None
    powers = tuple(exponents.get(base, 0) for base in BASE)
    return Unit(name, powers, offset=OFFSETS.get(name, 0.0))
