"""Files that are written by a thread of their own.

A disk that is busy makes whoever writes wait, for tens of milliseconds now and then. A thread that
does nothing but write does that waiting for a loop that keeps to the wall clock: while the system
writes, it does not hold the interpreter.
"""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

__all__ = ["BackgroundFile", "write_all"]


def write_all(file: io.RawIOBase, data: bytes | memoryview) -> None:
    """Write to a file without a buffer, which takes a part if there is no room for more.

    Raises:
        OSError: it does not take all.
    """
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


class BackgroundFile(io.RawIOBase):
    """A new file, written in order and behind the caller's back.

    What goes wrong is raised by the next call, and again by `close`.
    """

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it cannot be made.
        """
        self._file = path.open("wb", buffering=0)
        self._at = 0
        self._error: OSError | None = None
        self._todo: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="steadytip-file", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        while (action := self._todo.get()) is not None:
            if self._error is None:
                try:
                    action()
                except OSError as error:
                    self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def writable(self) -> bool:
        """Return True, as Arrow asks before it writes."""
        return True

    def seekable(self) -> bool:
        """Return True: a place can be sought before it is written."""
        return True

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a place, from the start or from here."""
        self._check()
        self._at = offset + (self._at if whence == io.SEEK_CUR else 0)
        at = self._at
        self._todo.put(lambda: self._file.seek(at))
        return at

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write bytes later; they are copied now."""
        self._check()
        held = bytes(data)
        self._todo.put(lambda: write_all(self._file, held))
        self._at += len(held)
        return len(held)

    def close(self) -> None:
        """Wait until all is written.

        Raises:
            OSError: something could not be.
        """
        if self.closed:
            return
        self._todo.put(None)
        self._thread.join()
        try:
            self._file.close()
        finally:
            with contextlib.suppress(OSError):
                super().close()
        self._check()
