"""The command `steadytip`.

Exit codes: 0 all went well, 1 a run ended early or a check found problems, 2 the user's mistake.
Everything heavy is imported by the command that needs it, so that `--help` comes at once.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from harness.analyze.cli import analyze
from harness.bench.cli import bench
from harness.hil.cli import board, hil, replay
from harness.identify.cli import app as identify
from harness.reproduce.cli import reproduce
from harness.ssp.cli import app as ssp
from harness.sweep.cli import sweep

app = typer.Typer(
    help="Tremor-cancelling handheld microsurgery as FMI 2.0 co-simulation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(ssp, name="ssp")
app.add_typer(identify, name="identify")
app.command()(reproduce)
app.command()(analyze)
app.command()(bench)
app.command()(hil)
app.command()(board)
app.command()(replay)
app.command()(sweep)
_console = Console()
_errors = Console(stderr=True)

_Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", help="Replace a value of the scenario: part.hand.seed=3"),
]
_Seconds = Annotated[float | None, typer.Option(help="Simulated time [s].")]
_Seed = Annotated[int | None, typer.Option(help="Seed of all randomness of the run.")]
_Scenario = Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")]
_Recording = Annotated[Path | None, typer.Option(help="Recording of hand motion to replay.")]


def main() -> None:
    """Run the command; mistakes of the user are printed without a traceback."""
    try:
        app()
    except Exception as error:
        from fmu_src.kit import SteadytipError

        if not isinstance(error, SteadytipError):
            raise
        _errors.print(f"[red]{escape(str(error))}[/red]", highlight=False, soft_wrap=True)
        sys.exit(2)


def _print_version(wanted: bool) -> None:
    if wanted:
        from fmu_src import __version__

        _console.print(__version__, highlight=False)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


@app.command()
def run(
    scenario: _Scenario,
    motion: Annotated[
        list[Path] | None,
        typer.Option(help="Recording of hand motion to replay, or a folder of them; one run each."),
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(help="Variant of the scenario; all of them by default, where it has any."),
    ] = None,
    override: _Overrides = None,
    seconds: _Seconds = None,
    seed: _Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results; build/runs/SCENARIO[-VARIANT][-RECORDING] by default."
        ),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the signals as CSV, too.")] = False,
    report: Annotated[
        bool | None, typer.Option(help="Write the HTML report; if left out, not of variants.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write what variants reach as JSON.")] = None,
    fuse: Annotated[
        bool, typer.Option("--fuse", help="Run the models as one native FMU: same numbers, faster.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run a scenario: build what is missing, record, measure, report; compare its variants."""
    from harness.comparison import ranks
    from harness.console import Display, comparison_table, metrics_table, ranking_table
    from harness.errors import RunError, SteadytipError
    from harness.parts.recording import recordings
    from harness.runs import run as run_scenario
    from harness.scenario import load
    from harness.settings import overrides

    display = Display(_console, quiet)
    settings = overrides(override, seconds, seed)
    motions: list[Path | None] = [*recordings(motion)] if motion else [None]
    variants: list[str | None] = [*(variant or load(scenario, settings).variants)] or [None]
    if json is not None and variants == [None]:
        raise SteadytipError(f"--json {json}: {scenario} has no variants to compare")
    todo = [(each, path) for each in variants for path in motions]
    results: dict[str, Any] = {}
    compared: dict[str, list[Any]] = {each: [] for each in variants if each is not None}
    failed = False
    for each, path in todo:
        words = [text for text in (each, path.stem if path else None) if text is not None]
        if each is not None:
            display.status(", ".join(words))
        try:
            with display.progress() as progress:
                result = run_scenario(
                    scenario,
                    motion=path,
                    overrides=settings,
                    variant=each,
                    out=out / "-".join(words) if out and len(todo) > 1 else out,
                    csv=csv,
                    report=each is None if report is None else report,
                    fuse=fuse,
                    status=display.status if each is None else lambda _: None,
                    progress=progress,
                )
        except RunError as ended:
            failed = True
            _errors.print(f"[red]{escape(str(ended))}[/red]", highlight=False, soft_wrap=True)
            if ended.result is None:
                continue
            result = ended.result
        else:
            # A part of a run is not to be ranked beside whole ones.
            if each is not None:
                compared[each].append(result.metrics)
        results["-".join(words) or scenario] = result.metrics
        if len(todo) == 1:
            display.show(metrics_table(result.metrics))
            for each_estimator in result.consistency:
                display.status(each_estimator.sentence)
        display.files(record=result.file, report=result.report)
    found = ranks(compared)
    if json is not None:
        from harness.reproduce.run import write_figures

        write_figures(json, [figure for rank in found for figure in rank.figures(scenario)])
    if compared and len(todo) > 1:
        display.show(ranking_table(found))
    elif len(todo) > 1:
        display.show(comparison_table(results))
    if failed:
        raise typer.Exit(1)


