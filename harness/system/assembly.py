"""From a scenario to parts that are wired and ready to start."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.endpoint import Endpoint
from harness.common.errors import ProblemsError
from harness.parts.fmu import FmuPart
from harness.parts.kinds import kinds
from harness.parts.ports import Column
from harness.parts.protocols import OnBus, Part, Settings
from harness.parts.replay import PORTS as MOTION_PORTS
from harness.parts.replay import ReplayPart
from harness.parts.settings import FmuSettings
from harness.recordings.findings import Finding
from harness.recordings.motion import MotionColumns
from harness.scenario.events import MODEL
from harness.scenario.replaced import replaced_parts
from harness.scenario.schema import NIS_OUTPUT, SHORTEST_EVALUATION, PartTable, Scenario, Wire
from harness.system.bus import route_over_bus
from harness.system.events import Event, events_of
from harness.system.faults import insert_faults
from harness.system.roles import roles
from harness.system.wiring import Wiring, connect

__all__ = ["System", "assemble", "part_moved_by_recording", "part_seed", "reference", "with_files"]


@dataclass(frozen=True)
class System:
    """Parts with their wiring.

    Attributes:
        scenario: what it was made from.
        parts: by name, in the scenario's order; recordings stand before the part they move.
        wiring: run order and connections.
        step_limits: wall-clock time that one call of each part may take [s].
        roles: names of the recorded columns that play each role of the scenario's `signals`.
        motions: recordings by the name of the part that they move.
        steps: number of ticks.
        notes: what the user should know before the run.
        events: what happens in the middle of it.
        names: of recorded columns that are not called after their part and port, by those.
        unfused: the same before parts of it were fused into a container; None if none were.
    """

    scenario: Scenario
    parts: Mapping[str, Part]
    wiring: Wiring
    step_limits: Mapping[str, float]
    roles: Mapping[str, tuple[str, ...]]
    motions: Mapping[str, Path]
    steps: int
    notes: tuple[str, ...]
    events: tuple[Event, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    unfused: System | None = None

    def place(self, part: str, name: str) -> tuple[str, str]:
        """Find a variable of a part: part and variable, those of a container if it is fused."""
        if part in self.parts:
            return part, name
        assert self.unfused is not None
        (container,) = (each for each in self.parts if each not in self.unfused.parts)
        port = any(each.name == name for each in self.unfused.parts[part].inputs)
        return container, f"{part}_{name}" if port else f"{part}.{name}"

    @property
    def findings(self) -> dict[str, tuple[Finding, ...]]:
        """Findings about each recording, by the name of its part."""
        replayed = {n: part for n, part in self.parts.items() if isinstance(part, ReplayPart)}
        return {name: part.findings for name, part in replayed.items() if part.findings}

    @property
    def columns(self) -> list[Column]:
        """Outputs in the order of the parts."""
        return [
            Column(
                self.names.get(f"{name}.{port.name}", f"{name}.{port.name}"),
                port.type,
                port.unit_name,
                port.description,
            )
            for name, part in self.parts.items()
            for port in part.outputs
        ]


def part_seed(seed: int, name: str) -> int:
    """Seed of one part's randomness: follows from the scenario's seed and the part's name alone."""
    return int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0])


