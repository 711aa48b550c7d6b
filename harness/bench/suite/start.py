"""Cold start of the command.

Each time a new process, whose files the system has in memory. The run of one tick ends when its
record and metrics are written, which is later than its first step; FMUs are built already.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from fmu_src import pack
from harness import scenario
from harness.bench.session import Bench

_COMMAND = "from harness.cli import main; main()"
_RUN = ("run", "closed_loop", "--seconds", "0.001", "--set", "settle=0", "--no-report", "--quiet")
_WANTED = {"steadytip --help": "at most 0.3 s", "steadytip run, one tick": "at most 2 s"}


@pytest.fixture(scope="module")
def commands(folder: Path) -> dict[str, list[str]]:
    """Arguments of Python by what they are."""
    pack.build({table.settings["fmu"] for table in scenario.load("closed_loop").parts.values()})
    return {
        "Python alone": ["-c", "pass"],
        "import harness": ["-c", "import harness"],
        "imports of a run": ["-c", "import harness.runs"],
        "steadytip --help": ["-c", _COMMAND, "--help"],
        "steadytip run, one tick": ["-c", _COMMAND, *_RUN, "--out", str(folder / "start")],
    }


def started(arguments: Sequence[str]) -> None:
    """Run Python to its end."""
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)


@pytest.mark.parametrize(
    "what",
    ["Python alone", "import harness", "imports of a run", *_WANTED],
)
def bench_start(bench: Bench, turn: int, what: str, commands: dict[str, list[str]]) -> None:
    """From the start of the process to its end."""
    bench.time(
        what,
        "",
        lambda: started(commands[what]),
        unit="s",
        rounds=1,
        warmup=int(turn == 0),
        wanted=_WANTED.get(what, ""),
    )
