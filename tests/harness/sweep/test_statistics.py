"""Intervals and rankings of a sweep against closed forms, and how often they hold."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from harness.sweep.statistics import influences_of, levels_of, mean_of, summary_of

numbers = arrays(float, st.integers(2, 50), elements=st.floats(-1e3, 1e3))


@given(numbers)
def test_the_interval_of_the_mean_is_that_of_the_t_test(values):
    mean, low, high = mean_of(values)
    if np.ptp(values) > 1e-6:
        wanted = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
        assert (low, high) == pytest.approx((wanted.low, wanted.high), rel=1e-9, abs=1e-9)
    assert low <= mean <= high


@given(numbers)
def test_a_summary_is_in_order_and_leaves_out_what_is_missing(values):
    found = summary_of(np.concatenate([values, [math.nan, math.inf]]))
    assert found.count == len(values)
    assert found.least <= found.median <= found.most
    assert (found.least, found.most) == (values.min(), values.max())


def test_without_values_nothing_is_said():
    assert summary_of(np.array([math.nan])).count == 0
    assert math.isnan(summary_of(np.array([1.0])).low)
    assert influences_of(np.ones(100), {"x": np.arange(100.0)}) == []
    assert influences_of(np.arange(3.0), {"x": np.arange(3.0)}) == []


def ishigami(runs: int, seed: int):
    """A function whose indices are known: Ishigami and Homma (1990), a = 7, b = 0.1."""
    x = np.random.default_rng(seed).uniform(-np.pi, np.pi, (runs, 3))
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    a, b = 7.0, 0.1
    whole = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    first = 0.5 * (1 + b * np.pi**4 / 5) ** 2
    return (
        y,
        dict(zip("abc", x.T, strict=True)),
        {"a": first / whole, "b": a**2 / 8 / whole, "c": 0},
    )


def test_shares_are_the_first_order_indices_of_a_known_function():
    y, x, wanted = ishigami(4000, 1)
    found = {each.variable: each for each in influences_of(y, x)}
    for name, share in wanted.items():
        # Classes of a finite width lose some of the variance within them.
        assert found[name].share == pytest.approx(share, abs=0.03)
    # b and c act without going up or down: ranks cannot see them.
    assert abs(found["b"].rho) < 0.05
    assert found["a"].rho_low > 0.3


def test_intervals_of_a_share_hold_as_often_as_they_say():
    within = []
    for seed in range(30):
        y, x, wanted = ishigami(300, seed)
        found = {each.variable: each for each in influences_of(y, x)}
        within += [
            found[n].share_low - 0.02 <= wanted[n] <= found[n].share_high + 0.02 for n in "abc"
        ]
    # 90 intervals that are not independent; nine in ten is the least that 95 % can look like.
    assert np.mean(within) > 0.88


def test_intervals_of_a_rank_correlation_hold_as_often_as_they_say():
    generator = np.random.default_rng(2)
    rho = 0.6
    spearman = 6 / np.pi * np.arcsin(rho / 2)  # of a binormal pair
    within = []
    for _ in range(150):
        x = generator.standard_normal(80)
        y = rho * x + math.sqrt(1 - rho**2) * generator.standard_normal(80)
        (found,) = influences_of(y, {"x": x})
        within.append(found.rho_low <= spearman <= found.rho_high)
    assert 0.90 < np.mean(within) < 0.99


def test_nothing_is_made_of_a_variable_without_influence():
    generator = np.random.default_rng(3)
    shares, low = [], []
    for _ in range(40):
        y, x = generator.standard_normal(150), generator.uniform(size=150)
        (found,) = influences_of(y, {"x": x})
        shares.append(found.share)
        low.append(found.rho_low <= 0.0 <= found.rho_high)
    assert np.mean(shares) < 0.03
    assert np.mean(low) > 0.85


def test_the_strongest_comes_first_with_and_without_order():
    generator = np.random.default_rng(4)
    names = np.array(["p", "q", "r"], dtype=object)[generator.integers(0, 3, 600)]
    weak, idle = generator.uniform(size=600), generator.uniform(size=600)
    y = 3.0 * (names == "q") + 0.8 * weak + 0.1 * generator.standard_normal(600)
    found = influences_of(y, {"idle": idle, "weak": weak, "names": names})
    assert [each.variable for each in found] == ["names", "weak", "idle"]
    assert found[0].rho is None
    assert found[0].share > 0.9


def test_main_effects_of_a_full_grid_add_up_with_their_interaction():
    a, b = (axis.ravel().astype(float) for axis in np.meshgrid(range(5), range(6)))
    found = {e.variable: e for e in influences_of(2 * a + b**2, {"a": a, "b": b}, listed=True)}
    variance = {"a": np.var(2 * a), "b": np.var(b**2)}
    for name in "ab":
        wanted = variance[name] / sum(variance.values())
        assert found[name].share == pytest.approx(wanted, abs=1e-9)


@given(arrays(float, st.integers(20, 300), elements=st.floats(0, 1), unique=True))
@settings(max_examples=50)
def test_classes_are_in_order_and_of_equal_size(x):
    classes = levels_of(x, False)
    assert np.all(np.diff(classes[np.argsort(x)]) >= 0)
    sizes = np.bincount(classes)
    assert sizes.max() - sizes.min() <= 1
    assert len(sizes) <= 24
