"""A scenario's system as an `.ssp` file.

| in the archive | holds |
| --- | --- |
| `SystemStructure.ssd` | components in run order, connectors, connections, units, experiment |
| `resources/*.fmu` | each distinct FMU once |
| `resources/NAME.ssv` | the values that the scenario gives to a component, its seed among them |
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lxml import etree

import fmu_src
from fmu_src.errors import SteadytipError
from fmu_src.pack.fmu import archive
from harness.common.errors import ProblemsError
from harness.parts import ssp_markup as markup
from harness.parts.description import Description
from harness.parts.fmu import FmuPart
from harness.parts.ports import Port, Unit
from harness.parts.protocols import Part
from harness.parts.ssv import SsvValue, write_ssv
from harness.scenario import load as scenarios
from harness.ssp.flatten import FMU_TYPE, SSD
from harness.ssp.names import file_names
from harness.ssp.order import Connection, delays, feedthrough, lag, run_order
from harness.system.assembly import System, assemble

__all__ = ["export"]

_FOLDER = "resources"


def export(
    scenario: str | os.PathLike[str],
    target: Path | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Path:
    """Write a scenario's system as an SSP file.

    Args:
        scenario: path of a scenario file, or the name of a shipped one.
        target: the file; by default the scenario's name with `.ssp` in the current folder.
        overrides: values by dotted key, put in place of the scenario's.

    Returns:
        The file.

    Raises:
        ProblemsError: everything in the scenario that SSP cannot hold.
        SteadytipError: a mistake in the scenario or an FMU.
    """
    system = assemble(scenarios.load(scenario, overrides))
    parts, connections = _checked(system)
    fmus = file_names({p.description.sha256: p.description.path.stem for p in parts}, ".fmu")
    sets = file_names({p.name: p.name for p in parts if p.start_values}, ".ssv")
    files = {
        f"{_FOLDER}/{fmus[p.description.sha256]}": p.description.path.read_bytes() for p in parts
    }
    for part in parts:
        if part.name in sets:
            # One name for the sets of all components: tools choose a configuration by it.
            content = write_ssv(system.scenario.name, _values(part))
            files[f"{_FOLDER}/{sets[part.name]}"] = content
    files[SSD] = markup.text(_structure(system, parts, connections, fmus, sets))
    path = target if target is not None else Path(f"{system.scenario.name}.ssp")
    try:
        archive.write(path, files)
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {error.strerror}") from None
    return path


def _checked(system: System) -> tuple[list[FmuPart], list[Connection]]:
    """Parts in run order and connections, if SSP can hold them."""
    problems = [text for name, part in system.parts.items() for text in _part_problems(name, part)]
    if system.events:
        problems.append(
            "an SSP file does not hold what happens in a run: leave 'change' and 'fault'"
        )
    if problems:
        raise ProblemsError(system.scenario.name, problems)
    links = {Connection(link.source, link.target): link.delay for link in system.wiring.links}

    def through(connection: Connection) -> bool:
        return feedthrough(system.parts[connection.target.part].outputs, connection.target.port)

    order = system.wiring.order
    read_back = delays(run_order(order, links, through), links)
    problems = [
        f"the wire {connection} has delay = {delay}; an SSP file does not hold delays, and whoever "
        f"reads it would take {read_back[connection]} (harness.ssp.order says why)"
        for connection, delay in links.items()
        if delay != read_back[connection]
    ]
    if problems:
        raise ProblemsError(system.scenario.name, problems)
    return [part for name in order if isinstance(part := system.parts[name], FmuPart)], list(links)


def _part_problems(name: str, part: Part) -> Iterator[str]:
    if not isinstance(part, FmuPart):
        yield (
            f"part '{name}' is no FMU, and SSP holds FMUs only; take it out of the scenario "
            "(a recording: let the hand's generator move instead)"
        )


def _values(part: FmuPart) -> dict[str, SsvValue]:
    description = part.description
    values = {}
    for name, value in part.start_values.items():
        variable = description.variables[name]
        # TOML's 1 for a Real parameter is 1.0.
        typed = float(value) if variable.type == "Real" else value
        unit = markup.units_of(description).get(variable.unit)
        values[name] = SsvValue(typed, variable.unit or None, unit)
    return values


def _structure(
    system: System,
    parts: Sequence[FmuPart],
    connections: Sequence[Connection],
    fmus: Mapping[str, str],
    sets: Mapping[str, str],
) -> Any:
    scenario = system.scenario
    root = markup.element(
        "ssd",
        name=scenario.name,
        description=_timing(scenario.step_size, parts, connections),
        generationTool=f"Steadytip {fmu_src.__version__}",
    )
    inner = etree.SubElement(
        root, markup.tag("ssd", "System"), {"name": scenario.name, "description": scenario.title}
    )
    elements = etree.SubElement(inner, markup.tag("ssd", "Elements"))
    units: list[Unit] = []
    for part in parts:
        _component(elements, part, fmus, sets, units)
    if connections:
        section = etree.SubElement(inner, markup.tag("ssd", "Connections"))
        for c in connections:
            etree.SubElement(
                section,
                markup.tag("ssd", "Connection"),
                {
                    "startElement": c.source.part,
                    "startConnector": c.source.port,
                    "endElement": c.target.part,
                    "endConnector": c.target.port,
                },
            )
    markup.add_units(root, "ssd", units)
    etree.SubElement(
        root,
        markup.tag("ssd", "DefaultExperiment"),
        {"startTime": "0.0", "stopTime": repr(system.steps * scenario.step_size)},
    )
    return root


def _timing(step: float, parts: Sequence[FmuPart], connections: Sequence[Connection]) -> str:
    """Return in words what SSP has no element for."""
    order = [part.name for part in parts]
    periods = {part.name: part.description.step or step for part in parts}
    late = lag(order, connections, periods)
    shown = ", ".join(f"{name} by {late[name] * 1e3:g} ms" for name in order if late[name])
    return (
        f"Meant to run one component after the other, in the order of this file, every "
        f"{step * 1e3:g} ms; a connection to an earlier component carries the value of the step "
        f"before. A tool that steps all components at once should communicate every "
        f"{min(periods.values()) * 1e3:g} ms; it then brings signals later to: {shown or 'none'}."
    )


def _component(
    elements: Any,
    part: FmuPart,
    fmus: Mapping[str, str],
    sets: Mapping[str, str],
    units: list[Unit],
) -> None:
    component = etree.SubElement(
        elements,
        markup.tag("ssd", "Component"),
        {
            "name": part.name,
            "type": FMU_TYPE,
            "source": f"{_FOLDER}/{fmus[part.description.sha256]}",
            "implementation": "CoSimulation",
        },
    )
    if part.inputs or part.outputs:
        connectors = etree.SubElement(component, markup.tag("ssd", "Connectors"))
        for kind, ports in (("input", part.inputs), ("output", part.outputs)):
            for port in ports:
                _connector(connectors, kind, port, part.description, units)
    if part.name in sets:
        bindings = etree.SubElement(component, markup.tag("ssd", "ParameterBindings"))
        etree.SubElement(
            bindings,
            markup.tag("ssd", "ParameterBinding"),
            {"source": f"{_FOLDER}/{sets[part.name]}"},
        )


def _connector(
    connectors: Any, kind: str, port: Port, description: Description, units: list[Unit]
) -> None:
    attributes = {"name": port.name, "kind": kind}
    if port.description:
        attributes["description"] = port.description
    connector = etree.SubElement(connectors, markup.tag("ssd", "Connector"), attributes)
    if port.name in markup.enumerations_of(description):
        return  # without a type here, that of the FMU's variable holds
    shown = {}
    # A connector's unit has to be defined, and only those with a base unit can be.
    unit = markup.units_of(description).get(port.unit.name) if port.unit else None
    if port.type == "Real" and unit is not None and unit.exponents is not None:
        shown["unit"] = unit.name
        units.append(unit)
    etree.SubElement(connector, markup.tag("ssc", port.type), shown)
