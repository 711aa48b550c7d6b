"""Keep files that were made before, under a digest of all that they are made of.

A file's name holds that digest and the one of its content: a file that is damaged, or cut off by a
full disk, is made again. Several processes may use a folder at once. Of a folder that has grown too
large, files that have not been asked for in the longest time are removed first.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MOST_BYTES = 400 * 2**20
"""Of one folder."""


def keep(
    folder: Path,
    key: str,
    make: Callable[[], bytes],
    suffix: str = "",
    mode: int = 0o644,
    most_bytes: int = MOST_BYTES,
) -> Path:
    """Return the path of a file that was made before, or make it now.

    Args:
        folder: where files of that kind are kept.
        key: digest of all that the file is made of.
        make: makes its content.
        suffix: ending of its name.
        mode: permissions.
        most_bytes: what the folder may hold.

    Raises:
        OSError: the file can be neither found nor written.
    """
    path = find(folder, key, suffix)
    return path or _store(folder, key, make(), suffix, mode, most_bytes)


def recall(
    folder: Path, key: str, make: Callable[[], bytes], most_bytes: int = MOST_BYTES
) -> bytes:
    """Return the content of a file that was made before, or make it now.

    Where files cannot be kept, for instance on a read-only disk, it is made each time.

    Args:
        folder: where files of that kind are kept.
        key: digest of all that the file is made of.
        make: makes its content.
        most_bytes: what the folder may hold.
    """
    with suppress(OSError):
        if path := find(folder, key):
            return path.read_bytes()
    content = make()
    with suppress(OSError):
        _store(folder, key, content, "", 0o644, most_bytes)
    return content


def find(folder: Path, key: str, suffix: str = "") -> Path | None:
    """Return the path of a file made before; remove it if it is damaged."""
    for path in folder.glob(f"{key}-*{suffix}"):
        with suppress(OSError):  # another process may have removed it
            if path.name == _name(key, path.read_bytes(), suffix):
                with suppress(OSError):
                    os.utime(path)
                return path
            path.unlink()
    return None


def write(path: Path, content: bytes, mode: int = 0o644) -> Path:
    """Write a file in one go: a reader sees the old file or the new one, never half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # A name of its own: several processes may write the same file.
    handle, written = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".partial")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(written).chmod(mode)
        Path(written).replace(path)
    except OSError:
        Path(written).unlink(missing_ok=True)
        raise
    return path


def _name(key: str, content: bytes, suffix: str) -> str:
    return f"{key}-{hashlib.sha256(content).hexdigest()[:16]}{suffix}"


def _store(folder: Path, key: str, content: bytes, suffix: str, mode: int, most_bytes: int) -> Path:
    path = write(folder / _name(key, content, suffix), content, mode)
    with suppress(OSError):
        _bound(folder, most_bytes)
    return path


def _bound(folder: Path, most_bytes: int) -> None:
    """Remove the files that were used longest ago."""
    found = [(file, file.stat()) for file in folder.iterdir()]
    total = 0
    for file, state in sorted(found, key=lambda each: each[1].st_mtime, reverse=True):
        total += state.st_size
        if total > most_bytes:
            file.unlink(missing_ok=True)
