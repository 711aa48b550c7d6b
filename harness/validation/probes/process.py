"""Resources that this process uses."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from harness.validation.checks import Skip

__all__ = ["resident"]


def resident() -> int:
    """Return the memory of this process that is in use [byte].

    Raises:
        Skip: this platform does not say without a library of its own.
    """
    if not sys.platform.startswith("linux"):
        raise Skip("memory is measured on Linux only")
    # What the allocator holds back is no leak.
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
