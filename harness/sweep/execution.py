"""A sweep from scenario to table and page."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import fmu_src
from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError, RunError, StoppedError, nearest
from harness.parts.fmu import FmuPart
from harness.recordings.motion import recordings
from harness.scenario import load as scenarios
from harness.scenario.replaced import is_on_bus
from harness.scenario.schema import Scenario
from harness.sweep.command import command_of
from harness.sweep.executors import Executor, InlineExecutor, ProcessExecutor
from harness.sweep.outcome import SweepResult, numeric, write_parquet
from harness.sweep.plan import Queue, SweepCase, SweepPlan, groups_of, value_on
from harness.sweep.store import Store
from harness.sweep.worker import FIXED, LENGTHS, Base, with_places
from harness.system.assembly import System, assemble, reference
from harness.system.events import trouble_of

__all__ = ["Prepared", "default_folder", "prepare", "sweep"]

_LOOK = 0.2  # s between two looks of the sweep at whether the user wants an end
_VERSIONS = ("numpy", "scipy", "pyarrow", "plotly")
Progress = Callable[[int, int, int], None]
"""Told runs done, runs in all, runs that failed."""


@dataclass(frozen=True)
class Prepared:
    """A sweep that is checked and ready to start.

    Attributes:
        scenario: that is swept over.
        plan: its runs.
        base: what they have in common.
        identity: what all numbers follow from.
        metadata: what else is to be known.
    """

    scenario: Scenario
    plan: SweepPlan
    base: Base
    identity: Mapping[str, Any]
    metadata: Mapping[str, Any]


def sweep(
    scenario: str | os.PathLike[str],
    *,
    vary: Mapping[str, Any] | None = None,
    method: str | None = None,
    runs: int | None = None,
    seed: int | None = None,
    seeds: int | Sequence[int] | None = None,
    motions: Sequence[str | os.PathLike[str]] | None = None,
    overrides: Mapping[str, Any] | None = None,
    variant: str | None = None,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    timeout: float | None = None,
    fuse: bool = True,
    fresh: bool = False,
    page: bool = True,
    status: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _done, _runs, _failed: None,
) -> SweepResult:
    """Run a sweep, or go on with one that was interrupted, and write its table and page.

    Processes are started: in a script, call it below `if __name__ == "__main__":`.

    Args:
        scenario: path of a scenario file, or the name of a shipped one.
        vary: what is said of variables by key, beside or instead of the scenario's `[sweep.vary]`.
        method: `grid`, `latin-hypercube` or `monte-carlo`, instead of the scenario's.
        runs: how many, instead of the scenario's.
        seed: of the sweep, instead of the scenario's.
        seeds: of the scenario, how many or which, instead of those that it says.
        motions: recordings and folders, instead of the scenario's.
        overrides: values by dotted key, put in place of the scenario's, in all runs.
        variant: which of the scenario's variants.
        out: folder of the results; `build/sweeps/SCENARIO[-VARIANT]` by default.
        workers: processes; as many as there are cores by default, 0 for this one.
        scheduler: address of a Dask scheduler whose workers run the cases, in place of processes.
        timeout: wall-clock time that a run may take [s].
        fuse: run what can be fused as one FMU: the same numbers, sooner.
        fresh: start over, whatever there is of an earlier start.
        page: write `sweep.html`.
        status: told in a few words what is being done.
        progress: told runs done, runs in all and runs that failed, some times a second.

    Returns:
        The sweep; runs that failed are in its table, with their errors, and in `failed`.

    Raises:
        StoppedError: the user stopped it; what was finished is kept, and the same call goes on.
        RecordError: the disk does not take it; as above.
        SteadytipError: a mistake in scenario or sweep, or in what it would go on with.
    """
    said: dict[str, Any] = {
        "method": method,
        "runs": runs,
        "seed": seed,
        "seeds": list(seeds) if isinstance(seeds, Sequence) else seeds,
        "motions": [str(Path(path).resolve()) for path in motions] if motions else None,
        "timeout": timeout,
        "vary": dict(vary) if vary else None,
    }
    settings = {f"sweep.{key}": value for key, value in said.items() if value is not None}
    prepared = prepare(scenario, {**(overrides or {}), **settings}, variant, fuse, status)
    folder = Path(out) if out is not None else default_folder(prepared.scenario)
    store = Store(folder, prepared.identity, prepared.metadata, fresh)
    try:
        _run(prepared, store, workers, scheduler, status, progress)
    except RunError:
        store.close()
        # What there is, as a table; what stopped the sweep is told first.
        with contextlib.suppress(RunError):
            write_parquet(folder, prepared.metadata)
        raise
    finally:
        store.close()
    write_parquet(folder, prepared.metadata)
    found = SweepResult(folder)
    if page:
        from harness.sweep.page import write_page

        status("page")
        write_page(found)
    return found


def default_folder(scenario: Scenario) -> Path:
    """`build/sweeps/SCENARIO[-VARIANT]` below the current directory."""
    return Path("build", "sweeps", "-".join(p for p in (scenario.name, scenario.variant) if p))


def prepare(
    scenario: str | os.PathLike[str],
    overrides: Mapping[str, Any],
    variant: str | None = None,
    fuse: bool = True,
    status: Callable[[str], None] = lambda _: None,
) -> Prepared:
    """Check a sweep, build what it needs.

    Raises:
        SteadytipError: everything that is wrong with scenario or sweep.
    """
    checked = scenarios.load(scenario, overrides, variant)
    table = checked.sweep
    if table is None:
        raise SteadytipError(
            f"{checked.name} says nothing of a sweep: give --vary KEY=VALUES, or add [sweep] to it"
        )
    plan = SweepPlan(checked, table, recordings([Path(m) for m in table.motions]))
    common = with_places(checked, plan.faults)
    first = Path(plan.motions[0]) if plan.motions else None
    system = assemble(common, first, status)
    on_bus = [name for name, table in checked.parts.items() if is_on_bus(table)]
    problems = [f"part '{name}' keeps to the wall clock: no sweep" for name in on_bus]
    problems += _wrong_keys(plan, system)
    if problems:
        raise ProblemsError(checked.name, problems)
    for note in system.notes:
        status(note)
    container = _fused(system, status) if fuse else None
    files = _files(system, plan, status)
    base = Base(common, files, container)
    return Prepared(checked, plan, base, _identity(plan, system, files), _metadata(plan, system))


def _fused(system: System, status: Callable[[str], None]) -> Path | None:
    from harness.system.container import fuse

    try:
        whole = fuse(system, lambda name: status(f"building {name}"))
    except SteadytipError as error:
        status(f"runs part by part: {error}")
        return None
    (name,) = (each for each in whole.parts if each not in system.parts)
    part = whole.parts[name]
    assert isinstance(part, FmuPart)
    return part.description.path.resolve()


def _run(
    prepared: Prepared,
    store: Store,
    workers: int | None,
    scheduler: str | None,
    status: Callable[[str], None],
    progress: Progress,
) -> None:
    plan = prepared.plan
    # What is not well is tried again: a worker may have been killed, a disk full.
    kept = {n for n, how in store.done.items() if how == "ok" and n < len(plan)}
    todo = [number for number in range(len(plan)) if number not in kept]
    if kept:
        status(f"{len(kept)} of {len(plan)} runs are there already")
    if not todo:
        return
    queue = Queue(groups_of(plan, todo))
    limit = prepared.scenario.sweep.timeout if prepared.scenario.sweep else None
    crew: Executor
    if scheduler is not None:
        from harness.sweep.cluster import ClusterExecutor

        crew = ClusterExecutor(scheduler, prepared.base, limit)
    elif workers == 0:
        crew = InlineExecutor(prepared.base)
    else:
        crew = ProcessExecutor(prepared.base, min(workers or os.cpu_count() or 1, len(todo)), limit)
    at_work: dict[int, SweepCase] = {}
    done, failed = len(kept), 0
    try:
        while queue.left or at_work:
            for worker in crew.free():
                # Threads of one worker keep to one beginning.
                given = queue.next(worker.partition("#")[0])
                if given is None:
                    break
                case = plan.case(*given)
                at_work[case.number] = case
                crew.give(worker, case)
            for row in crew.take(_LOOK):
                store.add(row, _case_line(prepared, at_work.pop(row.number)))
                done, failed = done + 1, failed + (row.status != "ok")
            store.force()
            progress(done, len(plan), failed)
    except KeyboardInterrupt:
        raise StoppedError(
            f"stopped by the user: {done} of {len(plan)} runs are in {store.folder}; "
            "the same command goes on from there"
        ) from None
    finally:
        crew.close()


def _case_line(prepared: Prepared, case: SweepCase) -> dict[str, Any]:
    """Return what identifies a run, as the journal keeps it."""
    numbers = {key: about["numeric"] for key, about in prepared.metadata["variables"].items()}
    drawn = {axis: value_on(axis, case) for axis in prepared.plan.axes}
    drawn = {k: float(v) if numbers[k] else _text(v) for k, v in drawn.items()}
    return {
        "seed": case.seed,
        "drawn": drawn,
        "command": command_of(prepared.scenario, case),
    }


def _text(value: Any) -> str:
    from harness.sweep.command import toml

    return value if isinstance(value, str) else toml(value)


# ---- What is checked before the first run, and what numbers follow from --------------------------


def _wrong_keys(plan: SweepPlan, system: System) -> Iterator[str]:
    """Variables that there are not, or that cannot act later."""
    scenario = plan.scenario
    for key, variable in plan.variables.items():
        head, _, rest = key.partition(".")
        found = scenario.part_setting(key)
        where = f"sweep.vary '{key}'"
        if head != "part":
            known = [*LENGTHS, "step_size", "part"]
            if key == "seed":
                yield f"{where}: seeds of the scenario are 'seeds' in [sweep]"
            elif key not in known[:-1]:
                yield f"{where}: no such value can be varied; {nearest(head, known)}"
            elif variable.since is not None:
                yield f"{where}: it cannot act from {variable.since:g} s on"
        elif found is None:
            name = rest.partition(".")[0]
            yield f"{where}: there is no part '{name}'; {nearest(name, scenario.parts)}"
        elif isinstance(part := system.parts.get(found.part), FmuPart):
            setting = found.port
            names = part.description.variables
            bases = {n.split("[")[0] for n, v in names.items() if v.settable} | {*FIXED, "fmu"}
            if setting not in names and setting not in bases:
                yield f"{where}: the FMU has no variable '{setting}'; {nearest(setting, bases)}"
            elif variable.since is not None:
                start = names[setting].start if setting in names else None
                trouble = trouble_of(part, setting, start, system.wiring.unconnected)
                if trouble:
                    yield f"{where} acts from {variable.since:g} s on: {trouble}"


def _files(system: System, plan: SweepPlan, status: Callable[[str], None]) -> dict[str, Path]:
    """Return all files that runs need, by how the scenario names them."""
    found: dict[str, Path] = {}
    for name, table in system.scenario.parts.items():
        part = system.parts.get(name)
        if isinstance(part, FmuPart):
            found[reference(table, "fmu")] = part.description.path.resolve()
        for key, text in table.settings.table.items():
            named = key in table.settings.files and (key != "fmu" or part is None)
            if named and Path(str(text)).is_file():
                found[reference(table, key)] = Path(text).resolve()
    for path in [*system.motions.values(), *map(Path, plan.motions)]:
        found[str(path)] = path.resolve()
    # FMUs that a variable puts in the place of others.
    for key, variable in plan.variables.items():
        place = system.scenario.part_setting(key)
        if place is None or place.port != "fmu":
            continue
        name, table = place.part, system.scenario.parts[place.part]
        for value in variable.listed():
            changed = table.settings.model_copy(update={"fmu": value})
            ready = FmuPart.prepare({name: changed.table}, status)[name]
            path = Path(ready["fmu"])
            if not path.is_file():
                raise SteadytipError(f"sweep.vary '{key}': FMU {path} does not exist")
            found[reference(replace(table, settings=changed), "fmu")] = path.resolve()
    return found


def _identity(plan: SweepPlan, system: System, files: Mapping[str, Path]) -> dict[str, Any]:
    table = {k: v for k, v in plan.scenario.table.items() if k not in {"sweep", "variant", "title"}}
    said = plan.sweep.model_dump(mode="json", exclude={"timeout", "judge"})
    if plan.sweep.design == "monte-carlo":
        said.pop("runs")  # more of them change none of those that are there
    return {
        "scenario": table,
        "sweep": said,
        "file": {name: _digest(path) for name, path in sorted(files.items())},
        "steadytip": fmu_src.__version__,
    }


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _metadata(plan: SweepPlan, system: System) -> dict[str, Any]:
    scenario = plan.scenario
    about: dict[str, Any] = {}
    for axis in plan.axes:
        variable = plan.variables.get(axis)
        said = variable.model_dump(mode="json", exclude_none=True) if variable else {}
        about[axis] = {
            "unit": "" if variable is not None and variable.times else _unit(axis, system),
            "numeric": variable is not None
            and (variable.values is None or numeric(variable.values)),
            "said": said,
        }
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "variant": scenario.variant,
        "method": plan.sweep.design,
        "runs": len(plan),
        "seed": plan.sweep.seed,
        "seeds": plan.seeds,
        "judge": plan.sweep.judge,
        "seconds": scenario.seconds,
        "step": scenario.step_size,
        "warm_up": scenario.warm_up,
        "motions": [Path(path).name for path in plan.motions],
        "texts": [list(text) for text in scenario.texts],
        "overrides": {k: v for k, v in scenario.overrides.items() if k != "sweep.motions"},
        "variables": about,
        "versions": {
            "steadytip": fmu_src.__version__,
            **{name: version(name) for name in _VERSIONS},
        },
    }


def _unit(axis: str, system: System) -> str:
    if axis in LENGTHS or axis == "step_size":
        return "s"
    place = system.scenario.part_setting(axis)
    part = system.parts.get(place.part) if place else None
    if place is None or not isinstance(part, FmuPart):
        return ""
    variables, setting = part.description.variables, place.port
    found = variables.get(setting) or variables.get(f"{setting}[1]")
    return found.unit if found is not None else ""
