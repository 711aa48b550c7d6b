"""C structures that Python mirrors, held against what the C compiler made of them."""

from __future__ import annotations

import ctypes
from typing import Any

from fmu_src.errors import SteadytipError

__all__ = ["MirroredStruct", "check_layout"]


class MirroredStruct(ctypes.Structure):
    """A structure of ctypes that refuses fields which the C structure does not have.

    A plain one takes any attribute, and C never hears of a misspelt one.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if all(name != field[0] for field in self._fields_):
            raise AttributeError(f"C structure {type(self).__name__} has no field '{name}'")
        super().__setattr__(name, value)


def check_layout(library: Any, structs: dict[str, type[MirroredStruct]]) -> None:
    """Compare mirrored structures with those of a library.

    The library exports for each `NAME` an array `NAME_layout` of two: the size of the structure,
    and the offset of its last field.

    Args:
        library: loaded by ctypes.
        structs: mirrored structures by their names in C.

    Raises:
        SteadytipError: one has another size or another place of its last field.
    """
    for name, mirrored in structs.items():
        size, offset = (ctypes.c_size_t * 2).in_dll(library, f"{name}_layout")
        last = mirrored._fields_[-1][0]
        own = (ctypes.sizeof(mirrored), getattr(mirrored, last).offset)
        if own != (size, offset):
            raise SteadytipError(
                f"C structure '{name}' has {size} bytes, its last field '{last}' at {offset}; "
                f"Python mirrors it with {own[0]} bytes and the field at {own[1]}. Library and "
                "Python are of different versions: remove the folder build/c, and build again."
            )
