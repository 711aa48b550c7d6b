"""The cascade neural filter against the network written out, and where there is no position."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j0, j1

from fmu_src.kit.runner import Runner
from fmu_src.tremor.cascade_neural import ACTIVATIONS, HIDDEN, INPUTS, MODEL, SPACINGS

FUNCTIONS = {
    0: lambda z: 0.0,
    1: lambda z: 2 / (1 + np.exp(-z)) - 1,
    2: lambda z: np.exp(-(z**2)),
    3: np.sin,
    4: j0,
}


def _motion(samples, seed=1):
    return 1e-5 * np.cumsum(np.random.default_rng(seed).standard_normal((samples, 3)), axis=0)


def test_without_training_the_motion_passes_and_the_error_is_nothing():
    position = _motion(700)
    out = Runner(MODEL).run(len(position), {"position": position})
    np.testing.assert_allclose(out["motion"], position, atol=1e-18)
    np.testing.assert_allclose(out["error"], 0.0, atol=1e-18)


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1), st.integers(1, SPACINGS))
def test_is_the_equations(seed, spacing):
    """Any weights and kinds, one sample of one axis at a time, in plain NumPy."""
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, 5, HIDDEN)
    w, c = rng.normal(0, 0.1, (HIDDEN, INPUTS)), rng.normal(0, 1, (HIDDEN, HIDDEN))
    v, g = rng.normal(0, 0.1, INPUTS), rng.normal(0, 1, HIDDEN)
    b, bias = rng.normal(0, 1, HIDDEN), rng.normal()
    origin, a_u, a_y = np.array([1e-4, -2e-4, 0.0]), 2e-4, 3e-5
    values = {
        "spacing": spacing, "origin": origin, "input_scale": a_u, "output_scale": a_y,
        "output.weights": v, "output.hidden": g, "output.bias": bias,
    }  # fmt: skip
    for i in range(HIDDEN):
        prefix = f"unit_{i + 1}."
        values |= {prefix + "kind": kinds[i], prefix + "weights": w[i], prefix + "bias": b[i]}
        values[prefix + "earlier"] = c[i]
    position = _motion(560, seed)
    out = Runner(MODEL, values).run(len(position), {"position": position})
    for k, axis in ((0, 0), (150, 1), (559, 2)):
        s = np.concatenate((np.full(600, position[0, axis]), position[: k + 1, axis]))
        u = (s[::-1][::spacing][:INPUTS] - origin[axis]) / a_u
        h = []
        for i in range(HIDDEN):
            h.append(FUNCTIONS[kinds[i]](w[i] @ u + np.dot(c[i, :i], h) + b[i]))
        expected = origin[axis] + a_y * (v @ u + np.dot(g, h) + bias)
        assert out["motion"][k, axis] == pytest.approx(expected, abs=1e-6 * a_y)
        assert out["error"][k, axis] == pytest.approx(position[k, axis] - expected, abs=1e-10)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_slopes_are_those_of_the_activations(name):
    activation, z, step = ACTIVATIONS[name], np.linspace(-12, 12, 997), 1e-5
    difference = (activation.value(z + step, np) - activation.value(z - step, np)) / (2 * step)
    np.testing.assert_allclose(activation.slope(z, np), difference, atol=1e-8)


def test_bessel_units_are_the_function_as_far_as_they_say():
    z = np.linspace(-16, 16, 2001)
    np.testing.assert_allclose(ACTIVATIONS["bessel"].value(z, np), j0(z), atol=1e-7)
    np.testing.assert_allclose(ACTIVATIONS["bessel"].slope(z, np), -j1(z), atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_position_leaves_no_trace(bad):
    """Whether it says to be valid or not: the last one goes on, and the next is taken as it is."""
    weights = np.zeros(INPUTS)
    weights[:40] = 1 / 40
    values = {"output.weights": weights, "spacing": 2}
    position = _motion(400)
    held = position.copy()
    held[100:120] = held[99]
    expected = Runner(MODEL, values).run(400, {"position": held})["motion"]
    for valid in (True, False):
        trusted = np.ones(400)
        trusted[100:120] = valid
        broken = position.copy()
        broken[100:120] = bad
        out = Runner(MODEL, values).run(400, {"position": broken, "valid": trusted})
        np.testing.assert_array_equal(out["motion"], expected)
        assert np.isfinite(out["error"]).all()


def test_before_the_first_position_the_place_that_is_held_is_put_out():
    place = [1e-3, 2e-3, -1e-3]
    valid = np.arange(20) >= 10
    position = np.tile([1.1e-3, 2.2e-3, -1.3e-3], (20, 1))
    out = Runner(MODEL, {"origin": place, "output.bias": 1.0}).run(
        20, {"position": position, "valid": valid}
    )
    np.testing.assert_allclose(out["motion"][:10], np.tile(place, (10, 1)), atol=1e-15)
    assert not out["error"][:10].any()
    np.testing.assert_allclose(out["motion"][10:], position[10:] + 1e-4, atol=1e-15)
