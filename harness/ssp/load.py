"""An `.ssp` file as a folder with a scenario, which `steadytip run` takes.

| in the folder | holds |
| --- | --- |
| `NAME.toml` | the scenario: parts, wires, delays |
| `fmus/*.fmu` | the FMUs |
| `parameters/PART.ssv` | the values of a part, in the units of its FMU |
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from fmu_src.errors import SteadytipError
from harness.common.endpoint import Endpoint
from harness.common.errors import ProblemsError
from harness.parts import ssp_markup as markup
from harness.parts.description import Description, describe
from harness.parts.ports import Port, Unit
from harness.parts.ssv import SsvValue, write_ssv
from harness.ssp.flatten import Component, Connector, Flat, FlatConnection, flatten
from harness.ssp.names import file_names, portable
from harness.ssp.order import Connection, delays, feedthrough, run_order
from harness.ssp.place import named

__all__ = ["Loaded", "load"]

_SECONDS = 10.0  # where the file has no experiment with an end
_STEP = 1e-3  # where no FMU states a step
_MULTIPLE = 1e-6  # relative tolerance of "a whole multiple"


@dataclass(frozen=True)
class Loaded:
    """What became of an SSP file.

    Attributes:
        scenario: the scenario file.
        notes: what the file did not say, and what was taken instead.
    """

    scenario: Path
    notes: tuple[str, ...]


def load(path: Path, folder: Path, step: float | None = None) -> Loaded:
    """Turn an SSP file into a scenario with its FMUs.

    Args:
        path: the SSP file.
        folder: where to; new or empty.
        step: period of the loop [s]; by default the longest step that an FMU asks for.

    Raises:
        ProblemsError: everything in the file that a scenario cannot express.
        SteadytipError: a damaged or hostile file, missing FMUs, or the folder is not empty.
    """
    if not path.is_file():
        raise SteadytipError(f"SSP file {path} does not exist")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SteadytipError(f"{folder} is not an empty folder; choose another one")
    with tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True) as workspace:
        flat = flatten(path, Path(workspace))
        if not flat.components:
            raise SteadytipError(f"{path}: the system holds no FMU")
        files = {c.fmu: c.where for c in flat.components}
        described = {file: _describe(file, where) for file, where in files.items()}
        descriptions = {c.path: described[c.fmu] for c in flat.components}
        problems: list[str] = []
        names = _part_names(flat.components, problems)
        problems += [
            text for c in flat.components for text in _component_problems(c, descriptions[c.path])
        ]
        problems += [text for link in flat.links for text in _link_problems(link, descriptions)]
        values = {c.path: _values(c, descriptions[c.path], problems) for c in flat.components}
        if problems:
            raise ProblemsError(path.name, problems)
        notes: list[str] = []
        table = _table(flat, names, descriptions, values, step, notes)
        return Loaded(_write(folder, flat, names, values, table), tuple(notes))


def _describe(file: Path, where: str) -> Description:
    try:
        return describe(file)
    except SteadytipError as error:
        raise named(error, file, where) from None


def _part_names(components: Sequence[Component], problems: list[str]) -> dict[tuple[str, ...], str]:
    """Names of parts: a scenario's hold no dot."""
    names: dict[tuple[str, ...], str] = {}
    for component in components:
        name = "_".join(component.path).replace(".", "_")
        if name in names.values():
            problems.append(
                f"'{'.'.join(component.path)}' would be called '{name}', as another component is; "
                "rename one"
            )
        names[component.path] = name
    return names


def _component_problems(component: Component, description: Description) -> Iterator[str]:
    ports = {port.name: port for port in (*description.inputs, *description.outputs)}
    for name, (declared, unit) in component.connectors.items():
        port = ports.get(name)
        what = f"connector '{'.'.join((*component.path, name))}'"
        if port is None:
            continue  # of a parameter, or one that the wires' check names
        if "*" in name:
            yield f"{what}: names with a '*' are not supported"
        if declared is not None and declared.replace("Enumeration", "Integer") != port.type:
            yield f"{what} is declared as {declared}, the FMU has {port.type}"
        if unit is not None and port.unit is not None and not _same(unit, port.unit):
            yield (
                f"{what} is declared in {unit.name}, the FMU has {port.unit.name}; "
                "units are not converted at connectors"
            )


def _same(unit: Unit, other: Unit) -> bool:
    return unit.same_as(other) or unit.name == other.name


def _link_problems(
    link: FlatConnection, descriptions: Mapping[tuple[str, ...], Description]
) -> Iterator[str]:
    what = f"connection {_shown(link.source)} -> {_shown(link.target)}"
    if link.transformation is not None:
        change = link.transformation
        shown = change if isinstance(change, str) else f"{change[0]:g} x + {change[1]:g}"
        yield f"{what} changes the value ({shown}), which a wire cannot; do it in one of the FMUs"
    source = _unit(descriptions[link.source[0]].outputs, link.source[1])
    target = _unit(descriptions[link.target[0]].inputs, link.target[1])
    if source is None or target is None or source.same_as(target):
        return
    if not link.converts or markup.convert(1.0, source, target) is None:
        yield f"{what}: units differ ({source.name}, {target.name}) and are not converted"
    else:
        yield (
            f"{what} converts {source.name} to {target.name}, which a wire cannot; "
            "do it in one of the FMUs"
        )


