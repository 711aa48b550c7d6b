"""Equations solved by blocks, against NumPy."""

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.tremor import blocks

SIZE, COUNT = 3, 4
N = SIZE * COUNT


def _recorded() -> ca.Function:
    R, r = ca.MX.sym("R", N, N), ca.MX.sym("r", N)
    cuts = [slice(SIZE * i, SIZE * (i + 1)) for i in range(COUNT)]
    rows = [[R[a, b] for b in cuts[: i + 1]] for i, a in enumerate(cuts)]
    for i, row in enumerate(rows):
        row[i] = ca.tril(row[i])
    solution = blocks.solve(rows, [r[a].T for a in cuts])
    return ca.Function("solve", [R, r], [ca.vertcat(*solution)])


SOLVE = _recorded()


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
def test_solution_is_that_of_numpy(seed, decades):
    """Symmetric positive equations up to a condition of a million; their upper half is not read."""
    generator = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(generator.standard_normal((N, N)))
    R = turned @ np.diag(np.logspace(-decades, decades, N)) @ turned.T
    wanted = generator.standard_normal(N)
    halved = np.tril(R) + np.triu(generator.standard_normal((N, N)), 1)
    found = np.array(SOLVE(halved, R @ wanted)).ravel()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8)