def assemble(
    scenario: Scenario,
    motion: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
    files: Mapping[str, Path] | None = None,
    accept: Collection[str] = (),
    repair: Collection[str] = (),
    read_as: MotionColumns | None = None,
) -> System:
    """Build what is missing, make the parts, wire them.

    Args:
        scenario: checked scenario.
        motion: recording for the one part that takes one.
        progress: told in a few words what is being done.
        files: what to take instead of files and models that the scenario names; see `reference`.
        accept: names of findings about recordings to go on with.
        repair: names of findings about recordings to repair.
        read_as: columns, units and rate of `motion`, as far as it does not say.

    Raises:
        FindingsError: a recording has defects that make figures meaningless.
        ProblemsError: everything that is wrong with parts, or with wires, or with signals.
        SteadytipError: a model does not build, or no single part takes the recording.
    """
    where = scenario.name
    scenario = _with_fault_parts(scenario)
    gone = replaced_parts(scenario)
    there = files or {}
    made = _make(scenario, [n for n in scenario.parts if n not in gone], progress, there)
    motions = {name: table.motion for name, table in scenario.parts.items() if table.motion}
    motions = {name: path for name, path in motions.items() if name not in gone}
    if motion is not None:
        motions[part_moved_by_recording(made)] = motion
    parts: dict[str, Part] = {}
    wires = list(scenario.wires)
    for name, part in made.items():
        if name in motions:
            companion = f"{name}.motion"
            settings = {
                "replay": str(there.get(str(motions[name]), motions[name])),
                "accept": [*scenario.parts[name].accept, *accept],
                "repair": [*scenario.parts[name].repair, *repair],
                "columns": read_as or scenario.parts[name].columns,
            }
            parts[companion] = ReplayPart(companion, settings, seed=0)
            _check_takes_motion(name, part)
            wires.append(Wire(f"{companion}.recorded*", f"{name}.recorded*"))
        parts[name] = part
        if isinstance(part, OnBus):
            parts |= part.siblings
    wires, crossing = route_over_bus(wires, parts, gone)
    wires, problems = insert_faults(wires, parts, scenario.faults)
    wiring = connect(where, parts, wires)
    changes = [*scenario.changes, *(c for fault in scenario.faults for c in fault.changes())]
    events = events_of(changes, parts, wiring.unconnected, scenario.step_size, problems)
    if problems:
        raise ProblemsError(where, problems)
    seconds, notes = _duration(scenario, parts)
    columns = [f"{name}.{port.name}" for name, part in parts.items() for port in part.outputs]
    played = roles(scenario, columns)
    return System(
        scenario=scenario,
        parts=parts,
        wiring=wiring,
        step_limits={name: scenario.parts[_owner(name, scenario)].step_limit for name in parts},
        roles=played,
        motions=motions,
        steps=max(1, int(seconds / scenario.step_size + 1e-6)),
        notes=(
            *scenario.notes,
            *notes,
            *crossing,
            *_silent_estimators(scenario, columns),
            *_period_notes(scenario.step_size, parts),
            *_loose_parts(parts, wiring, played),
            *wiring.notes,
        ),
        events=events,
    )


def _with_fault_parts(scenario: Scenario) -> Scenario:
    """Add the parts that faults put into wires."""
    settings: dict[str, dict[str, Any]] = {}
    for fault in scenario.faults:
        table = settings.setdefault(fault.part, {"fmu": MODEL})
        if fault.at == 0.0:
            table |= fault.settings
    added = {
        name: PartTable("fmu", FmuSettings.model_validate(table))
        for name, table in settings.items()
    }
    return replace(scenario, parts={**scenario.parts, **added})


def _owner(name: str, scenario: Scenario) -> str:
    """Return the part that a sibling stands beside; any other part's own name."""
    beside = Endpoint.find(name, scenario.parts)
    return beside.part if beside and name not in scenario.parts else name


def _make(
    scenario: Scenario,
    names: Sequence[str],
    progress: Callable[[str], None],
    files: Mapping[str, Path],
) -> dict[str, Part]:
    known = kinds()
    wanted = {name: with_files(scenario.parts[name], files) for name in names}
    classes = {kind: known[kind].load() for kind in {t.kind for t in wanted.values()}}
    settings: dict[str, Settings] = {}
    for kind, part_class in classes.items():
        tables = {n: t.settings.table for n, t in wanted.items() if t.kind == kind}
        settings |= part_class.prepare(tables, progress)
    parts: dict[str, Part] = {}
    problems: list[str] = []
    for name, table in wanted.items():
        try:
            parts[name] = classes[table.kind](name, settings[name], part_seed(scenario.seed, name))
        except ProblemsError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
        except SteadytipError as error:
            problems.append(f"part '{name}': {error}")
    if problems:
        raise ProblemsError(scenario.name, problems)
    return parts