def _unit(ports: Sequence[Port], name: str) -> Unit | None:
    return next((port.unit for port in ports if port.name == name and port.type == "Real"), None)


def _values(
    component: Component, description: Description, problems: list[str]
) -> dict[str, SsvValue]:
    """Return a component's values in the units and types of its FMU."""
    units = markup.units_of(description)
    values: dict[str, SsvValue] = {}
    for name, entry in component.values.items():
        what = f"parameter '{'.'.join((*component.path, name))}'"
        variable = description.variables.get(name)
        own = units.get(variable.unit) if variable else None
        value = entry.value
        if variable and variable.type == "Real" and isinstance(value, int | float):
            converted = _converted(float(value), entry, own, variable.unit)
            if converted is None:
                problems.append(
                    f"{what} is given in {entry.unit}, which does not convert to the FMU's "
                    f"{variable.unit}"
                )
                continue
            value = converted
        values[name] = SsvValue(value, own.name if own else None, own)
    seed = description.variables.get("seed")
    if seed is not None and seed.causality == "parameter" and isinstance(seed.start, int):
        # Without a value the FMU's own holds in every tool; a scenario would derive one.
        values.setdefault("seed", SsvValue(seed.start))
    return values


def _converted(value: float, entry: SsvValue, own: Unit | None, own_name: str) -> float | None:
    """Convert a value to the unit of the FMU's variable; None where it does not convert."""
    if not entry.unit or not own_name or entry.unit == own_name:
        return value
    if entry.definition is None or own is None:
        return None
    return markup.convert(value, entry.definition, own)


def _table(
    flat: Flat,
    names: Mapping[tuple[str, ...], str],
    descriptions: Mapping[tuple[str, ...], Description],
    values: Mapping[tuple[str, ...], Mapping[str, SsvValue]],
    step: float | None,
    notes: list[str],
) -> dict[str, Any]:
    """Return the scenario as TOML has it."""
    outputs = {names[path]: description.outputs for path, description in descriptions.items()}
    connections = [
        Connection(
            Endpoint(names[k.source[0]], k.source[1]), Endpoint(names[k.target[0]], k.target[1])
        )
        for k in flat.links
    ]
    order = run_order(
        [names[c.path] for c in flat.components],
        connections,
        lambda connection: feedthrough(outputs[connection.target.part], connection.target.port),
    )
    delayed = delays(order, connections)
    notes += [
        f"the loop is closed by one sample of delay from '{source}' to '{target}'"
        for source, target in dict.fromkeys(
            (c.source.part, c.target.part) for c in connections if delayed[c]
        )
    ]
    paths = {name: path for path, name in names.items()}
    fmus = file_names({descriptions[c.path].sha256: c.fmu.stem for c in flat.components}, ".fmu")
    sets = file_names({name: name for name in order}, ".ssv")
    parts: dict[str, dict[str, Any]] = {}
    for name in order:
        parts[name] = {"fmu": f"fmus/{fmus[descriptions[paths[name]].sha256]}"}
        if values[paths[name]]:
            parts[name]["parameters"] = f"parameters/{sets[name]}"
    return {
        "title": flat.description or flat.name,
        "seconds": _seconds(flat, notes),
        "step_size": step if step is not None else _step(list(descriptions.values()), notes),
        "part": parts,
        "wire": [
            {"from": str(c.source), "to": str(c.target)}
            | ({"delay": delayed[c]} if delayed[c] else {})
            for c in connections
        ],
    }


def _seconds(flat: Flat, notes: list[str]) -> float:
    start = flat.start or 0.0
    if flat.stop is None or not start < flat.stop < math.inf:
        notes.append(f"the file does not say when to stop: the run is {_SECONDS:g} s long")
        return _SECONDS
    if start != 0.0:
        notes.append(f"the experiment starts at {start:g} s; runs start at 0 and are as long")
    return flat.stop - start


def _step(descriptions: Sequence[Description], notes: list[str]) -> float:
    """Longest step that an FMU asks for: the others step several times within it."""
    steps = [d.step for d in descriptions if d.step]
    if not steps:
        notes.append(f"no FMU states a step: the loop runs every {_STEP:g} s")
        return _STEP
    longest = max(steps)
    for step in sorted(set(steps)):
        if abs(longest / step - round(longest / step)) > _MULTIPLE * longest / step:
            notes.append(f"steps of {step:g} s do not fit into the loop's {longest:g} s")
    return longest


def _write(
    folder: Path,
    flat: Flat,
    names: Mapping[tuple[str, ...], str],
    values: Mapping[tuple[str, ...], Mapping[str, SsvValue]],
    table: Mapping[str, Any],
) -> Path:
    scenario = folder / f"{portable(flat.name)}.toml"
    try:
        (folder / "fmus").mkdir(parents=True)
        (folder / "parameters").mkdir()
        for component in flat.components:
            part = table["part"][names[component.path]]
            shutil.copyfile(component.fmu, folder / part["fmu"])
            if "parameters" in part:
                content = write_ssv(flat.name, values[component.path])
                (folder / part["parameters"]).write_bytes(content)
        scenario.write_bytes(tomli_w.dumps(table).encode())
    except OSError as error:
        raise SteadytipError(f"{error.filename or folder}: {error.strerror}") from None
    return scenario


def _shown(end: Connector) -> str:
    return ".".join((*end[0], end[1]))
