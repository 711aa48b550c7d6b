"""`steadytip identify excitation`: the voltage to record an actuator with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Quiet


def command(
    out: Annotated[Path, typer.Argument(metavar="FILE", help="CSV of time and voltage to write.")],
    operator: Annotated[
        str,
        typer.Option(
            help="What is to be fitted: modulated-stops, prandtl-ishlinskii, rate-dependent or "
            "creeping."
        ),
    ] = "modulated-stops",
    top: Annotated[float, typer.Option(metavar="VOLTS", help="Largest voltage.")] = 100.0,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples in a second.")] = 1000.0,
    quiet: Quiet = False,
) -> None:
    """Write the voltage to play to a stack for `identify hysteresis`."""
    import numpy as np

    from fmu_src.errors import SteadytipError
    from harness.identify.hysteresis.operators import find_operator
    from harness.recordings.tables import write_table

    chosen = find_operator(operator)
    if not 0 < top <= 1000:
        raise SteadytipError(f"--top {top:g}: must be above 0 and at most 1000 V")
    if not 200 <= rate <= 1e5:
        raise SteadytipError(
            f"--rate {rate:g}: must be in [200, 100000] Hz; slower samples do not show the turns"
        )
    volts = chosen.excitation(rate, top)
    table = np.column_stack((np.arange(len(volts)) / rate, volts))
    write_table(out, ["time [s]", "volts [V]"], table, ["%.6f", "%.5f"])
    text = f"{out}: {len(volts)} samples, {len(volts) / rate:.4g} s, 0 to {volts.max():.4g} V"
    CommandOutput(quiet).say(text)
