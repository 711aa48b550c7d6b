"""Functions of records are CasADi functions of columns."""

import numpy as np
import pytest

from fmu_src.kit.functions import by_elements, by_matrices
from fmu_src.kit.records import State, real


class Pair(State):
    left = real("m", "left")
    right = real("m", "right", shape=2)


def swap(pair, factor):
    return pair.replace(left=factor * pair.right[0]), factor


@pytest.mark.parametrize("record", [by_elements, by_matrices])
def test_records_are_packed(record):
    function = record("swap", swap, Pair, 1)
    assert function.name() == "swap"
    found, factor = function([1.0, 2.0, 3.0], 4.0)
    np.testing.assert_array_equal(found.full().ravel(), [8.0, 2.0, 3.0])
    assert float(factor) == 4.0


def test_one_result_needs_no_tuple():
    assert float(by_elements("double", lambda x: 2 * x, 1)(3.0)) == 6.0
