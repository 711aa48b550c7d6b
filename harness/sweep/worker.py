"""Where a worker runs cases: parts are made once, and used again from run to run.

A case that has its beginning in common with others is run from a saved state: the beginning is
simulated once, its state is saved, and each run goes on from there. Whatever is used again, the
numbers are, bit for bit, those of the run alone.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.errors import SteadytipError
from harness.common.errors import FaultError, ProblemsError, RunError, StoppedError
from harness.loop.segments import run_until
from harness.parts.fmu import FmuPart
from harness.parts.protocols import Part, Restorable, Reusable, RunContext
from harness.parts.settings import FmuSettings
from harness.results.run_metadata import RunMetadata
from harness.scenario.events import Fault
from harness.scenario.load import with_values
from harness.scenario.merge import merge_tables, nest_keys
from harness.scenario.schema import Scenario
from harness.sweep.memory_recorder import MemoryRecorder, wanted
from harness.system.assembly import System, assemble, part_seed, with_files
from harness.system.container import fuse
from harness.system.events import events_of

if TYPE_CHECKING:
    from harness.loop.loop import Checkpoint, LoopOutcome
    from harness.results.metrics import Metric
    from harness.sweep.plan import SweepCase

__all__ = ["FIXED", "LENGTHS", "Base", "CaseRow", "Worker", "with_places"]

_SYSTEMS = 4
"""Systems that are held ready; of one recording each, or of one value of what wires depend on."""
FIXED = frozenset({"flavour", "parameters", "isolate", "step_limit", "motion", "innovation_size"})
"""Settings of an FMU part that are no start values."""
LENGTHS = frozenset({"seconds", "warm_up"})
"""What can differ without another container."""


@dataclass(frozen=True)
class Base:
    """What all runs of a sweep have in common.

    Attributes:
        scenario: that is swept over, with the parts of all faults in their wires.
        files: what stands for the files and models that it names.
        container: the system fused into one FMU; None to run its parts one by one.
    """

    scenario: Scenario
    files: Mapping[str, Path]
    container: Path | None = None


@dataclass(frozen=True)
class CaseRow:
    """What became of a run.

    Attributes:
        number: of the run.
        status: `ok`, `failed`, or `lost` with its worker.
        error: why it is not ok.
        wall: time that it took, start and figures included [s].
        cpu: processor time of the worker's process meanwhile [s].
        metrics: figures of merit by name.
        worn: whether the worker should not be used again.
    """

    number: int
    status: str
    error: str = ""
    wall: float = 0.0
    cpu: float = 0.0
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    worn: bool = False


def with_places(scenario: Scenario, faults: tuple[Fault, ...]) -> Scenario:
    """Put the parts of faults into a scenario's wires, where they do nothing yet."""
    neutral = {fault.part: Fault(wire=fault.wire, kind="gain", value=1.0) for fault in faults}
    return replace(scenario, faults=(*neutral.values(), *scenario.faults), sweep=None)


@dataclass
class _Beginning:
    key: str
    moment: Checkpoint
    states: list[tuple[Restorable, Any]]

    def free(self) -> None:
        for part, state in self.states:
            part.free(state)

    def restore(self) -> None:
        for part, state in self.states:
            part.restore(state)