@app.command()
def build(
    models: Annotated[list[str] | None, typer.Argument(help="Models; all by default.")] = None,
    flavour: Annotated[str, typer.Option(help="native or python.")] = "native",
    out: Annotated[Path | None, typer.Option(help="Folder of the FMUs.")] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            help="Platforms of native FMUs: linux64, aarch64-linux, win64, darwin64,"
            " aarch64-darwin, or all; this one by default."
        ),
    ] = None,
    container: Annotated[
        str | None,
        typer.Option(metavar="SCENARIO", help="Fuse a scenario's parts and wires into one FMU."),
    ] = None,
    parts: Annotated[
        str | None, typer.Option(help="Parts to fuse, a,b,c; all of the scenario by default.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the fused FMU; SCENARIO_PARTS by default.")
    ] = None,
    override: _Overrides = None,
) -> None:
    """Build FMUs from the models, or one FMU from several of a scenario's parts."""
    from fmu_src import pack
    from harness.errors import SteadytipError

    def progress(text: str) -> None:
        _console.print(f"building {text}", style="dim", highlight=False)

    if container is None:
        if parts or name or override:
            raise SteadytipError(
                "--parts, --name and --set are for a container: --container SCENARIO"
            )
        paths = [*pack.build(models or None, flavour, out, progress, target).values()]
    else:
        if models or flavour != "native":
            raise SteadytipError(
                f"--container {container} fuses parts of a scenario into a native FMU: choose them"
                " by --parts, and leave models and --flavour out"
            )
        from harness import fused
        from harness.scenario import load
        from harness.settings import overrides
        from harness.system import assemble

        system = assemble(load(container, overrides(override, None, None)))
        wanted = parts.replace(" ", "").split(",") if parts else None
        paths = [fused.build(system, wanted, name, out, target, progress)]
    for path in paths:
        _console.print(str(path), highlight=False, soft_wrap=True)


@app.command()
def validate(
    fmus: Annotated[list[Path], typer.Argument(metavar="FMU...", help="FMU files, anybody's.")],
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML for CI.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write all that was found as JSON.")] = None,
    timeout: Annotated[
        float, typer.Option(min=1.0, help="Wall-clock time for each probe of the running FMU [s].")
    ] = 60.0,
) -> None:
    """Check FMUs against the checklist of a drop-in FMU, each probe in a process of its own."""
    from harness.errors import ProblemsError
    from harness.validation import reports
    from harness.validation.verdict import validate as check

    missing = [f"{path} does not exist" for path in fmus if not path.is_file()]
    if missing:
        raise ProblemsError("validate", missing)
    verdicts = []
    for path in fmus:
        with _console.status(escape(path.name)) as status:

            def show(done: int, count: int, id: str, name: str = path.name) -> None:
                status.update(escape(f"{name}: {done} of {count} checks, {id}"))

            verdicts.append(check(path, timeout=timeout, progress=show))
        _console.print(reports.table(verdicts[-1]))
    if junit is not None:
        reports.write_junit(junit, verdicts)
    if json is not None:
        reports.write_json(json, verdicts)
    if not all(verdict.good for verdict in verdicts):
        raise typer.Exit(1)


@app.command()
def convert(
    run: Annotated[Path, typer.Argument(help="Folder of a run, or its results.parquet.")],
    out: Annotated[Path | None, typer.Option(help="Folder of the files; that of the run.")] = None,
) -> None:
    """Write a run's signals, and the frames of its log, as MF4 for other tools."""
    from harness.convert import convert as write

    with _console.status("writing MF4"):
        paths = write(run, out)
    for path in paths:
        _console.print(str(path), highlight=False, soft_wrap=True)


@app.command()
def info(
    what: Annotated[str, typer.Argument(metavar="SCENARIO|FMU", help="A scenario or an FMU file.")],
    motion: _Recording = None,
    override: _Overrides = None,
) -> None:
    """Show the inside of a scenario or of an FMU."""
    from harness.console import fmu_table, system_tables

    if what.endswith(".fmu"):
        from harness.parts.description import describe

        blocks = fmu_table(describe(Path(what)))
    else:
        from harness.scenario import load
        from harness.settings import overrides
        from harness.system import assemble

        blocks = system_tables(assemble(load(what, overrides(override, None, None)), motion))
    for block in blocks:
        _console.print(block, highlight=False)
