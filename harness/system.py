"""From a scenario to parts that are wired and ready to start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from harness.errors import ProblemsError, SteadytipError, nearest
from harness.events import MODEL, Event, events_of, tapped
from harness.parts import Part, Settings, is_path, kinds
from harness.parts.replay import PORTS as MOTION_PORTS
from harness.parts.replay import ReplayPart
from harness.record import Column
from harness.scenario import SHORTEST, SQUARED, PartTable, Scenario, Wire
from harness.wiring import Wiring, connect, cross

__all__ = [
    "System",
    "absent",
    "assemble",
    "matching",
    "moved_part",
    "part_seed",
    "placed",
    "reference",
    "roles",
]

_COUNTS = {
    "moved": 3,
    "tip": 3,
    "intent": 3,
    "attitude_true": 4,
    "attitude_estimated": 4,
    "position_true": 3,
    "position_estimated": 3,
    "saturated": 1,
}


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
        apart: the same before parts of it were fused into a container; None if none were.
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
    apart: System | None = None

    def place(self, part: str, name: str) -> tuple[str, str]:
        """Where a variable of a part is: part and variable, those of a container if it is fused."""
        if part in self.parts:
            return part, name
        assert self.apart is not None
        (container,) = (each for each in self.parts if each not in self.apart.parts)
        port = any(each.name == name for each in self.apart.parts[part].inputs)
        return container, f"{part}_{name}" if port else f"{part}.{name}"

    @property
    def columns(self) -> list[Column]:
        """All outputs in the order of the parts."""
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


def matching(columns: Sequence[str], patterns: str | Sequence[str]) -> tuple[str, ...]:
    """Columns that fit patterns (`*`, `?`), in the order of the patterns, then of the columns."""
    wanted = [patterns] if isinstance(patterns, str) else patterns
    # Brackets belong to names, as in `w[1]`; for fnmatch they would be a set of characters.
    wanted = [pattern.replace("[", "[[]") for pattern in wanted]
    return tuple(name for pattern in wanted for name in columns if fnmatchcase(name, pattern))


def assemble(
    scenario: Scenario,
    motion: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
    files: Mapping[str, Path] | None = None,
) -> System:
    """Build what is missing, make the parts, wire them.

    Args:
        scenario: checked scenario.
        motion: recording for the one part that takes one.
        progress: told in a few words what is being done.
        files: what to take instead of files and models that the scenario names; see `reference`.

    Raises:
        ProblemsError: everything that is wrong with parts, or with wires, or with signals.
        SteadytipError: a model does not build, or no single part takes the recording.
    """
    where = scenario.name
    scenario = _with_fault_parts(scenario)
    gone = absent(scenario)
    there = files or {}
    made = _make(scenario, [n for n in scenario.parts if n not in gone], progress, there)
    motions = {name: table.motion for name, table in scenario.parts.items() if table.motion}
    motions = {name: path for name, path in motions.items() if name not in gone}
    if motion is not None:
        motions[moved_part(made)] = motion
    parts: dict[str, Part] = {}
    wires = list(scenario.wires)
    for name, part in made.items():
        if name in motions:
            companion = f"{name}.motion"
            parts[companion] = ReplayPart(
                companion, {"replay": str(there.get(str(motions[name]), motions[name]))}, seed=0
            )
            _check_takes_motion(name, part)
            wires.append(Wire(f"{companion}.recorded*", f"{name}.recorded*"))
        parts[name] = part
        parts |= getattr(part, "companions", {})
    wires, crossing = cross(wires, parts, gone)
    wires, problems = tapped(wires, parts, scenario.faults)
    wiring = connect(where, parts, wires)
    changes = [*scenario.changes, *(c for fault in scenario.faults for c in fault.changes())]
    events = events_of(changes, parts, wiring.undriven, scenario.step, problems)
    if problems:
        raise ProblemsError(where, problems)
    seconds, notes = _duration(scenario, parts)
    columns = [f"{name}.{port.name}" for name, part in parts.items() for port in part.outputs]
    return System(
        scenario=scenario,
        parts=parts,
        wiring=wiring,
        step_limits={name: scenario.parts[_owner(name, scenario)].step_limit for name in parts},
        roles=roles(scenario, columns),
        motions=motions,
        steps=max(1, int(seconds / scenario.step + 1e-6)),
        notes=(*notes, *crossing, *_silent_estimators(scenario, columns), *wiring.notes),
        events=events,
    )


def _with_fault_parts(scenario: Scenario) -> Scenario:
    """A scenario with the parts that go into its wires."""
    settings: dict[str, dict[str, Any]] = {}
    for fault in scenario.faults:
        table = settings.setdefault(fault.part, {"fmu": MODEL})
        if fault.at == 0.0:
            table |= fault.settings
    added = {name: PartTable("fmu", table, 10.0, None) for name, table in settings.items()}
    return replace(scenario, parts={**scenario.parts, **added})


def absent(scenario: Scenario) -> frozenset[str]:
    """Parts that are at the other end of a bus: those that a part there `replaces`."""
    names = tuple(scenario.parts)
    return frozenset(
        name
        for table in scenario.parts.values()
        if table.kind == "can"
        for name in matching(names, table.settings.get("replaces", ()))
    )


def _owner(name: str, scenario: Scenario) -> str:
    """Part that a recording moves; any other part's own name."""
    return name if name in scenario.parts else name.rpartition(".")[0]


