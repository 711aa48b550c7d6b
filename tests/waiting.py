"""Wait for what another process or thread does."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_until(
    condition: Callable[[], T], timeout: float = 60.0, what: str = "", pause: float = 0.01
) -> T:
    """Wait until a condition holds, and return its value.

    Args:
        condition: looked at again and again; may fail by itself, as when a process has died.
        timeout: longer than a busy machine needs [s]; a test that passes does not wait for it.
        what: is waited for, in the failure's words.
        pause: between two looks [s].
    """
    end = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < end, f"{what or 'what is waited for'} did not happen"
        time.sleep(pause)
    return value
