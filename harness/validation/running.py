"""Probes in processes of their own: a crash or a hang is a result like any other."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import fmpy

from harness.common.archives import ArchiveError, extract
from harness.parts.description import platform_folders
from harness.parts.isolated import ending
from harness.validation import probes  # noqa: F401 - registers the checks
from harness.validation.checks import Check, CheckOutcome, Skip
from harness.validation.files import Fmu

__all__ = ["run_probes"]

_PACKAGES = Path(__file__).parents[2]


def run_probes(fmu: Fmu, checks: Sequence[Check], timeout: float) -> Iterator[CheckOutcome]:
    """Run probes, one after the other.

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
        with _Forked(path) if hasattr(os, "fork") else _Fresh(path) as processes:
            for number, check in enumerate(checks):
                folder = Path(place) / f"{number}"
                folder.mkdir()
                yield _run(check, processes, folder, timeout)


def _facts(fmu: Fmu, folder: Path) -> dict[str, Any]:
    facts = fmu.description_facts()
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


class _Fresh:
    """Processes that are started for one probe each."""

    def __init__(self, facts: Path) -> None:
        path = os.pathsep.join([str(_PACKAGES), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._command = [sys.executable, "-m", "harness.validation.probes", str(facts)]
        self._environment = {**os.environ, "PYTHONPATH": path}

    def __enter__(self) -> _Fresh:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, check: str, folder: Path, timeout: float) -> int | None:
        """Run a check; return how its process ended, or None if it had to be ended."""
        with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as errors:
            process = subprocess.Popen(
                [*self._command, check, folder],
                cwd=folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=errors,
            )
            try:
                return process.wait(timeout)
            except subprocess.TimeoutExpired:
                return None
            finally:
                process.kill()
                process.wait()


class _Forked(_Fresh):
    """Processes forked from one that has all imports done: a tenth of the time to start."""

    def __enter__(self) -> _Forked:
        self._server = subprocess.Popen(
            self._command,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,  # what is read ahead, `select` does not see
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._server.kill()
        self._server.communicate()

    def run(self, check: str, folder: Path, timeout: float) -> int | None:
        """Run a check; return how its process ended, or None if it had to be ended."""
        questions, answers = self._server.stdin, self._server.stdout
        assert questions is not None
        assert answers is not None
        questions.write(f"{check} {folder}\n".encode())
        process = int(answers.readline())
        ended = False
        try:
            ended = bool(select.select([answers], [], [], timeout)[0])
        finally:
            if not ended:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
        code = answers.readline()
        if not code:  # the probe has ended the one that it came from, too
            self.__exit__()
            self.__enter__()
            return -signal.SIGKILL
        return int(code) if ended else None


def _run(check: Check, processes: _Fresh, folder: Path, timeout: float) -> CheckOutcome:
    begun = time.monotonic()
    code = processes.run(check.id, folder, timeout)
    seconds = time.monotonic() - begun
    outcome = folder / "outcome.json"
    if code == 0 and outcome.exists():
        return check.outcome(**json.loads(outcome.read_text(encoding="utf-8")), seconds=seconds)
    return check.outcome([_ended(code, folder, timeout)], level="error", seconds=seconds)


def _ended(code: int | None, folder: Path, timeout: float) -> str:
    """Explain why there is no result."""
    file = folder / "doing"
    doing = file.read_text(encoding="utf-8", errors="replace").strip() if file.exists() else ""
    where = f" in {doing}" if doing else ""
    if code is None:
        return f"hangs: no end within {timeout:g} s{where}"
    said = (folder / "stderr").read_text(encoding="utf-8", errors="replace").strip()
    last = f": {said.splitlines()[-1][:200]}" if said else ""
    return f"crashes: the process {ending(code)}{where}{last}"
