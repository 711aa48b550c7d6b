"""The only shared ground of all models: records, units, rotations, noise, design. No I/O."""

from fmu_src.errors import SteadytipError, range_text
from fmu_src.kit.model import Model
from fmu_src.kit.records import (
    Derived,
    Inputs,
    Outputs,
    Parameters,
    Record,
    State,
    boolean,
    condition,
    integer,
    real,
)
from fmu_src.kit.runner import Runner

__all__ = [
    "Derived",
    "Inputs",
    "Model",
    "Outputs",
    "Parameters",
    "Record",
    "Runner",
    "State",
    "SteadytipError",
    "boolean",
    "condition",
    "integer",
    "range_text",
    "real",
]
