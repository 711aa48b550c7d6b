"""A04 table 2.4 beside formulas and a solver of its own."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from harness.reproduce.papers.a04 import table_2_4
from tests.harness.reproduce.conftest import run_item

D1, D2, D3 = 20.2e-3, 14.3e-3, 116.0e-3
P12, P23, P13 = np.array([[-D1, D1, 0], [D2, D2 - D1, D3], [D2 - D1, D2, D3]])
"""A04 2.54."""
INVERSE = np.array(
    [
        [-1 / (2 * D3), -1 / (2 * D3), 1 / (2 * D1)],
        [1 / (2 * D3), 1 / (2 * D3), 1 / (2 * D1)],
        [-1 / (2 * D2), 1 / (2 * D2), D3 / (2 * D1 * D2)],
    ]
)
"""Of P_D (2.16, with its erratum) in letters."""


@pytest.fixture(scope="module")
def outcome():
    return run_item("table-2.4")


def _measured(outcome, quantity):
    return np.array([f.measured for f in outcome.figures if f.quantity.startswith(quantity)])


def _paper(outcome, quantity):
    return np.array([f.paper for f in outcome.figures if f.quantity.startswith(quantity)])


def test_accelerations_of_table_2_4_are_within_5_percent(outcome) -> None:
    for quantity in ("acceleration, one channel", "acceleration, two channels"):
        np.testing.assert_allclose(
            _measured(outcome, quantity), _paper(outcome, quantity), rtol=0.05
        )


def test_rates_of_table_2_4_are_within_5_percent_from_unit_covariance(outcome) -> None:
    """And from nothing else: see the item's notes."""
    quantity = "the same with unit covariance"
    np.testing.assert_allclose(_measured(outcome, quantity), _paper(outcome, quantity), rtol=0.05)
    letters = INVERSE @ INVERSE.sum(axis=0)
    formula = np.degrees(1e-3 * np.sqrt(letters * 2) * 1e-3)
    np.testing.assert_allclose(_measured(outcome, quantity), formula, rtol=1e-3)


def test_rates_of_table_2_4_are_not_those_of_the_stated_noise(outcome) -> None:
    """7 and 20 times as much: 0.046 deg/s about x and y, 0.37 about z, by letters and by draws."""
    sigma = 2.25e-3 * 9.80131
    formula = np.degrees(1e-3 * np.sqrt(2 * (INVERSE**2).sum(axis=1)) * sigma)
    for quantity in ("rate, root of the variance, about", "rate, root of the variance, by sigma"):
        np.testing.assert_allclose(_measured(outcome, quantity), formula, rtol=0.03)
    ratio = formula / _paper(outcome, "rate, root of the variance, about")
    np.testing.assert_allclose(ratio, [7.0, 7.0, 19.6], rtol=0.01)


def test_rates_solve_the_equations_of_motion() -> None:
    """(2.4) and (2.5) by SciPy's solver, for differences large enough to be curved."""
    T = table_2_4.T

    def difference(w, before, p, axis):
        return (np.cross(w, np.cross(w, p)) + np.cross((w - before) / T, p))[axis]

    rng = np.random.default_rng(2)
    for A_D in rng.normal(size=(5, 3)) * 3.0:

        def equations(w, A_D=A_D):
            before = np.zeros(3)
            return [
                difference(w, before, p, axis) - a
                for axis, (p, a) in enumerate(zip((P13, P23, P12), A_D, strict=True))
            ]

        solved = fsolve(equations, INVERSE @ A_D * T, xtol=1e-12)
        found = table_2_4.rates(A_D[:, None]).ravel()
        np.testing.assert_allclose(found, solved, rtol=1e-6, atol=1e-9)
        assert np.abs(solved - INVERSE @ A_D * T).max() > 1e-6
