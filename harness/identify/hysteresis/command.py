"""`steadytip identify hysteresis`: the operator of an actuator from voltage and displacement."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from harness.identify.options import Accept, CommandOutput, Out, Quiet, Rate, Report, column

if TYPE_CHECKING:
    from harness.identify.hysteresis.evaluation import HysteresisEvaluation


def command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Tables of voltage and displacement (CSV, text, Parquet); one for each stack of"
            " the model, or one for all of them.",
        ),
    ],
    out: Out = None,
    operator: Annotated[
        str,
        typer.Option(
            help="What to fit: modulated-stops, prandtl-ishlinskii, rate-dependent or creeping."
        ),
    ] = "modulated-stops",
    model: Annotated[
        str | None,
        typer.Option(
            help="Model of the parameters, as TremorCanceller; the operator's own by default."
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
    volts: Annotated[str | None, column("Column of the voltage, from 1.")] = None,
    displacement: Annotated[str | None, column("Column of the displacement.")] = None,
    time: Annotated[str | None, column("Column of the time.")] = None,
    rate: Rate = None,
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
    accept: Accept = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Fit the hysteresis of an actuator, as a parameter file for any run."""
    import math

    from fmu_src.errors import SteadytipError
    from harness.identify.hysteresis.evaluation import evaluate
    from harness.identify.hysteresis.findings import check_fit
    from harness.identify.hysteresis.operators import find_operator
    from harness.identify.hysteresis.page import write_page
    from harness.identify.hysteresis.parameter_files import find_prefixes, write_operators
    from harness.identify.hysteresis.plays import FEWEST_REVERSALS
    from harness.recordings.quality import select_samples
    from harness.recordings.stack import read_response
    from harness.recordings.tables import ColumnMapping

    chosen = find_operator(operator)
    if not (math.isfinite(gain) and gain > 0):
        raise SteadytipError(f"--gain {gain:g}: must be above 0; for a sign there is --flip")
    output = CommandOutput(quiet, out, recordings[0])
    mapping = ColumnMapping(
        {"time": time, "volts": volts, "displacement": displacement},
        {"time": time_unit, "volts": volts_unit, "displacement": displacement_unit},
        rate,
    )
    responses = [
        read_response(path, FEWEST_REVERSALS, mapping, gain, flip, late) for path in recordings
    ]
    selections = [select_samples(fit, one.path, one.time) for one in responses]
    target = model or chosen.model.name
    prefixes = find_prefixes(target, chosen.record)
    _check_count(len(responses), target, prefixes)
    with output.progress() as add:
        evaluations = [
            evaluate(response, chosen, selected, add(f"fitting {response.path.name}"))
            for response, selected in zip(responses, selections, strict=True)
        ]
    for one in evaluations:
        _show(output, one)
    page = output.path.with_suffix(".html")  # also of a fit that is no basis for a set
    files = {"page": write_page(page, chosen, evaluations)} if report else {}
    for one in evaluations:
        check_fit(one, accept or ())
    fits = [one.fit for one in evaluations] * (len(prefixes) // len(evaluations))
    named = dict(zip(prefixes, fits, strict=True))
    parameters = write_operators(output.path, chosen.record, named)
    output.files({"parameters": parameters, **files}, target)


def _check_count(count: int, target: str, prefixes: Sequence[str]) -> None:
    """Refuse a number of recordings that does not suit the model."""
    from fmu_src.errors import SteadytipError

    if count not in (1, len(prefixes)):
        takes = f"{len(prefixes)} ({', '.join(p.rstrip('.') for p in prefixes)})"
        raise SteadytipError(
            f"{count} recordings for {target}, which takes "
            f"{takes if len(prefixes) > 1 else 'one operator'}: give one recording, or one for each"
        )


def _show(output: CommandOutput, one: HysteresisEvaluation) -> None:
    from harness.identify.hysteresis.page import band_table, residual_table

    response = one.response
    output.title(f"{response.path.name}: {one.operator.title}, {one.fit.order}")
    samples = f"{len(response.time)} samples in {response.time[-1]:.4g} s"
    output.say("; ".join((samples, ", ".join(response.columns.values()))))
    output.notes(response.notes)
    output.tables(residual_table(one), band_table(one))
