"""Options and output that the commands `steadytip identify` share. Nothing heavy is imported."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from fmu_src.errors import SteadytipError
from harness.report.terminal import bar, printed, say

if TYPE_CHECKING:
    from harness.report.page import Table

__all__ = ["Accept", "CommandOutput", "Out", "Progress", "Quiet", "Rate", "Report", "column"]

Progress = Callable[[int, int], None]
"""Takes the number of steps done and of all steps."""
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE",
        help="The parameter file; build/identify/RECORDING.ssv by default.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Samples in a second, for tables without time."),
]
Accept = Annotated[
    list[str] | None,
    typer.Option(help="Write the parameter file in spite of a finding, by its name."),
]
Report = Annotated[bool, typer.Option(help="Write the HTML page beside the parameter file.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def column(text: str) -> Any:
    """Make an option that chooses a column by name or number (from 1).

    Args:
        text: help of the option.
    """
    return typer.Option(metavar="NAME|NUMBER", help=text)


class CommandOutput:
    """Prints the results of a command, or nothing if it is quiet.

    Attributes:
        path: the parameter file to write.

    Args:
        quiet: True to print nothing.
        out: the parameter file that the user wants; None for one named after the recording.
        recording: the recording.

    Raises:
        SteadytipError: the file is not named `.ssv`.
    """

    def __init__(
        self, quiet: bool, out: Path | None = None, recording: Path = Path("recording")
    ) -> None:
        if out is not None and out.suffix != ".ssv":
            raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
        self.path = out or Path("build", "identify", f"{recording.stem}.ssv")
        self._console = Console(quiet=quiet)
        self._quiet = quiet

    def say(self, text: str, style: str = "dim") -> None:
        """Print a line."""
        say(self._console, text, style)

    def title(self, text: str) -> None:
        """Print a title below an empty line."""
        self._console.print()
        self.say(text, "bold")

    def notes(self, notes: Iterable[str]) -> None:
        """Print notes."""
        for note in notes:
            self.say(f"note: {note}", "yellow")

    def tables(self, *tables: Table) -> None:
        """Print tables with an empty line between two of them."""
        for index, table in enumerate(tables):
            if index:
                self._console.print()
            self._console.print(printed(table))

    @contextmanager
    def progress(self) -> Iterator[Callable[[str], Progress]]:
        """Show progress bars; yield a function that adds a bar with a title."""
        with bar(self._console, self._quiet) as bars:

            def add(title: str) -> Progress:
                task = bars.add_task(title, total=None)
                return lambda done, count: bars.update(task, completed=done, total=count)

            yield add

    def files(self, files: Mapping[str, Path], model: str) -> None:
        """Print the files that were written, and how a run takes the parameters.

        Args:
            files: files by what they hold; `parameters` is the parameter file.
            model: model that the parameters are for.
        """
        for what, file in files.items():
            self.say(f"{what}: {file}")
        if "parameters" in files:
            article = "an" if model[0] in "AEIOU" else "a"
            setting = f"--set part.NAME.parameters={files['parameters']}"
            self.say(f"for parts that are {article} {model}: {setting}")
