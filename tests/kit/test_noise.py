import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri

from fmu_src.kit.noise import standard_normal, uniforms


@given(st.integers(0, 2**31 - 1), st.integers(0, 1000), st.integers(1, 9))
def test_any_piece_of_the_stream_can_be_had_alone(seed, first, draws) -> None:
    """Samples from the middle equal those of one run from the start, by NumPy's own generator."""
    words = np.random.Philox(key=seed).random_raw((first + 5) * draws)
    expected = ((words >> 11) + 0.5) / 2**53
    np.testing.assert_array_equal(
        uniforms(seed, first, 5, draws).ravel(), expected[first * draws :]
    )


def test_quantile_is_that_of_scipy_to_rounding() -> None:
    """Independent witness, from 1e-16 in either tail to the centre."""
    tail = np.logspace(-16, np.log10(0.5), 4000)
    u = np.concatenate([tail, 1 - tail[tail > 1e-15]])
    symbol = ca.SX.sym("u", len(u))
    z = np.array(ca.Function("f", [symbol], [standard_normal(symbol)])(u)).ravel()
    np.testing.assert_allclose(z, ndtri(u), rtol=5e-15, atol=1e-15)


def test_smallest_and_largest_uniform_are_finite() -> None:
    for u in (2.0**-54, 1 - 2.0**-54, 0.5):
        assert np.isfinite(float(ca.DM(standard_normal(ca.SX(u)))))


def test_draws_are_standard_normal_and_seeds_differ() -> None:
    symbol = ca.SX.sym("u", 2)
    quantile = ca.Function("f", [symbol], [standard_normal(symbol)])
    a, b = (np.array(quantile(uniforms(seed, 0, 20000, 2).T)) for seed in (1, 2))
    assert abs(a.mean()) < 0.02
    assert a.std() == pytest.approx(1, abs=0.02)
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02
