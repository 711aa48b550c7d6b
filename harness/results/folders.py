"""Folders of runs: each run has its own, and two runs never write to one.

A run without a folder of its own choice takes the next number below the folder of its name,
`build/runs/closed_loop/0007`. Making a folder fails if it exists: threads and processes that make
one at the same time get different numbers.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from harness.common.errors import RecordError
from harness.common.files import reason

__all__ = ["claim", "new_folder"]


def new_folder(base: Path) -> Path:
    """Make the folder of the next run below a folder, and return it.

    Raises:
        OSError: it cannot be made.
    """
    base.mkdir(parents=True, exist_ok=True)
    taken = [int(path.name) for path in base.iterdir() if path.name.isdecimal()]
    number = max(taken, default=0)
    while True:
        number += 1
        with contextlib.suppress(FileExistsError):
            folder = base / f"{number:04d}"
            folder.mkdir()
            return folder


@contextlib.contextmanager
def claim(folder: Path) -> Iterator[None]:
    """Hold a folder for one run, until the run or its process ends.

    Raises:
        RecordError: another run holds it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        key = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
        # Not in the folder itself: the system does not take the file of a lock away.
        lock = FileLock(Path(tempfile.gettempdir(), f"steadytip-{_user()}-{key}.lock"))
        lock.acquire(timeout=0)
    except Timeout:
        raise RecordError(
            f"another run records to {folder} now: wait for its end, or give this one another "
            "folder (out)"
        ) from None
    except OSError as error:
        raise RecordError(f"cannot record to {folder}: {reason(error)}") from None
    try:
        yield
    finally:
        lock.release()


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"
