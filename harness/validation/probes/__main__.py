"""One probe, in this process: `python -m harness.validation.probes CHECK FACTS FOLDER`.

Reads the facts, writes `outcome.json` into the folder, and `doing` while it goes on.
"""

import json
import sys
from pathlib import Path

from harness.validation import probes  # noqa: F401 - registers the checks
from harness.validation.checks import PROBES
from harness.validation.probes.host import Host


def main() -> None:
    """Carry out one check."""
    name, facts, place = sys.argv[1:]
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
