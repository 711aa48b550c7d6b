"""Sums and extremes by pairs: in a row, each operation would wait for the one before it."""

from collections.abc import Callable
from typing import Any

import casadi as ca


def by_pairs(operation: Callable[[Any, Any], Any], values: list[Any]) -> Any:
    """Reduce some values by an associative operation."""
    while len(values) > 1:
        rest = values[len(values) // 2 * 2 :]
        pairs = zip(values[::2], values[1::2], strict=False)
        values = [operation(one, other) for one, other in pairs] + rest
    return values[0]


def pairwise_sum(column: Any) -> Any:
    """Sum of the elements of a column."""
    return by_pairs(lambda one, other: one + other, ca.vertsplit(column))


def pairwise_min(column: Any) -> Any:
    """Least element of a column."""
    return by_pairs(ca.fmin, ca.vertsplit(column))
