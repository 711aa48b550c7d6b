"""Choices of which C evaluates one side only, and sums by pairs."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.kit.lazy_select import lazy_select
from fmu_src.math import pairwise as pairs


def _chosen() -> ca.Function:
    condition, x, M = ca.SX.sym("condition"), ca.SX.sym("x", 2), ca.SX.sym("M", 2, 2)
    results = lazy_select(
        "turn",
        condition,
        lambda x, M: [M @ x, ca.log(x[0])],
        lambda x, M: [x, ca.SX(0)],
        x,
        M,
    )
    return ca.Function("chosen", [condition, x, M], results)


CHOSEN = _chosen()
M = np.array([[1.0, 2.0], [3.0, 4.0]])


def test_the_side_that_is_chosen_comes_out():
    product, logarithm = CHOSEN(1, [2.0, 3.0], M)
    np.testing.assert_array_equal(np.array(product).ravel(), [8.0, 18.0])
    assert float(logarithm) == np.log(2.0)
    kept, nothing = CHOSEN(0, [2.0, 3.0], M)
    np.testing.assert_array_equal(np.array(kept).ravel(), [2.0, 3.0])
    assert float(nothing) == 0.0


def test_the_other_side_is_not_evaluated():
    """It is a call in the recording, and a branch in C."""
    assert CHOSEN.n_instructions() < 20
    generator = ca.CodeGenerator("chosen.c")
    generator.add(CHOSEN)
    text = generator.dump()
    assert "if (casadi_" in text
    assert "log(" not in text.partition("/* chosen:")[2]


def test_its_derivative_is_that_of_the_side_chosen():
    x = ca.SX.sym("x", 2)
    slope = ca.Function("slope", [x], [ca.jacobian(CHOSEN(1, x, M)[0], x)])
    np.testing.assert_array_equal(np.array(slope([2.0, 3.0])), M)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20))
def test_sums_and_extremes_by_pairs(values):
    column = ca.DM(values)
    assert float(pairs.pairwise_min(column)) == min(values)
    assert float(pairs.pairwise_sum(column)) == pytest.approx(sum(values), abs=1e-9)
