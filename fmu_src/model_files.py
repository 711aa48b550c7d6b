"""How a model in a file of the user's own is written: `lowpass.py`, or `lowpass.py:LowPass`.

Nothing is imported here that takes time: the settings of a scenario are read with it.
"""

import re
from pathlib import Path

__all__ = ["is_model_file", "split_model_file"]

_FILE = re.compile(r"(?P<file>.+\.py)(?::(?P<name>\w+))?")


def is_model_file(value: str) -> bool:
    """Return whether a model is given by the file that defines it.

    >>> is_model_file("LowPass"), is_model_file("a/lowpass.py"), is_model_file("lowpass.py:LowPass")
    (False, True, True)
    """
    return _FILE.fullmatch(value) is not None


def split_model_file(value: str) -> tuple[Path, str]:
    """Return the file, and the name of the model in it; empty where none is named.

    >>> split_model_file("lowpass.py:LowPass")[1], split_model_file("lowpass.py")[1]
    ('LowPass', '')
    """
    found = _FILE.fullmatch(value)
    if found is None:
        raise ValueError(f"'{value}' names no Python file")
    return Path(found["file"]), found["name"] or ""