class _WorkerSystem:
    """A system that is run again and again."""

    def __init__(
        self,
        scenario: Scenario,
        motion: Path | None,
        files: Mapping[str, Path],
        container: Path | None,
    ) -> None:
        self.scenario = scenario
        self.made = assemble(scenario, motion, files=files)
        self.tables = {
            name: with_files(scenario.parts[name], files)
            if name in scenario.parts
            else self.made.scenario.parts[name]
            for name, part in self.made.parts.items()
            if isinstance(part, FmuPart)
        }
        self.system = self.made if container is None else fuse(self.made, container=container)
        # Last: nobody would remove it if what is above failed.
        self._room = tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True)
        self.run = RunContext(scenario.step_size, self.made.steps, Path(self._room.name))
        metadata = RunMetadata(
            step_size=scenario.step_size,
            warm_up=scenario.warm_up,
            roles={role: list(names) for role, names in self.made.roles.items()},
            motions={name: path.name for name, path in self.made.motions.items()},
            parts={name: {} for name in self.made.parts},
            innovation_sizes={
                name: table.innovation_size
                for name, table in scenario.parts.items()
                if table.innovation_size is not None
            },
        )
        parts = self.system.parts.values()
        found = [p for p in parts if isinstance(p, FmuPart) and p.name not in self.made.parts]
        self._container = found[0] if found else None
        if self._container is not None:
            self._container.show(_needed(self.system, self._container))
        self.kept = MemoryRecorder(self.system, metadata)
        self._beginning: _Beginning | None = None
        for part in parts:
            if isinstance(part, Reusable):
                part.kept = True
        self.shares = all(_returns(part) for part in parts)

    def prepare(self, case: SweepCase, light: Mapping[str, Any]) -> None:
        """Give the parts their start values."""
        problems: list[str] = []
        changed = nest_keys(light, problems).get("part", {})
        if case.fault is not None and case.fault.at == 0.0:
            changed = merge_tables(changed, {case.fault.part: case.fault.settings})
        fused: dict[str, Any] = {}
        for name, table in self.tables.items():
            part = self.made.parts[name]
            assert isinstance(part, FmuPart)
            settings = merge_tables(table.settings.table, changed.get(name, {}))
            try:
                part.take(settings, part_seed(case.seed, name))
            except ProblemsError as error:
                problems += [f"{error.where}: {text}" for text in error.problems]
            if name not in self.system.parts:
                for key, value in part.start_values.items():
                    if not isinstance(value, str):
                        fused[self.system.place(name, key)[1]] = value
        if problems:
            raise ProblemsError(self.scenario.name, problems)
        if self._container is not None:
            self._container.start_values = fused

    def go(self, case: SweepCase) -> LoopOutcome:
        """Run, from a saved state where there is one."""
        problems: list[str] = []
        unconnected, parts, step = (
            self.made.wiring.unconnected,
            self.made.parts,
            self.scenario.step_size,
        )
        own = events_of(case.all_changes, parts, unconnected, step, problems)
        if problems:
            raise ProblemsError(self.scenario.name, problems)
        given = self.system.events
        events = sorted([*given, *own], key=lambda event: event.tick)
        begun = self._begun(case.shared) if self.shares else None
        since = begun.moment if begun is not None else None
        first = min((event.tick for event in own), default=self.run.steps)
        leaves = case.shared is not None and self.shares and first < self.run.steps
        if leaves and (since is None or since.tick < first):
            outcome, since = self._proceed(given, since, first)
            if outcome.error is not None:
                return outcome
            begun = self._save(str(case.shared), since)
        if begun is None:
            self._forget()
        return self._proceed(events, since)[0]

    def _proceed(
        self, events: Any, since: Checkpoint | None, until: int | None = None
    ) -> tuple[LoopOutcome, Checkpoint | None]:
        self.kept.ticks = since.tick if since is not None else 0
        return run_until(self.system, self.run, self.kept, events, since, until)

    def _begun(self, key: str | None) -> _Beginning | None:
        if key is None or self._beginning is None or self._beginning.key != key:
            return None
        self._beginning.restore()
        return self._beginning

    def _save(self, key: str, moment: Checkpoint | None) -> _Beginning:
        assert moment is not None
        self._forget()
        parts = [part for part in self.system.parts.values() if isinstance(part, Restorable)]
        self._beginning = _Beginning(key, moment, [(part, part.save()) for part in parts])
        return self._beginning

    def _forget(self) -> None:
        if self._beginning is not None:
            self._beginning.free()
            self._beginning = None

    @property
    def worn(self) -> bool:
        """True if a part is in a state that nobody should go on from."""
        parts = self.system.parts.values()
        return any(isinstance(part, FmuPart) and part.worn for part in parts)

    def close(self) -> None:
        self._forget()
        for part in self.system.parts.values():
            with contextlib.suppress(FaultError):
                part.release() if isinstance(part, Reusable) else part.close()
        self.abandon()

    def abandon(self) -> None:
        """Remove the files alone: nothing is freed while a part is in it."""
        self._room.cleanup()


