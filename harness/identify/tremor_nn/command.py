"""`steadytip identify tremor-nn`: the cascade neural filter from recordings of a hand at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import bar, printed, say

_console = Console()


def command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Hand motion (CSV, text, Parquet) while somebody holds still, to train on.",
        ),
    ],
    test: Annotated[
        list[Path] | None,
        typer.Option(metavar="RECORDING", help="To be tested on only; may be given repeatedly."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The set; build/identify/RECORDING.ssv by default."
        ),
    ] = None,
    fit: Annotated[
        str,
        typer.Option(
            metavar="START:END|SHARE",
            help="Part that is trained on, in seconds or as a share (0.75, 75%); what comes after"
            " it is tested on.",
        ),
    ] = "75%",
    axes: Annotated[
        str, typer.Option(help="Axes, each of which is a trial of its own; some of xyz.")
    ] = "xyz",
    inputs: Annotated[int | None, typer.Option(help="Inputs of the network, 1 to 100.")] = None,
    spacing: Annotated[
        int | None, typer.Option(help="Samples of 4 ms from one input to the next, 1 to 5.")
    ] = None,
    hidden: Annotated[
        int | None, typer.Option(help="Hidden units that are added, 0 to 10.")
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(help="Passes over the recordings, each on another made-up motion."),
    ] = None,
    intent: Annotated[
        float | None,
        typer.Option(
            metavar="UM",
            help="Rms of the made-up motion [um]; as large as that recorded by default.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of all that is random.")] = None,
    report: Annotated[bool, typer.Option(help="Write the HTML page beside the set.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Neural filter for errors that are no tremor, as a parameter set for any run."""
    import math

    from harness.common.errors import SteadytipError
    from harness.identify.tremor_nn import fit as neural
    from harness.identify.tremor_nn.cascade import Architecture, Training

    if out is not None and out.suffix != ".ssv":
        raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
    if not axes or set(axes) - set(neural.AXES) or len(set(axes)) < len(axes):
        raise SteadytipError(f"--axes {axes}: must be some of xyz, each once, as in xz")
    if intent is not None and not (math.isfinite(intent) and 0 < intent <= 1e5):
        raise SteadytipError(f"--intent {intent:g}: must be above 0 and at most 100000 um")
    size = {"inputs": inputs, "hidden": hidden, "spacing": spacing}
    architecture = Architecture(**{name: n for name, n in size.items() if n is not None})
    how = {"epochs": epochs, "seed": seed}
    training = Training(**{name: n for name, n in how.items() if n is not None})  # type: ignore[arg-type]
    found = [trial for path in recordings for trial in neural.trials(path, axes, fit)]
    found += [trial for path in test or () for trial in neural.trials(path, axes, "1", "other")]
    with bar(_console, quiet) as progress:
        task = progress.add_task("training", total=None)
        done = neural.evaluate(
            found,
            architecture,
            training,
            None if intent is None else 1e-6 * intent,
            lambda steps, count: progress.update(task, completed=steps, total=count),
        )
    path = out or Path("build", "identify", f"{recordings[0].stem}.ssv")
    if not quiet:
        for trial in done.trials:
            if trial.note:
                say(_console, f"note: {trial.note}", "yellow")
        _console.print(printed(done.table()))
        _console.print()
        _console.print(printed(done.unit_table()))
    files = {"parameters": neural.write_set(path, done.network)}
    if report:
        files["page"] = neural.write_page(path.with_suffix(".html"), done)
    if not quiet:
        for what, file in files.items():
            say(_console, f"{what}: {file}", "dim")
        text = f"for parts that are a CascadeNeural: --set part.NAME.parameters={path}"
        say(_console, text, "dim")
