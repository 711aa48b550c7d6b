"""`make check`: every check in turn, one line each, a verdict at the end.

With CHECKS=style in the environment the tests are left out (CI has run them already).
"""

import os
import subprocess
import sys
import time
from pathlib import Path

BIN = Path(sys.executable).parent
STYLE = {
    "format": ["ruff", "format", "--check", "."],
    "lint": ["ruff", "check", "."],
    "types": ["mypy"],
    "imports": ["lint-imports"],
    "tables": ["python", "-m", "fmu_src.pack.models_page", "--check"],
}
TESTS = {"tests": ["python", "-m", "pytest", "-q", "-n", "auto", "--dist", "loadgroup"]}


def main() -> int:
    """Run the checks; 0 when all are well."""
    checks = STYLE if os.environ.get("CHECKS") == "style" else {**STYLE, **TESTS}
    bad = []
    begin = time.monotonic()
    for name, (program, *arguments) in checks.items():
        started = time.monotonic()
        done = subprocess.run([str(BIN / program), *arguments], capture_output=True, text=True)
        verdict = "ok" if done.returncode == 0 else "FAILED"
        print(f"{name:8} {verdict:6} {time.monotonic() - started:6.1f} s", flush=True)
        if done.returncode != 0:
            bad.append(name)
            print(done.stdout + done.stderr)
    passed, seconds = len(checks) - len(bad), time.monotonic() - begin
    print(f"\n{'All good' if not bad else 'Not good: ' + ', '.join(bad)}, {seconds:.0f} s")
    print(f"{passed} passed, {len(bad)} failed")
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
