"""One run from scenario to report."""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import fmu_src
from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError, RunError, StoppedError
from harness.common.files import reason
from harness.loop.loop import Loop, LoopOutcome, Progress, RealTimeClock
from harness.loop.segments import run_segments
from harness.parts.protocols import RunContext
from harness.recordings.motion import motion_columns
from harness.recordings.run_record import record_file
from harness.results.folders import claim, new_folder
from harness.results.recorder import Recorder
from harness.results.result import Result
from harness.results.run_metadata import VERSION, RunMetadata
from harness.scenario import load as scenarios
from harness.scenario.replaced import is_on_bus
from harness.system.assembly import System, assemble

if TYPE_CHECKING:
    import pyarrow as pa

    from harness.common.types import FloatArray

__all__ = ["HilSession", "metadata_of", "perform", "run", "run_folder"]

_VERSIONS = ("fmpy", "numpy", "scipy", "pyarrow", "plotly")


class HilSession(Protocol):
    """What there is beside a loop that keeps to the wall clock."""

    @property
    def clock(self) -> RealTimeClock:
        """Clock of the ticks."""

    @property
    def observe(self) -> Callable[[FloatArray], None] | None:
        """Takes the signals of every tick."""

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        """End everything else now that the loop has ended.

        Returns:
            More metadata of the run, JSON types only.
        """

    def extra_columns(self) -> tuple[pa.Table | None, dict[str, Any]]:
        """More columns of the record, a row for each tick, and metadata that follow from them."""


def run(
    scenario: str | os.PathLike[str],
    *,
    motion: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    variant: str | None = None,
    out: str | os.PathLike[str] | None = None,
    accept: Collection[str] = (),
    repair: Collection[str] = (),
    columns: Mapping[str, Any] | None = None,
    csv: bool = False,
    report: bool = True,
    fuse: bool = False,
    status: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _done, _seconds: None,
) -> Result:
    """Run a scenario and write its record, metrics and report.

    Args:
        scenario: path of a scenario file, or the name of a shipped one.
        motion: recording for the one part that takes one.
        overrides: values by dotted key, put in place of the scenario's, `{"part.hand.seed": 3}`.
        variant: which of the scenario's variants.
        out: folder for the results, whose record of before is replaced; by default a new one,
            `build/runs/SCENARIO[-VARIANT][-RECORDING]/NUMBER`.
        accept: names of findings about recordings to go on with, as `glitch`.
        repair: names of findings about recordings to repair, as `glitch`.
        columns: what `motion` does not say of itself, `{"time_unit": "ms", "x": "px"}`; see
            `docs/recordings.md`.
        csv: write the signals as CSV, too.
        report: write `report.html`.
        fuse: run what can be fused as one FMU; see `harness.system.container`.
        status: told in a few words what is being done.
        progress: told simulated time done and in all [s], some times a second.

    Raises:
        RunError: the run ended early; its `result` holds what was recorded until then.
        FindingsError: the recording has defects that make figures meaningless; nothing was run.
        SteadytipError: a mistake in the scenario, the recording, or an FMU; nothing was run.
    """
    checked = scenarios.load(scenario, overrides, variant)
    recording = Path(motion) if motion is not None else None
    read_as = motion_columns(columns) if columns else None
    system = assemble(checked, recording, status, None, accept, repair, read_as)
    on_bus = [name for name, table in checked.parts.items() if is_on_bus(table)]
    if on_bus:
        raise SteadytipError(
            f"{', '.join(on_bus)} in {checked.name} is on a CAN bus, which keeps to the wall "
            f"clock: steadytip hil {checked.name}"
        )
    if fuse:
        from harness.system import container as fused

        system = fused.fuse(system, lambda name: status(f"building {name}"))
    folder = run_folder(system, out)
    return perform(system, folder, csv=csv, report=report, status=status, progress=progress)


def perform(
    system: System,
    folder: Path,
    *,
    session: HilSession | None = None,
    csv: bool = False,
    report: bool = True,
    status: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _done, _seconds: None,
) -> Result:
    """Run a system and write its record, metrics and report.

    Args:
        system: parts and their wiring.
        folder: for the results.
        session: what there is beside the loop: the wall clock, a board.
        csv: write the signals as CSV, too.
        report: write `report.html`.
        status: told in a few words what is being done.
        progress: told simulated time done and in all [s], some times a second.

    Raises:
        RunError: the run ended early; its `result` holds what was recorded until then.
    """
    if session is not None and system.events:
        raise SteadytipError(
            f"{system.scenario.name}: 'change' and 'fault' in the middle of a run are not for the "
            "wall clock; take them out"
        )
    with claim(folder):
        return _perform(system, folder, session, csv, report, status, progress)