def _make(
    scenario: Scenario,
    names: Sequence[str],
    progress: Callable[[str], None],
    files: Mapping[str, Path],
) -> dict[str, Part]:
    known = kinds()
    wanted = {name: placed(scenario.parts[name], files) for name in names}
    classes = {kind: known[kind].load() for kind in {t.kind for t in wanted.values()}}
    settings: dict[str, Settings] = {}
    for kind, part_class in classes.items():
        tables = {n: t.settings for n, t in wanted.items() if t.kind == kind}
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
    """How a part's setting names a file, or a model that is built in some flavour."""
    text = str(table.settings[key])
    if key == "fmu" and not is_path(text):
        return f"{table.settings.get('flavour', 'native')} {text}"
    return text


def placed(table: PartTable, files: Mapping[str, Path]) -> PartTable:
    """A table with other files in the place of those that it names."""
    found = {
        key: str(files[reference(table, key)])
        for key in (table.kind, "parameters")
        if key in table.settings and reference(table, key) in files
    }
    return replace(table, settings={**table.settings, **found}) if found else table


def moved_part(parts: Mapping[str, Part]) -> str:
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
    if seconds - scenario.settle < SHORTEST:
        notes.append(
            f"no figures of merit: 'settle' = {scenario.settle:g} s leaves less than "
            f"{SHORTEST:g} s of {seconds:g} s"
        )
    return seconds, notes


def _silent_estimators(scenario: Scenario, columns: Sequence[str]) -> list[str]:
    return [
        f"no NIS of '{name}', whose 'innovation_size' is {table.innovation_size}: it has no output "
        f"'{SQUARED}'"
        for name, table in scenario.parts.items()
        if table.innovation_size is not None and f"{name}.{SQUARED}" not in columns
    ]


def roles(scenario: Scenario, columns: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Which columns play which role of the scenario's `signals`.

    A role is left out where the parts that would play it are at the other end of a bus.

    Raises:
        ProblemsError: no column fits, or too many or too few do.
    """
    found: dict[str, tuple[str, ...]] = {}
    gone = tuple(absent(scenario))
    problems: list[str] = []
    for role, patterns in scenario.signals:
        if patterns is None:
            continue
        names = matching(columns, patterns)
        wanted = _COUNTS.get(role)
        heads = [
            p.partition(".")[0] for p in ([patterns] if isinstance(patterns, str) else patterns)
        ]
        if not names and matching(tuple(gone), heads):
            continue
        if not names:
            problems.append(
                f"signals.{role} = {patterns!r}: no output fits; {nearest(str(patterns), columns)}"
            )
        elif wanted is not None and len(names) != wanted:
            problems.append(
                f"signals.{role} = {patterns!r} has to name {wanted} outputs, "
                f"it names {len(names)}: {', '.join(names)}"
            )
        else:
            found[role] = names
    if problems:
        raise ProblemsError(scenario.name, problems)
    return found
