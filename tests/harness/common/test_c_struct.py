"""Mirrored C structures: a misspelt field and another layout are refused."""

import ctypes

import pytest

from fmu_src.errors import SteadytipError
from harness.common.c_struct import MirroredStruct, check_layout
from harness.loop import native


class _Point(MirroredStruct):
    _fields_ = (("x", ctypes.c_double), ("y", ctypes.c_double))


def test_a_field_that_c_does_not_have_is_refused() -> None:
    point = _Point(x=1.0)
    point.y = 2.0
    with pytest.raises(AttributeError, match="_Point has no field 'z'"):
        point.z = 3.0
    with pytest.raises(AttributeError, match="'z'"):
        _Point(z=3.0)


def test_the_loop_has_the_layout_of_its_library() -> None:
    library = native.library()
    assert library is not None
    check_layout(library, {"loop": native._Loop, "part": native._Part, "access": native._Access})


def test_another_layout_is_refused_with_a_cure() -> None:
    class Longer(native._Part):
        _fields_ = (("more", ctypes.c_double),)

    with pytest.raises(SteadytipError, match=r"'part' has \d+ bytes.*remove the folder build/c"):
        check_layout(native.library(), {"part": Longer})
