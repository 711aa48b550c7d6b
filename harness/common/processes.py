"""Processes that were started and have to end."""

from __future__ import annotations

import subprocess
from typing import Any

__all__ = ["end_process"]


def end_process(process: subprocess.Popen[Any], timeout: float) -> bool:
    """Terminate a process, and kill it if it has not ended in time [s]. An ended one stays so.

    Returns:
        Whether it ended by itself or when it was asked to.
    """
    process.terminate()
    try:
        process.wait(timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True