def _perform(
    system: System,
    folder: Path,
    session: HilSession | None,
    csv: bool,
    report: bool,
    status: Callable[[str], None],
    progress: Progress,
) -> Result:
    for note in system.notes:
        status(note)
    for name, found in system.findings.items():
        for finding in found:
            status(f"{name}: {finding.sentence}")
    metadata = metadata_of(system)
    step = system.scenario.step_size
    recorder = Recorder(folder, system.columns, step, metadata, patient=session is None)
    with tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True) as workspace:
        once = RunContext(step, system.steps, Path(workspace))
        if session is None:
            outcome = run_segments(system, once, recorder, progress)
        else:
            outcome = Loop(system, once, recorder, session.clock, session.observe).go(progress)
    if session is not None:
        status("closing")
        metadata = metadata.model_copy(update=session.closed(outcome))
    if outcome.ticks == 0:
        recorder.discard()
        early = outcome.error or StoppedError("stopped before the first tick")
        early.args = (". ".join((str(early), *(metadata.hil or {}).get("notes", ()))),)
        raise early
    metadata = metadata.model_copy(
        update={
            "wall": outcome.wall,
            "ticks": outcome.ticks,
            "error": str(outcome.error) if outcome.error else None,
            "notes": [*metadata.notes, *outcome.warnings],
        }
    )
    for warning in outcome.warnings:
        status(warning)
    error: RunError | None = outcome.error
    try:
        extra = None
        if session is not None:
            recorder.close()
            extra, more = session.extra_columns()
            metadata = metadata.model_copy(update=more)
        result = Result(recorder.finish(metadata, csv, extra))
        if not isinstance(error, RecordError):
            _write(result, status, report)
    except RecordError as trouble:
        error, result = error or trouble, Result(record_file(folder))
    except OSError as trouble:
        text = f"{trouble.filename}: {reason(trouble)}. The record is complete in {result.file}."
        error = error or RecordError(text)
    if error is not None:
        error.result = result
        raise error
    return result


def _write(result: Result, status: Callable[[str], None], report: bool) -> None:
    status("metrics")
    result.write_metrics()
    if report:
        from harness.report.run_report import write_report

        status("report")
        write_report(result)


def run_folder(system: System, out: str | os.PathLike[str] | None) -> Path:
    """Return the folder that is wanted, or a new one of this run alone.

    The new one is `build/runs/SCENARIO[-VARIANT][-RECORDING]/NUMBER` below the current directory.

    Raises:
        RecordError: it cannot be made.
    """
    if out is not None:
        return Path(out)
    scenario = system.scenario
    parts = [scenario.name, scenario.variant, *(path.stem for path in system.motions.values())]
    base = Path("build", "runs", "-".join(part for part in parts if part))
    try:
        return new_folder(base)
    except OSError as error:
        raise RecordError(f"cannot record below {base}: {reason(error)}") from None


def metadata_of(system: System) -> RunMetadata:
    """Return what is needed to repeat a run and to read its results."""
    if system.unfused is not None:
        return metadata_of(system.unfused).model_copy(update={"fused": True})
    scenario = system.scenario
    return RunMetadata(
        version=VERSION,
        scenario=scenario.name,
        scenario_file=scenario.given,
        title=scenario.title,
        variant=scenario.variant,
        step_size=scenario.step_size,
        steps=system.steps,
        warm_up=scenario.warm_up,
        seed=scenario.seed,
        texts=list(scenario.texts),
        overrides=dict(scenario.overrides),
        motions={name: path.name for name, path in system.motions.items()},
        innovation_sizes={
            name: table.innovation_size
            for name, table in scenario.parts.items()
            if table.innovation_size is not None
        },
        roles={role: list(names) for role, names in system.roles.items()},
        order=list(system.wiring.order),
        delays={str(link.source): link.delay for link in system.wiring.links if link.delay},
        unconnected=list(system.wiring.unconnected),
        events=[
            {
                "time": event.tick * scenario.step_size,
                "part": event.part,
                "values": dict(event.values),
            }
            for event in system.events
        ],
        notes=list(system.notes),
        findings=[
            {"part": name, **asdict(finding)}
            for name, found in system.findings.items()
            for finding in found
        ],
        parts={name: part.metadata() for name, part in system.parts.items()},
        versions={
            "steadytip": fmu_src.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _VERSIONS},
        },
        machine=f"{platform.system()} {platform.machine()}",
    )
