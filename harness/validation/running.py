"""Probes in processes of their own: a crash or a hang is a result like any other."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy

from harness.archives import ArchiveError, extract
from harness.parts.description import platform_folders
from harness.parts.isolated import ending
from harness.validation import probes  # noqa: F401 - registers the checks
from harness.validation.checks import Check, Outcome, Skip
from harness.validation.facts import Model
from harness.validation.files import Fmu

__all__ = ["run_probes"]

_PACKAGES = Path(__file__).parents[2]


def run_probes(fmu: Fmu, checks: Sequence[Check], timeout: float) -> Iterator[Outcome]:
    """Probes, one after the other.

    Args:
        fmu: the file.
        checks: of `PROBES`.
        timeout: for each probe [s].
    """
    with tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True) as place:
        try:
            facts = _facts(fmu, Path(place) / "fmu")
        except Skip as skip:
            yield from (check.outcome([], skipped=str(skip)) for check in checks)
            return
        path = Path(place) / "facts.json"
        path.write_text(json.dumps(facts), encoding="utf-8")
        for number, check in enumerate(checks):
            folder = Path(place) / f"{number}"
            folder.mkdir()
            yield _run(check, path, folder, timeout)


def _facts(fmu: Fmu, folder: Path) -> dict[str, Any]:
    facts = Model(fmu).facts()
    member = next((fmu.binaries[f] for f in platform_folders() if f in fmu.binaries), None)
    if member is None:
        raise Skip(f"the FMU has no binary for this machine ({platform_folders()[0]})")
    try:
        extract(fmu.path, folder)
    except ArchiveError as error:
        raise Skip(f"not unpacked: {error}") from None
    (folder / "resources").mkdir(exist_ok=True)
    # Without it messages arrive as format strings, their arguments missing.
    proxy = Path(fmpy.__file__).parent / "logging" / fmpy.platform
    proxy /= f"logging{fmpy.sharedLibraryExtension}"
    return {
        **facts,
        "folder": str(folder),
        "library": str(folder / member),
        "resources": (folder / "resources").as_uri(),
        "proxy": str(proxy) if proxy.exists() else None,
    }


def _run(check: Check, facts: Path, folder: Path, timeout: float) -> Outcome:
    path = os.pathsep.join([str(_PACKAGES), *filter(None, [os.environ.get("PYTHONPATH")])])
    begun = time.monotonic()
    with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "harness.validation.probes", check.id, facts, folder],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=errors,
        )
        try:
            code: int | None = process.wait(timeout)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            process.kill()
            process.wait()
    seconds = time.monotonic() - begun
    outcome = folder / "outcome.json"
    if code == 0 and outcome.exists():
        return check.outcome(**json.loads(outcome.read_text(encoding="utf-8")), seconds=seconds)
    return check.outcome([_ended(code, folder, timeout)], level="error", seconds=seconds)


def _ended(code: int | None, folder: Path, timeout: float) -> str:
    """Why there is no result."""
    file = folder / "doing"
    doing = file.read_text(encoding="utf-8", errors="replace").strip() if file.exists() else ""
    where = f" in {doing}" if doing else ""
    if code is None:
        return f"hangs: no end within {timeout:g} s{where}"
    said = (folder / "stderr").read_text(encoding="utf-8", errors="replace").strip()
    last = f": {said.splitlines()[-1][:200]}" if said else ""
    return f"crashes: the process {ending(code)}{where}{last}"
