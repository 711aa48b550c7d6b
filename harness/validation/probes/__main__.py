"""Probes, each in a process of its own.

`python -m harness.validation.probes FACTS CHECK FOLDER` is one, in this process: it reads the
facts, writes `outcome.json` into the folder, and `doing` while it goes on.

`python -m harness.validation.probes FACTS` makes processes that carry out one each, which is
quicker than to start them anew: for each line `CHECK FOLDER` on its input it writes two, the new
process, and how that ended. Nothing of the FMU is ever loaded here.
"""

import json
import os
import sys
from pathlib import Path

from harness.validation import probes  # noqa: F401 - registers the checks
from harness.validation.checks import PROBES
from harness.validation.probes.host import Host


def main() -> None:
    """Carry out one check, or serve."""
    facts, *one = sys.argv[1:]
    if one:
        carry_out(facts, *one)
        return
    while line := sys.stdin.readline():
        check, folder = line.rstrip("\n").split(" ", 1)
        process = os.fork()
        if process == 0:
            enter(Path(folder))
            carry_out(facts, check, folder)
            return
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)


def enter(folder: Path) -> None:
    """Make the folder this process's own, and its files what the process reads and writes."""
    os.chdir(folder)
    for number, name in enumerate((os.devnull, "stdout", "stderr")):
        file = os.open(name, os.O_RDWR | os.O_CREAT, 0o600)
        os.dup2(file, number)
        os.close(file)


def carry_out(facts: str, name: str, place: str) -> None:
    """Carry out one check."""
    folder = Path(place)
    host = Host(json.loads(Path(facts).read_text(encoding="utf-8")), folder / "doing")
    outcome = PROBES[name].run(host)
    found = {
        "problems": outcome.problems,
        "notes": outcome.notes,
        "skipped": outcome.skipped,
    }
    host.doing("ending the process")
    (folder / "outcome.json").write_text(json.dumps(found), encoding="utf-8")


main()
