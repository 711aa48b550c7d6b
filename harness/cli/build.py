"""The command `steadytip build`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import Overrides, console


def build(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names, or files of your own: lowpass.py, lowpass.py:LowPass. All by default."
        ),
    ] = None,
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
    override: Overrides = None,
) -> None:
    """Build FMUs from the models, or one FMU from several of a scenario's parts."""
    from fmu_src import pack
    from fmu_src.errors import SteadytipError

    def progress(text: str) -> None:
        console.print(f"building {text}", style="dim", highlight=False)

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
        from harness.cli.overrides import parse_overrides
        from harness.scenario.load import load
        from harness.system import container as fused
        from harness.system.assembly import assemble

        system = assemble(load(container, parse_overrides(override, None, None)))
        wanted = parts.replace(" ", "").split(",") if parts else None
        paths = [fused.build(system, wanted, name, out, target, progress)]
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)
