"""Cold start of the command.

Each time a new process, whose files the system has in memory; FMUs are built already. The first
step of a run is seen by the thread that watches it, up to 0.05 s after it was made; there the
process is ended. A run of one tick goes on until its record and metrics are written.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from fmu_src import pack
from harness.bench.session import Bench
from harness.scenario import load as scenario

_COMMAND = "from harness.cli.main import main; main()"
_SEEN = f"""
import os
from contextlib import contextmanager
from harness.cli.console import Display

@contextmanager
def progress(self):
    yield lambda done, seconds: done > 0 and os._exit(0)

Display.progress = progress
{_COMMAND}
"""
_RUN = ("run", "closed_loop", "--no-report", "--quiet")
_TICK = ("--seconds", "0.001", "--set", "warm_up=0")
_ARGUMENTS = {
    "Python alone": ("-c", "pass"),
    "import steadytip": ("-c", "import steadytip"),
    "imports of a run": ("-c", "import harness.running"),
    "steadytip --help": ("-c", _COMMAND, "--help"),
    "steadytip run, to its first step": ("-c", _SEEN, *_RUN),
    "steadytip run, of one tick": ("-c", _COMMAND, *_RUN, *_TICK),
}
_WANTED = {"steadytip --help": "at most 0.3 s", "steadytip run, to its first step": "at most 2 s"}


@pytest.fixture(scope="module")
def place(folder: Path) -> Path:
    """Return a folder for the files of runs, whose FMUs are built."""
    parts = scenario.load("closed_loop").parts.values()
    pack.build({table.settings.table["fmu"] for table in parts})
    made = folder / "start"
    made.mkdir()
    return made


def started(arguments: Sequence[str], place: Path) -> None:
    """Run Python to its end."""
    out = ("--out", str(place)) if "run" in arguments else ()
    environment = {**os.environ, "TMPDIR": str(place)}
    subprocess.run(
        [sys.executable, *arguments, *out], check=True, capture_output=True, env=environment
    )


@pytest.mark.parametrize("what", _ARGUMENTS)
def bench_start(bench: Bench, turn: int, what: str, place: Path) -> None:
    """Measure from the start of the process to its end."""
    bench.time(
        what,
        "",
        lambda: started(_ARGUMENTS[what], place),
        unit="s",
        rounds=1,
        warmup=int(turn == 0),
        wanted=_WANTED.get(what, ""),
        best=True,
    )
