"""The commands `steadytip hil` and `steadytip board`."""

from __future__ import annotations

import contextlib
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from harness.cli.options import Overrides, Recording, ScenarioName, console, errors

if TYPE_CHECKING:
    from harness.results.result import Result

__all__ = ["board", "hil", "replay"]


_Faults = Annotated[
    list[str] | None,
    typer.Option("--fault", help="What goes wrong at the emulated board: drop:0.01, silence@2-3"),
]
_FaultSeed = Annotated[int, typer.Option(help="Seed of chance in the faults.")]
_Interface = Annotated[str | None, typer.Option(help="Interface of python-can.")]
_Channel = Annotated[str | None, typer.Option(help="Channel of that interface.")]


def hil(
    scenario: ScenarioName,
    motion: Recording = None,
    override: Overrides = None,
    seconds: Annotated[float | None, typer.Option(help="Length of the run [s].")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all randomness of the run.")] = None,
    interface: _Interface = None,
    channel: _Channel = None,
    board: Annotated[
        str | None, typer.Option(help="Emulated board: python, c, or none for a real one.")
    ] = None,
    fault: _Faults = None,
    fault_seed: _FaultSeed = 0,
    monitor: Annotated[
        bool, typer.Option("--monitor", help="Serve a page on 127.0.0.1 that shows the run.")
    ] = False,
    port: Annotated[int, typer.Option(help="Of that page; 0 for a free one.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; build/runs/SCENARIO/NUMBER by default."),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the signals as CSV, too.")] = False,
    report: Annotated[bool, typer.Option(help="Write the HTML report.")] = True,
    junit: Annotated[
        Path | None,
        typer.Option(
            help="Judge the run by its faults and by hil.limits, and write JUnit XML; exit code 1"
            " if anything is not as it should be.",
            dir_okay=False,
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run a scenario on the wall clock, with boards on a CAN bus where it has any."""
    from harness.cli.console import Display, metrics_table
    from harness.cli.overrides import parse_overrides
    from harness.common.errors import RunError
    from harness.hil.session import hil as run_hil

    if junit is not None:
        # An earlier run's verdict must not be taken for that of one that does not even start.
        with contextlib.suppress(OSError):
            junit.unlink()
    display = Display(console, quiet)
    settings = parse_overrides(override, seconds, seed)
    if board is not None:
        settings["hil.board"] = board
    settings |= _on_bus(scenario, settings, interface, channel)
    failed = False
    try:
        with display.progress() as progress:
            result = run_hil(
                scenario,
                motion=motion,
                overrides=settings,
                out=out,
                faults=fault or (),
                fault_seed=fault_seed,
                monitor=monitor,
                port=port,
                csv=csv,
                report=report,
                status=display.status,
                progress=progress,
            )
    except RunError as ended:
        errors.print(f"[red]{escape(str(ended))}[/red]", highlight=False, soft_wrap=True)
        failed = True
        if ended.result is None:
            if junit is not None:
                _judge(scenario, None, str(ended), junit)
            raise typer.Exit(1) from None
        result = ended.result
    display.show(metrics_table(result.metrics))
    if junit is not None:
        failed = not _judge(scenario, result, "", junit) or failed
    files = {"record": result.file, "report": result.report}
    display.files(**files, **({"junit": junit} if junit is not None else {}))
    if failed:
        raise typer.Exit(1)


def _judge(scenario: str, result: Result | None, why: str, junit: Path) -> bool:
    """Write and say what is not as it should be; whether everything is.

    Args:
        scenario: as it was asked for.
        result: None: it ended before its first tick.
        why: it did.
        junit: file to write.
    """
    from harness.common.junit import write_junit
    from harness.results.limits import judge, never_ran, suite_of

    judged = never_ran(why) if result is None else judge(result)
    seconds = 0.0 if result is None else result.metadata.wall or 0.0
    write_junit(junit, "steadytip hil", [suite_of(Path(scenario).stem, judged, seconds)])
    bad = [each for each in judged if each.failure]
    for each in bad if result is not None else []:
        text = f"{each.group}: {each.failure}"
        errors.print(f"[red]{escape(text)}[/red]", highlight=False, soft_wrap=True)
    return not bad


def board(
    scenario: ScenarioName,
    motion: Recording = None,
    override: Overrides = None,
    interface: _Interface = None,
    channel: _Channel = None,
    fault: _Faults = None,
    fault_seed: _FaultSeed = 0,
    drift: Annotated[float, typer.Option(help="The board's clock is slow by so much [ppm].")] = 0.0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the record; build/runs/SCENARIO/board by default."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="results.parquet of a run: play its sensors in place of the plants."),
    ] = None,
    ring: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Play the instrument's electronics at the other end of a bus, until the loop stops."""
    from harness.can.fault_injection import parse
    from harness.cli.console import metrics_table
    from harness.cli.overrides import parse_overrides
    from harness.common.errors import StoppedError
    from harness.hil.board import play
    from harness.hil.session import READY, WORLD
    from harness.scenario.load import load

    # Ended from outside, it writes its record as after Ctrl-C.
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    settings = parse_overrides(override, None, None)
    checked = load(scenario, settings)

    def say(text: str) -> None:
        print(text, flush=True)

    try:
        result = play(
            checked,
            out or Path("build", "runs", checked.name, WORLD),
            interface=interface,
            channel=channel,
            motion=motion,
            recording=recording,
            faults=[parse(text) for text in fault or ()],
            seed=fault_seed,
            drift=drift * 1e-6,
            priority=checked.hil.priority,
            status=say,
            ready=lambda: say(READY),
            ring=ring,
        )
    except StoppedError as ended:
        sys.exit(str(ended))
    console.print(metrics_table(result.metrics))
    say(f"record: {result.file}")


def replay(
    log: Annotated[Path, typer.Argument(help="frames.log or frames.blf of a run.")],
    scenario: Annotated[
        str | None, typer.Argument(help="That it was; by default what the record beside it says.")
    ] = None,
    override: Overrides = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results; `replay` beside the log by default.")
    ] = None,
    report: Annotated[bool, typer.Option(help="Write the HTML report.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run a log of frames through the loop again; exit code 1 if anything differs."""
    from harness.cli.console import Display
    from harness.cli.overrides import parse_overrides
    from harness.hil.replay import replay as run_replay

    display = Display(console, quiet)
    with display.progress() as progress:
        found = run_replay(
            log,
            scenario,
            overrides=parse_overrides(override, None, None),
            out=out,
            report=report,
            status=display.status,
            progress=progress,
        )
    display.status(f"{found.commands} commands, {found.differing} of them differ")
    if found.signals:
        words = f": {', '.join(found.changed)}" if found.changed else ""
        display.status(f"{found.signals} signals, {len(found.changed)} of them differ{words}")
    display.files(record=found.result.file, report=found.result.report)
    if not found.is_identical:
        raise typer.Exit(1)


def _on_bus(
    scenario: str, settings: dict[str, Any], interface: str | None, channel: str | None
) -> dict[str, Any]:
    """Interface and channel as settings of the part that is on the bus."""
    given = {"interface": interface, "channel": channel}
    if not any(given.values()):
        return {}
    from harness.hil.board import part_on_bus
    from harness.scenario.load import load

    name = part_on_bus(load(scenario, settings))
    return {f"part.{name}.{key}": value for key, value in given.items() if value}
