"""Symmetric equations by blocks: R a = r, R = L D L^T with unit lower triangular L.

    A_IJ <- A_IJ - sum_K<J W_IK L_JK^T,  W_IK = L_IK D_K      `less`, of what lies to the left
    A_JJ = L_JJ D_J L_JJ^T                                    `factored`, by elements
    W_IJ = A_IJ L_JJ^-T,  L_IJ = W_IJ D_J^-1                  `across`
    a_J  = L_JJ^-T (L_rJ^T - sum_I>J L_IJ^T a_I)              `back`

The right side r^T is a block row below R, so that elimination solves for it on the way. Each of the
four is recorded by elements, for a block of some size, and called for every block: straight code
that a compiler turns into a few hundred instructions, where general sparse ones jump for each
product. No module of FMUs, but what those that solve equations are made of.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import casadi as ca

from fmu_src.kit.functions import by_elements


def _triangular(size: int) -> ca.Sparsity:
    """Return the sparsity pattern below the diagonal."""
    return ca.tril(ca.DM.ones(size, size), False).sparsity()


@cache
def _less(rows: int, size: int) -> ca.Function:
    """Record (A, W, L) -> A - W L^T, for a block beside the diagonal or the right side's row."""
    block = ca.Sparsity.dense(rows, size)
    return by_elements(
        "less", lambda A, W, L: A - W @ L.T, block, block, ca.Sparsity.dense(size, size)
    )


@cache
def _less_below(size: int) -> ca.Function:
    """Record (A, W, L) -> lower half of A - W L^T, for a block on the diagonal."""
    half, whole = ca.Sparsity.lower(size), ca.Sparsity.dense(size, size)
    return by_elements("less_below", lambda A, W, L: A - ca.tril(W @ L.T), half, whole, whole)


@cache
def _factored(size: int) -> ca.Function:
    """Record A, its lower half, -> L without its diagonal, 1 / D."""

    def factored(A: Any) -> tuple[Any, Any]:
        lower = ca.SX(_triangular(size), 0)
        pivots: list[Any] = []
        for j in range(size):
            scaled = [lower[j, k] * pivots[k] for k in range(j)]
            pivots.append(A[j, j] - sum(lower[j, k] * scaled[k] for k in range(j)))
            for i in range(j + 1, size):
                rest = A[i, j] - sum(lower[i, k] * scaled[k] for k in range(j))
                lower[i, j] = rest / pivots[j]
        return lower, 1 / ca.vertcat(*pivots)

    return by_elements("factored", factored, ca.Sparsity.lower(size))


@cache
def _across(rows: int, size: int) -> ca.Function:
    """Record (A, L without its diagonal, 1 / D) -> W, W D^-1."""

    def across(A: Any, lower: Any, inverse: Any) -> tuple[Any, Any]:
        columns: list[Any] = []
        for j in range(size):
            columns.append(A[:, j] - sum(columns[k] * lower[j, k] for k in range(j)))
        W = ca.horzcat(*columns)
        return W, ca.horzcat(*(columns[j] * inverse[j] for j in range(size)))

    return by_elements(
        "across",
        across,
        ca.Sparsity.dense(rows, size),
        _triangular(size),
        ca.Sparsity.dense(size),
    )


@cache
def _back(size: int) -> ca.Function:
    """Record (a, L without its diagonal) -> L^-T a."""

    def back(a: Any, lower: Any) -> Any:
        solved: list[Any] = [None] * size
        for j in reversed(range(size)):
            solved[j] = a[j] - sum(lower[k, j] * solved[k] for k in range(j + 1, size))
        return ca.vertcat(*solved)

    return by_elements("back", back, ca.Sparsity.dense(size), _triangular(size))


@cache
def _moved(size: int) -> ca.Function:
    """Record (a, L, a_I) -> a - L^T a_I."""
    column = ca.Sparsity.dense(size)
    return by_elements(
        "moved", lambda a, L, b: a - L.T @ b, column, ca.Sparsity.dense(size, size), column
    )


def solve(blocks: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
    """Solve R a = r, block by block.

    Args:
        blocks: rows of blocks of R up to the diagonal, each (size, size); of those on it the lower
            half.
        right: blocks of r^T, each (1, size).

    Returns:
        Blocks of a, each (size,).
    """
    size = right[0].shape[1]
    rows: list[list[Any]] = [[*row] for row in blocks] + [[*right]]
    by_pivots: list[list[Any]] = [[] for _ in rows]  # W
    unit: list[list[Any]] = [[] for _ in rows]  # L
    lower = []
    for j in range(len(right)):
        for i in range(j, len(rows)):
            A = rows[i][j]
            for k in range(j):
                less = _less_below(size) if i == j else _less(A.shape[0], size)
                A = less(A, by_pivots[i][k], unit[j][k])
            if i == j:
                factor, inverse = _factored(size)(A)
                lower.append(factor)
            else:
                W, L = _across(A.shape[0], size)(A, factor, inverse)
                by_pivots[i].append(W)
                unit[i].append(L)
    solved: list[Any] = [None] * len(right)
    for j in reversed(range(len(right))):
        a = unit[-1][j].T
        for i in range(j + 1, len(right)):
            a = _moved(size)(a, unit[i][j], solved[i])
        solved[j] = _back(size)(a, lower[j])
    return solved
