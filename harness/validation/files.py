"""An FMU as a file: its archive, its description as XML, its binaries."""

from __future__ import annotations

import contextlib
import math
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from fmu_src.errors import SteadytipError
from harness.common.archives import ArchiveError, read
from harness.common.xml_files import MOST_BYTES, parse_xml
from harness.validation.checks import Failure, Skip
from harness.validation.variables import TRUE, TYPES, ScalarVariable

__all__ = ["DESCRIPTION", "VERSION", "Fmu"]

DESCRIPTION = "modelDescription.xml"
VERSION = "2.0"
"""Of FMI; the checklist is for no other."""
_DEFAULT_STEP = 1e-3
"""Communication step of an FMU that names none [s]."""


@dataclass(frozen=True)
class Fmu:
    """FMU as a file: subject of the checks on files.

    Attributes:
        path: the archive.
    """

    path: Path

    @cached_property
    def infos(self) -> list[zipfile.ZipInfo]:
        """Members of the archive as its directory lists them.

        Raises:
            Failure: it is no archive.
        """
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.infolist()
        except Exception as error:  # zipfile raises a dozen kinds on damaged archives
            raise Failure(f"{self.path.name} is no zip archive: {error}") from None

    @cached_property
    def members(self) -> list[str]:
        """Names of the files."""
        return [info.orig_filename for info in self.infos if not info.is_dir()]

    def content(self, member: str, most_bytes: int = MOST_BYTES) -> bytes:
        """Read one file.

        Raises:
            Failure: it cannot be read.
        """
        try:
            return read(self.path, member, most_bytes=most_bytes)
        except ArchiveError as error:
            raise Failure(str(error)) from None

    @cached_property
    def root(self) -> Any:
        """Root element of the description, of FMI 2.0.

        Raises:
            Skip: there is none; item A3 or C1 says why.
        """
        try:
            root = self.parsed()
        except Failure:
            raise Skip(f"{DESCRIPTION} cannot be read") from None
        if root.get("fmiVersion") != VERSION:
            raise Skip(f"this is FMI {root.get('fmiVersion')}, not FMI {VERSION}")
        return root

    def parsed(self) -> Any:
        """Parse the description and return its root element.

        Raises:
            Failure: why it cannot be read.
        """
        if DESCRIPTION not in self.members:
            raise Failure(f"{DESCRIPTION} is missing at the root of the archive")
        try:
            return parse_xml(self.content(DESCRIPTION), DESCRIPTION)
        except SteadytipError as error:
            raise Failure(str(error)) from None

    @cached_property
    def simulation(self) -> Any:
        """Element CoSimulation.

        Raises:
            Skip: there is none.
        """
        element = self.root.find("CoSimulation")
        if element is None:
            raise Skip("the FMU is not for co-simulation")
        return element

    @property
    def identifier(self) -> str:
        """Base name of the binaries."""
        return str(self.simulation.get("modelIdentifier") or "")

    @cached_property
    def binaries(self) -> dict[str, str]:
        """Path of the FMU's own binary, by platform folder."""
        found = {}
        for member in self.members:
            parts = member.split("/")
            if len(parts) == 3 and parts[0] == "binaries":
                base, _, ending = parts[2].rpartition(".")
                if base == self.identifier and ending in {"so", "dll", "dylib"}:
                    found[parts[1]] = member
        return found

    @cached_property
    def types(self) -> dict[str, Any]:
        """Typed elements of the declared types by name."""
        declared = self.root.iterfind("TypeDefinitions/SimpleType")
        return {element.get("name"): element[0] for element in declared if len(element)}

    @cached_property
    def scalars(self) -> list[ScalarVariable]:
        """Variables, in their order.

        Raises:
            Skip: the FMU is not for co-simulation.
        """
        self.simulation  # noqa: B018 - skips where there is none
        found = []
        for index, element in enumerate(self.root.iterfind("ModelVariables/ScalarVariable"), 1):
            typed = next((child for child in element if child.tag in TYPES), None)
            if typed is not None:
                declared = self.types.get(typed.get("declaredType"))
                found.append(ScalarVariable(element, typed, declared, index))
        return found

    def flag(self, name: str) -> bool:
        """Return a capability of CoSimulation."""
        return self.simulation.get(name, "false") in TRUE

    def experiment(self, name: str) -> float | None:
        """Return a number of DefaultExperiment, or None."""
        self.simulation  # noqa: B018 - skips where there is none
        element = self.root.find("DefaultExperiment")
        text: Any = element.get(name) if element is not None else None
        with contextlib.suppress(TypeError, ValueError):
            number = float(text)
            return number if math.isfinite(number) else None
        return None

    def description_facts(self) -> dict[str, Any]:
        """Return what a probe has to know of the description; JSON types.

        Raises:
            Skip: a variable's value reference is no number.
        """
        step = self.experiment("stepSize")
        try:
            variables = [scalar.entry() for scalar in self.scalars]
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
            "has_resources": any(m.startswith("resources/") for m in self.members),
            "categories": [c.get("name", "") for c in self.root.iterfind("LogCategories/Category")],
            "one": 1.0,
            "variables": variables,
        }