def _needed(system: System, container: FmuPart) -> set[str]:
    """Return outputs of a container that figures of merit or parts beside it need.

    It is an FMU of our own, which itself refuses to give anything that is not finite: nothing
    goes unnoticed in the others.
    """
    kept = wanted(system)
    links = {link.source.port for link in system.wiring.links if link.source.part == container.name}
    names = {port.name: f"{container.name}.{port.name}" for port in container.outputs}
    found = {port for port, name in names.items() if system.names.get(name, name) in kept} | links
    return found or {container.outputs[0].name}


def _returns(part: Part) -> bool:
    if not (isinstance(part, Reusable) and part.can_pause()):
        return False
    return part.prepare_to_return() if isinstance(part, Restorable) else True


class Worker:
    """Runs cases one after the other, in one thread."""

    def __init__(self, base: Base) -> None:
        """Begin with nothing made.

        Args:
            base: what all runs have in common.
        """
        self._base = base
        self._rigs: OrderedDict[str, _WorkerSystem] = OrderedDict()

    def perform(self, case: SweepCase) -> CaseRow:
        """Run a case; whatever is wrong with it is in the row."""
        begun, before = time.perf_counter(), time.process_time()

        def row(status: str, error: str = "", **more: Any) -> CaseRow:
            wall, cpu = time.perf_counter() - begun, time.process_time() - before
            return CaseRow(case.number, status, error, wall, cpu, **more)

        rig = None
        try:
            heavy, light = self._split(case)
            rig = self._rig(case.motion, heavy)
            rig.prepare(case, light)
            outcome = rig.go(case)
            if outcome.error is not None:
                raise outcome.error
            return row("ok", metrics=rig.kept.metrics())
        except StoppedError:
            # Of the sweep, which runs in this very process: not of one run only.
            raise KeyboardInterrupt from None
        except RunError as error:
            hanging = _hanging()
            if rig is not None and (hanging or rig.worn):
                # What a part has been through is not to show in the next run.
                self._rigs = OrderedDict((k, r) for k, r in self._rigs.items() if r is not rig)
                rig.abandon() if hanging else rig.close()
            return row("failed", str(error), worn=hanging)
        except SteadytipError as error:
            return row("failed", str(error))

    def _split(self, case: SweepCase) -> tuple[dict[str, Any], dict[str, Any]]:
        """Values that make another system, and start values of FMUs."""
        heavy: dict[str, Any] = {}
        light: dict[str, Any] = {}
        for key, value in case.values.items():
            start = is_start_value(self._base.scenario, key)
            (light if start else heavy)[key] = value
        return heavy, light

    def _rig(self, motion: str | None, heavy: Mapping[str, Any]) -> _WorkerSystem:
        key = json.dumps([motion, dict(heavy)], sort_keys=True)
        if key in self._rigs:
            self._rigs.move_to_end(key)
            return self._rigs[key]
        scenario = self._base.scenario
        if heavy:
            faults = scenario.faults
            scenario = replace(with_values(scenario, heavy), faults=faults, sweep=None)
        while len(self._rigs) >= _SYSTEMS:
            self._rigs.popitem(last=False)[1].close()
        fusable = heavy.keys() <= LENGTHS
        self._rigs[key] = _WorkerSystem(
            scenario,
            Path(motion) if motion else None,
            self._base.files,
            self._base.container if fusable else None,
        )
        return self._rigs[key]

    def close(self) -> None:
        """Free everything."""
        while self._rigs:
            self._rigs.popitem()[1].close()


def is_start_value(scenario: Scenario, key: str) -> bool:
    """Return whether a key names a start value of an FMU, which leaves the system as it is."""
    found = scenario.part_setting(key)
    if found is None or not isinstance(scenario.parts[found.part].settings, FmuSettings):
        return False
    return found.port not in {"", "fmu", *FIXED}


def _hanging() -> bool:
    """Return whether a loop has not come back from a part."""
    loops = [each for each in threading.enumerate() if each.name == "steadytip-loop"]
    for each in loops:
        each.join(1.0)
    return any(each.is_alive() for each in loops)
