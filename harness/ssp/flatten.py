"""One flat system from the nested ones of an SSP file.

Components of a nested system get its name and an underscore in front of their own, at every level.
Connections through a system's own connectors are followed to the component's outputs behind them.
Parameter bindings are applied from the inside outwards, so that the outer value holds; in the
values of a system, names are those of the inner elements and of their parameters with dots between.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lxml import etree

from fmu_src.errors import SteadytipError
from harness.common import archives
from harness.common.errors import ProblemsError
from harness.parts import ssp_markup as markup
from harness.parts.ports import Unit
from harness.parts.ssp_markup import tag
from harness.parts.ssv import SsvValue
from harness.ssp.bindings import Transformation, find_bindings, transformation
from harness.ssp.place import Place, named

__all__ = ["FMU_TYPE", "SSD", "Component", "Connector", "Flat", "FlatConnection", "flatten"]

SSD = "SystemStructure.ssd"
"""Entry point of an SSP archive."""

FMU_TYPE = "application/x-fmu-sharedlibrary"
_SSD, _SSP = "application/x-ssp-definition", "application/x-ssp-package"
_DEEPEST = 16  # levels of systems in systems
_MOST_ELEMENTS = 10_000  # references that hold references multiply
_GIVES = {"input": False, "output": True, "parameter": False, "calculatedParameter": True}
"""Kinds of connectors, and whether an element gives a value there."""

Connector = tuple[tuple[str, ...], str]
"""Names of the nested elements from the outside to the inside, and a connector of the last."""


@dataclass
class Component:
    """An FMU in a system.

    Attributes:
        path: names of the systems that it is in, and its own.
        fmu: the file.
        where: name of that file for messages.
        connectors: type and unit that the system declares of each connector, None where it does
            not.
        values: parameters by name.
    """

    path: tuple[str, ...]
    fmu: Path
    where: str
    connectors: dict[str, tuple[str | None, Unit | None]] = field(default_factory=dict)
    values: dict[str, SsvValue] = field(default_factory=dict)


@dataclass(frozen=True)
class FlatConnection:
    """Connection of a component's output to a component's input.

    Attributes:
        source: the output.
        target: the input.
        transformation: what the system does to the value on the way; None for nothing.
        converts: whether units are converted on the way, should they differ.
    """

    source: Connector
    target: Connector
    transformation: Transformation | None = None
    converts: bool = True


@dataclass
class Flat:
    """Components and connections of a system with everything that is nested in it.

    Attributes:
        name: of the system structure.
        description: one line for people.
        start: of the default experiment [s]; None without one.
        stop: of the default experiment [s]; None without one.
        components: in the order of the file.
        links: in the order of the file.
    """

    name: str
    description: str
    start: float | None
    stop: float | None
    components: list[Component]
    links: list[FlatConnection]


def flatten(path: Path, workspace: Path) -> Flat:
    """Read an SSP archive.

    Args:
        path: the archive.
        workspace: folder for its content, which the result refers to.

    Raises:
        ProblemsError: what cannot be expressed as a flat system of FMUs, all of it.
        SteadytipError: a damaged or hostile archive, missing files, or XML against the schema.
    """
    reader = _Reader(workspace)
    place = Place(reader.unpack(path), SSD, path.name)
    root = place.root()
    system = root.find(tag("ssd", "System"))
    reader.system(system, place, ())
    links = list(reader.links())
    if reader.problems:
        raise ProblemsError(path.name, reader.problems)
    experiment = root.find(tag("ssd", "DefaultExperiment"))
    times = {} if experiment is None else experiment.attrib
    return Flat(
        name=root.get("name"),
        description=system.get("description", ""),
        start=float(times["startTime"]) if "startTime" in times else None,
        stop=float(times["stopTime"]) if "stopTime" in times else None,
        components=list(reader.components.values()),
        links=links,
    )


class _Reader:
    def __init__(self, workspace: Path) -> None:
        self.problems: list[str] = []
        self.components: dict[tuple[str, ...], Component] = {}
        self._workspace = workspace
        self._left = archives.MOST_BYTES
        self._elements = 0
        self._kinds: dict[Connector, str] = {}
        self._drivers: dict[Connector, FlatConnection] = {}
        self._presets: dict[Connector, SsvValue] = {}

    def unpack(self, path: Path) -> Path:
        """Extract an archive; all archives of a run share one budget of bytes."""
        home = self._workspace / str(len(list(self._workspace.iterdir())))
        names = archives.extract(path, home, most_bytes=self._left)
        self._left -= sum((home / name).stat().st_size for name in names)
        return home

    def system(self, system: Any, place: Place, path: tuple[str, ...]) -> None:
        """Take in a system, its elements and what is nested in them."""
        if len(path) > _DEEPEST:
            raise SteadytipError(f"{place.where}: systems are nested deeper than {_DEEPEST} levels")
        self._connectors(system, path)
        children: set[str] = set()
        for child in system.iterfind(f"{tag('ssd', 'Elements')}/*"):
            name = child.get("name")
            inner = (*path, name)
            if name in children:
                self._problem(inner, "there are two elements of this name; rename one")
                continue
            children.add(name)
            self._elements += 1
            if self._elements > _MOST_ELEMENTS:
                raise SteadytipError(f"{place.where} has more than {_MOST_ELEMENTS} elements")
            if child.tag == tag("ssd", "System"):
                self.system(child, place, inner)
            elif child.tag == tag("ssd", "Component"):
                self._component(child, place, inner)
            else:
                self._problem(inner, "signal dictionaries are not supported; connect directly")
        for connection in system.iterfind(f"{tag('ssd', 'Connections')}/*"):
            self._connection(connection, path)
        self._values(system, place, path)

    def links(self) -> Iterator[FlatConnection]:
        """Yield connections between components; those through systems' connectors become one."""
        for target in list(self._drivers):
            if target[0] not in self.components:
                continue
            link = self._drivers[target]
            seen = {target}
            while link.source[0] not in self.components:
                if link.source in seen:
                    self._problem(*target, "its connection goes round in a circle")
                    break
                seen.add(link.source)
                before = self._drivers.get(link.source)
                if before is None:
                    self._preset(link)  # from an input of the whole system: nothing drives it
                    break
                link = FlatConnection(
                    before.source,
                    target,
                    link.transformation or before.transformation,
                    link.converts and before.converts,
                )
            else:
                if self._kinds.get(link.source) == "calculatedParameter":
                    self._problem(*target, "parameters that a component calculates cannot be used")
                else:
                    yield link

    def _preset(self, link: FlatConnection) -> None:
        """Give a component the value of the system's connector that it hangs on."""
        value = self._presets.get(link.source)
        if value is None:
            return
        if link.transformation is not None:
            self._problem(*link.target, "its value is changed on the way; give the changed one")
            return
        self.components[link.target[0]].values[link.target[1]] = value

    def _problem(self, path: tuple[str, ...], *text: str) -> None:
        self.problems.append(f"'{'.'.join((*path, *text[:-1]))}': {text[-1]}")

    def _connectors(self, item: Any, path: tuple[str, ...]) -> None:
        for connector in item.iterfind(f"{tag('ssd', 'Connectors')}/*"):
            endpoint = (path, connector.get("name"))
            if endpoint in self._kinds:
                self._problem(*endpoint, "there are two connectors of this name")
            self._kinds[endpoint] = connector.get("kind")

    def _component(self, item: Any, place: Place, path: tuple[str, ...]) -> None:
        kind, source = item.get("type", FMU_TYPE), item.get("source")
        if kind in {_SSD, _SSP}:
            self._reference(item, place, path)
        elif kind != FMU_TYPE:
            self._problem(path, f"components of type {kind} are not supported, only FMUs are")
            return
        elif item.get("implementation") == "ModelExchange":
            self._problem(path, "model exchange is not supported; choose CoSimulation")
        else:
            file = place.file(source, path)
            self.components[path] = Component(path, file, f"{place.where}: {source}")
            self._connectors(item, path)
            units = markup.find_units(item.getroottree().getroot(), "ssd")
            for connector in item.iterfind(f"{tag('ssd', 'Connectors')}/*"):
                declared = next(connector.iterchildren(f"{tag('ssc', '*')}"), None)
                self.components[path].connectors[connector.get("name")] = (
                    (None, None)
                    if declared is None
                    else (etree.QName(declared).localname, units.get(declared.get("unit", "")))
                )
        self._values(item, place, path)

    def _reference(self, item: Any, place: Place, path: tuple[str, ...]) -> None:
        """Read a component that is another system, of this file, another, or another archive."""
        source = item.get("source")
        base, _, fragment = source.partition("#")
        key = f"{place.home.name}:{base or place.ssd}#{fragment}"
        if key in place.seen:
            chain = " -> ".join(path)
            raise SteadytipError(f"{place.where}: systems hold each other in a circle: {chain}")
        inner = replace(place, seen=(*place.seen, key))
        if not base:
            found = item.xpath("//*[@id=$id]", id=fragment)
            if len(found) != 1 or found[0].tag != tag("ssd", "System"):
                self._problem(path, f"{source} names no system in {place.ssd}")
                return
            self.system(found[0], inner, path)
            return
        file = place.file(base, path)
        if item.get("type") == _SSP:
            where = f"{place.where}: {base}"
            try:
                home = self.unpack(file)
            except archives.ArchiveError as error:
                raise named(error, file, where) from None
            inner = replace(inner, home=home, ssd=fragment or SSD, where=where)
        else:
            inner = replace(inner, ssd=file.relative_to(place.home).as_posix())
        self.system(inner.root().find(tag("ssd", "System")), inner, path)

    def _connection(self, item: Any, path: tuple[str, ...]) -> None:
        ends: list[Connector] = []
        for side in ("start", "end"):
            name = item.get(f"{side}Element")
            ends.append(((*path, name) if name else path, item.get(f"{side}Connector")))
        label = f"connection {_shown(ends[0])} -> {_shown(ends[1])}"
        gives: list[bool] = []
        for end in ends:
            kind = self._kinds.get(end)
            if kind not in _GIVES:
                self.problems.append(
                    f"{label}: there is no connector '{_shown(end)}'"
                    if kind is None
                    else f"{label}: connectors of kind {kind} are not supported"
                )
                return
            # Seen from inside a system, its own inputs give values and its own outputs take them.
            gives.append(_GIVES[kind] != (end[0] == path))
        if gives[0] == gives[1]:
            self.problems.append(f"{label}: both ends {'give' if gives[0] else 'take'} a value")
            return
        source, target = ends if gives[0] else ends[::-1]
        if target in self._drivers:
            self.problems.append(f"{label}: '{_shown(target)}' is driven twice; keep one")
            return
        self._drivers[target] = FlatConnection(
            source,
            target,
            transformation(item),
            item.get("suppressUnitConversion") not in {"true", "1"},
        )

    def _values(self, item: Any, place: Place, path: tuple[str, ...]) -> None:
        """Give the values of an element's parameter bindings to components and connectors."""
        inside = {
            ".".join(p[len(path) :]): component
            for p, component in self.components.items()
            if p[: len(path)] == path
        }
        # Names of elements may hold dots as well: the longest that fits is meant.
        prefixes = sorted(inside, key=len, reverse=True)
        for name, value in find_bindings(item, place, path):
            fitting = next((p for p in prefixes if not p or name.startswith(f"{p}.")), None)
            if fitting is not None:
                inside[fitting].values[name[len(fitting) + 1 :] if fitting else name] = value
            elif (path, name) in self._kinds:
                self._presets[path, name] = value
            else:
                self._problem(path, name, "neither a component nor the system has this parameter")


def _shown(end: Connector) -> str:
    return ".".join((*end[0], end[1]))
