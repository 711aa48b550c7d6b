"""What an FMU says about itself in its `modelDescription.xml`, in the terms of the harness.

Everything that the harness knows about an FMU before it runs is here: ports with units and
dependencies, start values that a scenario may set, limits.
"""

from __future__ import annotations

import hashlib
import io
import math
import platform
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from fmpy import read_model_description, sharedLibraryExtension
from fmpy.model_description import ModelDescription, ModelVariable, ValidationError

from fmu_src.errors import SteadytipError
from harness.common import archives
from harness.common.types import PortType
from harness.common.xml_files import MOST_BYTES, parse_xml
from harness.parts.ports import DIMENSIONLESS, Port, Unit

_PORT_TYPES: dict[str, PortType] = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
}
_XML = "modelDescription.xml"
_KEPT = 32
"""Descriptions that are kept."""
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Variable:
    """One scalar variable of an FMU.

    Attributes:
        name: as the FMU writes it.
        reference: FMI value reference.
        type: `Real`, `Integer`, `Boolean` or `String`.
        causality: `parameter`, `input`, `output`, ...
        settable: whether a scenario may give it a start value.
        tunable: whether it may be set during a run: a tunable parameter, or an input.
        start: as declared; None where there is none.
        unit: name, empty without one.
        low: declared minimum, -inf without one.
        high: declared maximum, inf without one.
        description: one sentence.
    """

    name: str
    reference: int
    type: str
    causality: str
    settable: bool
    tunable: bool
    start: float | int | bool | str | None
    unit: str
    low: float
    high: float
    description: str


@dataclass(frozen=True)
class Description:
    """An FMU file and its model description.

    Attributes:
        path: the file.
        model: what fmpy read.
        members: names of the files in the archive.
        sha256: of the file, hexadecimal.
    """

    path: Path
    model: ModelDescription
    members: Sequence[str]
    sha256: str

    @cached_property
    def variables(self) -> dict[str, Variable]:
        """Scalar variables by name."""
        return {v.name: _variable(v) for v in self.model.modelVariables}

    @cached_property
    def units(self) -> dict[str, Unit]:
        """Declared units by name."""
        return {unit.name: _unit(unit) for unit in self.model.unitDefinitions}

    @cached_property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs: Real ones first, then Integer, then Boolean, else in the FMU's order."""
        return self._ports("input")

    @cached_property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs: Real ones first, then Integer, then Boolean, else in the FMU's order."""
        return self._ports("output")

    def _ports(self, causality: str) -> tuple[Port, ...]:
        depends = {
            unknown.variable.name: frozenset(v.name for v in unknown.dependencies)
            for unknown in self.model.outputs
            if unknown.dependencies is not None
        }
        ports = [
            Port(
                name=v.name,
                type=_PORT_TYPES[v.type],
                unit=self._port_unit(v),
                description=v.description or "",
                depends_on=depends.get(v.name),
            )
            for v in self.model.modelVariables
            if v.causality == causality and v.type in _PORT_TYPES
        ]
        return tuple(sorted(ports, key=lambda port: tuple(_PORT_TYPES).index(port.type)))

    def _port_unit(self, variable: ModelVariable) -> Unit | None:
        if not self.units:
            return None
        name = _inherited(variable, "unit")
        return self.units.get(name, Unit(name)) if name else DIMENSIONLESS

    @property
    def step(self) -> float | None:
        """Sample period or preferred communication step [s]; None where the FMU has no say."""
        experiment = self.model.defaultExperiment
        return float(experiment.stepSize) if experiment and experiment.stepSize else None

    @property
    def identifier(self) -> str:
        """Base name of the binary."""
        return str(self.model.coSimulation.modelIdentifier)

    def binary(self) -> str:
        """Archive member that is the binary for this machine.

        Raises:
            SteadytipError: there is none; says which there are.
        """
        wanted = [
            f"binaries/{folder}/{self.identifier}{sharedLibraryExtension}"
            for folder in platform_folders()
        ]
        for member in wanted:
            if member in self.members:
                return member
        present = sorted(
            {
                m.split("/")[1]
                for m in self.members
                if m.startswith("binaries/") and m.count("/") == 2 and not m.endswith("/")
            }
        )
        raise SteadytipError(
            f"{self.path.name} has no binary for this machine ({wanted[0]}); "
            f"it has {', '.join(present) or 'none at all'}. "
            "Get it for this platform, or compile its sources with 'fmpy compile'."
        )


