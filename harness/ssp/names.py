"""File names that every platform and every URI takes."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from typing import TypeVar

__all__ = ["file_names", "portable"]

_Key = TypeVar("_Key", bound=Hashable)
_LONGEST = 64  # unpacked below deep folders, paths stay under the 260 characters of Windows
_OTHER = re.compile(r"[^A-Za-z0-9_-]+")


def portable(name: str) -> str:
    """Shorten a name, and replace everything but ASCII letters, digits, `-` and `_`.

    >>> portable("My FMU (new)")
    'My_FMU_new_'
    """
    return _OTHER.sub("_", name)[:_LONGEST] or "_"


def file_names(wanted: Mapping[_Key, str], suffix: str) -> dict[_Key, str]:
    """Return a file name for each key, near to the wanted one; no two alike, whatever their case.

    >>> file_names({1: "Hand", 2: "hand"}, ".fmu")
    {1: 'Hand.fmu', 2: 'hand_2.fmu'}
    """
    names: dict[_Key, str] = {}
    taken: set[str] = set()
    for key, stem in wanted.items():
        base = name = portable(stem)
        number = 1
        while name.casefold() in taken:
            number += 1
            name = f"{base}_{number}"
        taken.add(name.casefold())
        names[key] = f"{name}{suffix}"
    return names
