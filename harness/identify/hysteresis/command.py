"""`steadytip identify hysteresis`: the operator of an actuator from voltage and displacement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import bar, printed, say

_console = Console()
_DEFAULT = "modulated-stops"


def command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Tables of voltage and displacement (CSV, text, Parquet); one for each stack of"
            " the model, or one for all of them.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The set; build/identify/RECORDING.ssv by default."
        ),
    ] = None,
    operator: Annotated[
        str,
        typer.Option(
            help="What to fit: modulated-stops, prandtl-ishlinskii, rate-dependent or creeping."
        ),
    ] = _DEFAULT,
    model: Annotated[
        str | None,
        typer.Option(
            help="Model that the set is for, as TremorCanceller; the operator's own by default."
        ),
    ] = None,
    fit: Annotated[
        str,
        typer.Option(
            metavar="START:END|SHARE",
            help="Part that is fitted, in seconds or as a share (0.75, 75%); the rest validates."
            " The stack is taken to be at rest at START.",
        ),
    ] = "75%",
    volts: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the voltage, from 1.")
    ] = None,
    displacement: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the displacement.")
    ] = None,
    time: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the time.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Samples in a second, for tables without time."),
    ] = None,
    volts_unit: Annotated[str | None, typer.Option(help="V, mV or kV.")] = None,
    displacement_unit: Annotated[str | None, typer.Option(help="m, mm, um or nm.")] = None,
    time_unit: Annotated[str | None, typer.Option(help="s, ms or us.")] = None,
    gain: Annotated[
        float, typer.Option(help="Of the amplifier, where its input was recorded [V/V].")
    ] = 1.0,
    flip: Annotated[
        bool, typer.Option("--flip", help="The displacement falls while the stack grows.")
    ] = False,
    late: Annotated[
        int,
        typer.Option(
            metavar="ROWS",
            help="Rows by which the displacement is behind the voltage: 1 where a row holds the"
            " voltage that is set at its time.",
        ),
    ] = 0,
    report: Annotated[bool, typer.Option(help="Write the HTML page beside the set.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Hysteresis of an actuator, as a parameter set for any run."""
    import math

    from harness.common.errors import SteadytipError, nearest
    from harness.identify.hysteresis import evaluation as outcome
    from harness.identify.hysteresis.plays import FEWEST_REVERSALS
    from harness.recordings.stack import Choice, read_response

    if operator not in outcome.OPERATORS:
        raise SteadytipError(
            f"--operator {operator}: there is none of that name; "
            f"{nearest(operator, outcome.OPERATORS)}"
        )
    if not (math.isfinite(gain) and gain > 0):
        raise SteadytipError(f"--gain {gain:g}: must be above 0; for a sign there is --flip")
    if out is not None and out.suffix != ".ssv":
        raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
    chosen = outcome.OPERATORS[operator]
    target = model or chosen.model.name
    choice = Choice(
        volts=volts,
        displacement=displacement,
        time=time,
        rate=rate,
        volts_unit=volts_unit,
        displacement_unit=displacement_unit,
        time_unit=time_unit,
        gain=gain,
        flip=flip,
        late=late,
    )
    responses = [read_response(path, choice, FEWEST_REVERSALS) for path in recordings]
    parts = [outcome.fit_part(fit, response) for response in responses]
    prefixes = outcome.places(target, chosen.record)
    if len(responses) not in (1, len(prefixes)):
        takes = f"{len(prefixes)} ({', '.join(p.rstrip('.') for p in prefixes)})"
        raise SteadytipError(
            f"{len(responses)} recordings for {target}, which takes "
            f"{takes if len(prefixes) > 1 else 'one operator'}: give one recording, or one for each"
        )
    evaluations = []
    with bar(_console, quiet) as progress:
        for response, part in zip(responses, parts, strict=True):
            task = progress.add_task(f"fitting {response.path.name}", total=None)

            def update(done: int, count: int, task: object = task) -> None:
                progress.update(task, completed=done, total=count)  # type: ignore[arg-type]

            evaluations.append(outcome.evaluate(response, chosen, part, update))

    if not quiet:
        for one in evaluations:
            _show(one, chosen.title)
    path = out or Path("build", "identify", f"{recordings[0].stem}.ssv")
    fits = [one.identified for one in evaluations] * (len(prefixes) // len(evaluations))
    named = dict(zip(prefixes, fits, strict=True))
    files = {"parameters": outcome.write_set(path, chosen.record, named)}
    if report:
        files["page"] = outcome.write_page(path.with_suffix(".html"), chosen, evaluations)
    if not quiet:
        for what, file in files.items():
            say(_console, f"{what}: {file}", "dim")
        say(_console, f"for parts that are a {target}: --set part.NAME.parameters={path}", "dim")


def _show(one: object, title: str) -> None:
    from harness.identify.hysteresis.evaluation import Evaluation

    assert isinstance(one, Evaluation)
    response = one.response
    _console.print()
    say(_console, f"{response.path.name}: {title}, {one.identified.order}", "bold")
    say(
        _console,
        f"{len(response.time)} samples in {response.time[-1]:.4g} s; "
        + ", ".join(response.columns.values()),
        "dim",
    )
    for note in response.notes:
        say(_console, f"note: {note}", "yellow")
    _console.print(printed(one.residual_table()))
    _console.print()
    _console.print(printed(one.band_table()))