def platform_folders() -> list[str]:
    """Folders of an FMU's `binaries` that may hold a binary for this machine, best first."""
    system = {"linux": "linux", "darwin": "darwin", "win32": "windows"}[sys.platform]
    if platform.machine().lower() in {"aarch64", "arm64"}:
        # FMI 2.0 has no name for it; exporters write the FMI 3.0 tuple in either order.
        return [f"aarch64-{system}", f"{system}-aarch64", "darwin64"][
            : 3 if system == "darwin" else 2
        ]
    bits = 64 if sys.maxsize > 2**32 else 32
    return [f"{'win' if system == 'windows' else system}{bits}"]


def describe(path: Path) -> Description:
    """Read an FMU's description; once for several parts that run the same file.

    Raises:
        SteadytipError: the file is missing, no FMU, broken, hostile, or not FMI 2.0 co-simulation.
    """
    try:
        state = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise SteadytipError(f"FMU {path} does not exist") from None
    except OSError as error:
        raise SteadytipError(f"FMU {path} cannot be read: {error.strerror}") from None
    # A file that is replaced or changed has another of these.
    return _described(path, (state.st_ino, state.st_size, state.st_mtime_ns))


@lru_cache(maxsize=_KEPT)
def _described(path: Path, _state: tuple[int, int, int]) -> Description:
    try:
        members = archives.members(path)
        if _XML not in members:
            raise SteadytipError(f"{path} is a zip file but no FMU: {_XML} is missing")
        content = archives.read(path, _XML, most_bytes=MOST_BYTES)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except (archives.ArchiveError, OSError) as error:
        raise SteadytipError(f"{path} is not an FMU: {error}") from None
    version = parse_xml(content, f"{path}: {_XML}").get("fmiVersion")
    if version != "2.0":
        raise SteadytipError(f"{path} is FMI {version}; the harness runs FMI 2.0 co-simulation")
    try:
        model = read_model_description(_alone(content))
    except ValidationError as error:
        raise SteadytipError(
            f"{path}: {_XML} breaks the FMI schema: {'; '.join(error.problems)}"
        ) from None
    except Exception as error:  # fmpy and lxml raise a dozen kinds here
        raise SteadytipError(f"{path}: {_XML} cannot be read: {error}") from None
    if model.coSimulation is None:
        raise SteadytipError(
            f"{path} is for model exchange only; the harness runs FMI 2.0 co-simulation"
        )
    return Description(path, model, tuple(members), digest)


def _alone(content: bytes) -> io.BytesIO:
    """Return an archive that holds a checked description and nothing else, for fmpy to read."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as archive:
        archive.writestr(_XML, content)
    memory.seek(0)
    return memory


def _inherited(variable: ModelVariable, attribute: str) -> str:
    """Attribute of a variable or, failing that, of its declared type."""
    own = getattr(variable, attribute)
    if own is None and variable.declaredType is not None:
        own = getattr(variable.declaredType, attribute)
    return own or ""


def _variable(v: ModelVariable) -> Variable:
    kind = _PORT_TYPES.get(v.type, "String")
    low, high = _inherited(v, "min"), _inherited(v, "max")
    settable = v.causality in {"parameter", "input"} or v.initial in {"exact", "approx"}
    return Variable(
        name=v.name,
        reference=v.valueReference,
        type=kind,
        causality=v.causality,
        settable=settable and v.variability != "constant",
        tunable=v.causality == "input"
        or (v.causality == "parameter" and v.variability == "tunable"),
        start=_start(kind, v.start),
        unit=_inherited(v, "unit"),
        low=float(low) if low else -math.inf,
        high=float(high) if high else math.inf,
        description=v.description or "",
    )


def _start(kind: str, text: str | None) -> Any:
    if text is None:
        return None
    if kind == "Real":
        return float(text)
    if kind == "Integer":
        return int(text)
    return text in {"true", "1"} if kind == "Boolean" else text


def _unit(unit: Any) -> Unit:
    base = unit.baseUnit
    if base is None:
        return Unit(unit.name)
    exponents = tuple(getattr(base, name) for name in _EXPONENTS)
    return Unit(unit.name, exponents, float(base.factor), float(base.offset))
