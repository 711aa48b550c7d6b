"""The model kit: records with units and ranges, models, and a runner to try them in Python.

See "A model is one file" in the README.
"""

from fmu_src.errors import SteadytipError, range_text
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, Record, boolean, condition, integer, real
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
