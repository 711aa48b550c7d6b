"""`steadytip identify tremor-nn`: the cascade neural filter from recordings of a hand at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Out, Quiet, Report


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
    out: Out = None,
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
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Train a neural filter for errors that are no tremor, as a parameter file for any run."""
    import math

    from fmu_src.errors import SteadytipError
    from harness.identify.tremor_nn import fit as neural
    from harness.identify.tremor_nn.cascade import Architecture, Training
    from harness.identify.tremor_nn.page import trial_table, unit_table, write_page
    from harness.identify.tremor_nn.read import AXES, read_trials

    output = CommandOutput(quiet, out, recordings[0])
    if not axes or set(axes) - set(AXES) or len(set(axes)) < len(axes):
        raise SteadytipError(f"--axes {axes}: must be some of xyz, each once, as in xz")
    if intent is not None and not (math.isfinite(intent) and 0 < intent <= 1e5):
        raise SteadytipError(f"--intent {intent:g}: must be above 0 and at most 100000 um")
    size = {"inputs": inputs, "hidden": hidden, "spacing": spacing}
    architecture = Architecture(**{name: n for name, n in size.items() if n is not None})
    how = {"epochs": epochs, "seed": seed}
    training = Training(**{name: n for name, n in how.items() if n is not None})  # type: ignore[arg-type]
    found = [trial for path in recordings for trial in read_trials(path, axes, fit)]
    found += [trial for path in test or () for trial in read_trials(path, axes, "1", "other")]
    with output.progress() as add:
        level = None if intent is None else 1e-6 * intent
        done = neural.evaluate(found, architecture, training, level, add("training"))
    output.notes(trial.note for trial in done.trials if trial.note)
    output.tables(trial_table(done), unit_table(done))
    files = {"parameters": neural.write_network(output.path, done.network)}
    if report:
        files["page"] = write_page(output.path.with_suffix(".html"), done)
    output.files(files, "CascadeNeural")