def reference(table: PartTable, key: str) -> str:
    """Return how a part's setting names a file, or a model that is built in some flavour."""
    if key == "fmu" and isinstance(table.settings, FmuSettings) and table.settings.is_model:
        return f"{table.settings.flavour} {table.settings.fmu}"
    return str(table.settings.table[key])


def with_files(table: PartTable, files: Mapping[str, Path]) -> PartTable:
    """Put other files in the place of those that a table names."""
    given = table.settings
    found = {
        key: str(files[reference(table, key)])
        for key in given.files
        if key in given.table and reference(table, key) in files
    }
    return replace(table, settings=given.model_copy(update=found)) if found else table


def part_moved_by_recording(parts: Mapping[str, Part]) -> str:
    """Name of the one part that a recording can move.

    Raises:
        SteadytipError: there is none, or more than one.
    """
    taking = [name for name, part in parts.items() if not _lacking(part)]
    if len(taking) == 1:
        return taking[0]
    wanted = ", ".join(port.name for port in MOTION_PORTS)
    raise SteadytipError(
        f"a recording needs one part with the inputs {wanted}; "
        + (
            f"here {', '.join(taking)} have them: write 'motion' into the part that is meant"
            if taking
            else f"none of {', '.join(parts)} has them"
        )
    )


def _lacking(part: Part) -> list[str]:
    inputs = {port.name for port in part.inputs}
    return [port.name for port in MOTION_PORTS if port.name not in inputs]


def _check_takes_motion(name: str, part: Part) -> None:
    lacking = _lacking(part)
    if lacking:
        raise SteadytipError(
            f"part '{name}' cannot be moved by a recording: it has no input {', '.join(lacking)}"
        )


def _duration(scenario: Scenario, parts: Mapping[str, Part]) -> tuple[float, list[str]]:
    notes: list[str] = []
    shortest = min(parts.values(), key=lambda part: part.seconds)
    seconds = min(scenario.seconds, shortest.seconds)
    if seconds < scenario.seconds:
        notes.append(
            f"the run is {seconds:g} s long instead of {scenario.seconds:g} s: "
            f"'{shortest.name}' has no more"
        )
    if seconds - scenario.warm_up < SHORTEST_EVALUATION:
        notes.append(
            f"no figures of merit: 'warm_up' = {scenario.warm_up:g} s leaves less than "
            f"{SHORTEST_EVALUATION:g} s of {seconds:g} s"
        )
    return seconds, notes


def _period_notes(step: float, parts: Mapping[str, Part]) -> list[str]:
    """Return a note on FMUs whose sample period is no whole part of the loop's step."""
    periods: dict[float, list[str]] = {}
    for name, part in parts.items():
        period = part.description.step if isinstance(part, FmuPart) else None
        if period and abs(step / period - max(1, round(step / period))) > 1e-6:
            periods.setdefault(period, []).append(name)
    return [
        f"the step of {step:g} s is no multiple of the sample period of {', '.join(names)}, "
        f"{period:g} s: they act on some steps late, which costs figures; take a multiple of "
        f"{period:g} s"
        for period, names in periods.items()
    ]


def _loose_parts(
    parts: Mapping[str, Part], wiring: Wiring, played: Mapping[str, Sequence[str]]
) -> list[str]:
    """Return a note on parts that nothing is wired to or from, and that play no role."""
    wired = {end.part for link in wiring.links for end in (link.source, link.target)}
    read = {
        end.part for names in played.values() for n in names if (end := Endpoint.find(n, parts))
    }
    loose = [name for name in parts if name not in wired | read and len(parts) > 1]
    return [
        f"part '{name}' is wired to nothing, and no signal of the scenario is its: it runs for "
        "itself; add a [[wire]], or take it out"
        for name in loose
    ]


def _silent_estimators(scenario: Scenario, columns: Sequence[str]) -> list[str]:
    return [
        f"no NIS of '{name}', whose 'innovation_size' is {table.innovation_size}: it has no output "
        f"'{NIS_OUTPUT}'"
        for name, table in scenario.parts.items()
        if table.innovation_size is not None and f"{name}.{NIS_OUTPUT}" not in columns
    ]
