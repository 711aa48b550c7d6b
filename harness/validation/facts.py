"""What the description says, resolved by the rules of the standard and in plain Python types.

The checks of the XML and, as JSON, the processes of the probes work from it.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from harness.validation.checks import Skip
from harness.validation.files import Fmu

__all__ = ["TRUE", "Model", "Scalar"]

TRUE = {"true", "1"}
_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
_DEFAULT_STEP = 1e-3
"""Communication step of an FMU that names none [s]."""
_INITIAL = {
    "parameter": "exact",
    "calculatedParameter": "calculated",
    "output": "calculated",
    "local": "calculated",
}
"""Default of `initial` by causality (FMI 2.0.5, 2.2.7), constants apart."""


@dataclass(frozen=True)
class Scalar:
    """One ScalarVariable.

    Attributes:
        element: of the XML.
        typed: its element Real, Integer, ...
        declared: the element of its declared type; None without one.
        index: counted from 1.
    """

    element: Any
    typed: Any
    declared: Any
    index: int

    @property
    def name(self) -> str:
        """As written."""
        return str(self.element.get("name"))

    @property
    def type(self) -> str:
        """Tag of the typed element."""
        return str(self.typed.tag)

    @property
    def causality(self) -> str:
        """With the standard's default."""
        return str(self.element.get("causality", "local"))

    @property
    def variability(self) -> str:
        """With the standard's default."""
        return str(self.element.get("variability", "continuous"))

    @property
    def initial(self) -> str | None:
        """With the standard's default; None for inputs and the independent variable."""
        if self.causality in {"input", "independent"}:
            return None
        default = "exact" if self.variability == "constant" else _INITIAL.get(self.causality)
        found = self.element.get("initial", default)
        return str(found) if found is not None else None

    def inherited(self, attribute: str) -> str | None:
        """Attribute of the variable or, failing that, of its declared type."""
        own = self.typed.get(attribute)
        if own is None and self.declared is not None:
            own = self.declared.get(attribute)
        return str(own) if own is not None else None

    def number(self, attribute: str, default: float) -> float:
        """An attribute as a number; the default where it is missing or no number."""
        text = self.inherited(attribute)
        try:
            return float(text) if text is not None else default
        except ValueError:
            return default

    @property
    def start(self) -> Any:
        """Of the variable's type; None where there is none or it is no value of the type."""
        text = self.typed.get("start")
        if text is None or self.type == "String":
            return text
        if self.type == "Boolean":
            return text in TRUE
        try:
            return float(text) if self.type == "Real" else int(text)
        except ValueError:
            return None


class Model:
    """The description of an FMU."""

    def __init__(self, fmu: Fmu) -> None:
        """Read the elements; nothing is judged."""
        self.fmu = fmu
        self.root = fmu.root
        self.simulation = fmu.simulation

    @cached_property
    def types(self) -> dict[str, Any]:
        """Typed elements of the declared types by name."""
        return {
            t.get("name"): t[0] for t in self.root.iterfind("TypeDefinitions/SimpleType") if len(t)
        }

    @cached_property
    def scalars(self) -> list[Scalar]:
        """All variables, in their order."""
        found = []
        for index, element in enumerate(self.root.iterfind("ModelVariables/ScalarVariable"), 1):
            typed = next((child for child in element if child.tag in _TYPES), None)
            if typed is not None:
                found.append(
                    Scalar(element, typed, self.types.get(typed.get("declaredType")), index)
                )
        return found

    def flag(self, name: str) -> bool:
        """A capability of CoSimulation."""
        return self.simulation.get(name, "false") in TRUE

    def experiment(self, name: str) -> float | None:
        """A number of DefaultExperiment."""
        element = self.root.find("DefaultExperiment")
        text: Any = element.get(name) if element is not None else None
        with contextlib.suppress(TypeError, ValueError):
            number = float(text)
            return number if math.isfinite(number) else None
        return None

    def facts(self) -> dict[str, Any]:
        """What a probe has to know, but for the paths; JSON types.

        Raises:
            Skip: a variable's value reference is no number.
        """
        step = self.experiment("stepSize")
        try:
            variables = [_plain(scalar) for scalar in self.scalars]
        except (TypeError, ValueError):
            raise Skip("a variable has no valid value reference") from None
        return {
            "guid": self.root.get("guid", ""),
            "step": step if step and step > 0 else _DEFAULT_STEP,
            "start": self.experiment("startTime") or 0.0,
            "variable_step": self.flag("canHandleVariableCommunicationStepSize"),
            "has_state": self.flag("canGetAndSetFMUstate"),
            "can_serialise": self.flag("canSerializeFMUstate"),
            "has_derivatives": self.flag("providesDirectionalDerivative"),
            "only_once": self.flag("canBeInstantiatedOnlyOncePerProcess"),
            "model_exchange": self.root.find("ModelExchange") is not None,
            "has_resources": any(m.startswith("resources/") for m in self.fmu.members),
            "categories": [c.get("name", "") for c in self.root.iterfind("LogCategories/Category")],
            "one": 1.0,
            "variables": variables,
        }


def _plain(scalar: Scalar) -> dict[str, Any]:
    nominal = scalar.number("nominal", 0.0)
    return {
        "name": scalar.name,
        "reference": int(scalar.element.get("valueReference")),
        "type": "Integer" if scalar.type == "Enumeration" else scalar.type,
        "causality": scalar.causality,
        "variability": scalar.variability,
        "initial": scalar.initial,
        "start": scalar.start,
        "low": scalar.number("min", -math.inf),
        "high": scalar.number("max", math.inf),
        "nominal": abs(nominal) if math.isfinite(nominal) else 0.0,
    }
