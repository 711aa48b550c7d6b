"""What was made before, kept under a digest of all that it is made of.

A file holds the SHA-256 of its content and the content: one that is damaged, or cut off by a full
disk, is as good as none. Several processes may use a folder at once, on a disk that is read-only it
is of no use, and does no harm. What has not been asked for in the longest time goes first.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MOST_BYTES = 200 * 2**20
"""Of one folder."""
_SIZE = hashlib.sha256().digest_size


def kept(path: Path, make: Callable[[], bytes], mode: int = 0o644) -> Path:
    """A file whose name its content determines: made when missing, and whole when it is there.

    Args:
        path: where it is kept.
        make: gives its content.
        mode: permissions.
    """
    if not path.is_file():
        content = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        # Others may be at it, too: what appears under the name is whole.
        handle, written = tempfile.mkstemp(dir=path.parent, suffix=path.suffix)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            Path(written).chmod(mode)
            Path(written).replace(path)
        except OSError:
            Path(written).unlink(missing_ok=True)
            raise
    return path


def recall(
    folder: Path, key: str, make: Callable[[], bytes], most_bytes: int = MOST_BYTES
) -> bytes:
    """Something made before, or now.

    Args:
        folder: where things of that kind are kept.
        key: digest of all that it is made of; a file name.
        make: makes it.
        most_bytes: what the folder may hold.
    """
    path = folder / key
    with suppress(OSError):
        whole = path.read_bytes()
        known, found = whole[:_SIZE], whole[_SIZE:]
        if known == hashlib.sha256(found).digest():
            with suppress(OSError):
                os.utime(path)
            return found
        path.unlink()
    content = make()
    with suppress(OSError):
        kept(path, lambda: hashlib.sha256(content).digest() + content)
        _bound(folder, most_bytes)
    return content


def _bound(folder: Path, most_bytes: int) -> None:
    """Remove what was used longest ago."""
    found = [(file, file.stat()) for file in folder.iterdir()]
    total = 0
    for file, state in sorted(found, key=lambda each: each[1].st_mtime, reverse=True):
        total += state.st_size
        if total > most_bytes:
            file.unlink(missing_ok=True)
