"""The command `steadytip validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from harness.cli.options import console


def validate(
    fmus: Annotated[list[Path], typer.Argument(metavar="FMU...", help="FMU files, anybody's.")],
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML for CI.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write all that was found as JSON.")] = None,
    timeout: Annotated[
        float, typer.Option(min=1.0, help="Wall-clock time for each probe of the running FMU [s].")
    ] = 60.0,
) -> None:
    """Check FMUs against the checklist of a drop-in FMU, each probe in a process of its own."""
    from harness.common.errors import ProblemsError
    from harness.validation import reports
    from harness.validation.validate import validate as check

    missing = [f"{path} does not exist" for path in fmus if not path.is_file()]
    if missing:
        raise ProblemsError("validate", missing)
    verdicts = []
    for path in fmus:
        with console.status(escape(path.name)) as status:

            def show(done: int, count: int, id: str, name: str = path.name) -> None:
                status.update(escape(f"{name}: {done} of {count} checks, {id}"))

            verdicts.append(check(path, timeout=timeout, progress=show))
        console.print(reports.table(verdicts[-1]))
    if junit is not None:
        reports.write_junit(junit, verdicts)
    if json is not None:
        reports.write_json(json, verdicts)
    if not all(verdict.good for verdict in verdicts):
        raise typer.Exit(1)
