"""`steadytip identify excitation`: the voltage to record an actuator with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

_console = Console()


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
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Voltage that shows what `identify hysteresis` looks for; play it, and record the stroke."""
    import numpy as np

    from harness.common.errors import SteadytipError, nearest
    from harness.identify.hysteresis import modulated_stops
    from harness.identify.hysteresis import plays as hysteresis
    from harness.identify.parameter_files import write_table

    makers = {
        "modulated-stops": modulated_stops.excitation,
        "prandtl-ishlinskii": hysteresis.excitation,
        "rate-dependent": lambda rate, top: np.concatenate(hysteresis.sweep(rate, top=top)),
        "creeping": modulated_stops.excitation,
    }
    if operator not in makers:
        raise SteadytipError(
            f"--operator {operator}: there is none of that name; {nearest(operator, makers)}"
        )
    if not 0 < top <= 1000:
        raise SteadytipError(f"--top {top:g}: must be above 0 and at most 1000 V")
    if not 200 <= rate <= 1e5:
        raise SteadytipError(
            f"--rate {rate:g}: must be in [200, 100000] Hz; slower samples do not show the turns"
        )
    volts = makers[operator](rate, top=top)
    table = np.column_stack((np.arange(len(volts)) / rate, volts))
    write_table(out, ["time [s]", "volts [V]"], table, ["%.6f", "%.5f"])
    if not quiet:
        text = f"{out}: {len(volts)} samples, {len(volts) / rate:.4g} s, 0 to {volts.max():.4g} V"
        _console.print(text, style="dim", markup=False, highlight=False, soft_wrap=True)
