"""Variables of a description, resolved by the rules of the standard and in plain Python types."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["TRUE", "TYPES", "ScalarVariable"]

TRUE = {"true", "1"}
TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
_INITIAL = {
    "parameter": "exact",
    "calculatedParameter": "calculated",
    "output": "calculated",
    "local": "calculated",
}
"""Default of `initial` by causality (FMI 2.0.5, 2.2.7), constants apart."""


@dataclass(frozen=True)
class ScalarVariable:
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
        """Return attribute of the variable or, failing that, of its declared type."""
        own = self.typed.get(attribute)
        if own is None and self.declared is not None:
            own = self.declared.get(attribute)
        return str(own) if own is not None else None

    def number(self, attribute: str, default: float) -> float:
        """Return an attribute as a number; the default where it is missing or no number."""
        text = self.inherited(attribute)
        try:
            return float(text) if text is not None else default
        except ValueError:
            return default

    @property
    def start(self) -> Any:
        """Start value; None where there is none or it is no value of the variable's type."""
        text = self.typed.get("start")
        if text is None or self.type == "String":
            return text
        if self.type == "Boolean":
            return text in TRUE
        try:
            return float(text) if self.type == "Real" else int(text)
        except ValueError:
            return None

    def entry(self) -> dict[str, Any]:
        """Return what a probe has to know of the variable; JSON types.

        Raises:
            ValueError, TypeError: the value reference is no number.
        """
        nominal = self.number("nominal", 0.0)
        return {
            "name": self.name,
            "reference": int(self.element.get("valueReference")),
            "type": "Integer" if self.type == "Enumeration" else self.type,
            "causality": self.causality,
            "variability": self.variability,
            "initial": self.initial,
            "start": self.start,
            "low": self.number("min", -math.inf),
            "high": self.number("max", math.inf),
            "nominal": abs(nominal) if math.isfinite(nominal) else 0.0,
        }
