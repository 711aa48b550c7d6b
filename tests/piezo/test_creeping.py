"""Prandtl-Ishlinskii operator with creep: against its differential equation, and its inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from fmu_src.kit.runner import Runner
from fmu_src.piezo import creeping, inverse_creeping
from fmu_src.piezo.creeping import WIDTHS
from fmu_src.piezo.modulated_stops import CREEP_TIMES
from fmu_src.piezo.prandtl_ishlinskii import DEAD_ZONES, NOMINAL, PLAYS

T = 1e-3
NANOMETRE = 1e-9
CREEP_ALONE = {
    "weights": np.eye(PLAYS)[0],
    "saturation": NOMINAL * np.eye(DEAD_ZONES)[0],
}


def parameters(seed):
    rng = np.random.default_rng(seed)
    return {
        "weights": np.diff(rng.uniform(0.1, 2.0, PLAYS), prepend=0.0),
        "saturation": NOMINAL * np.diff(rng.uniform(0.3, 2.0, DEAD_ZONES), prepend=0.0),
        "creep_thresholds": np.cumsum(rng.uniform(0, 15, WIDTHS)),
        "creep_weights": rng.uniform(0, 0.05, WIDTHS),
    }


def respond(volts, values):
    return Runner(creeping.MODEL, values).run(len(volts), {"volts": volts})["stroke"]


def invert(stroke, values):
    nested = {f"hysteresis.{name}": value for name, value in values.items()}
    runner = Runner(inverse_creeping.MODEL, {**nested, "amplifier.lowest": -200.0,
                                             "amplifier.highest": 200.0})  # fmt: skip
    return runner.run(len(stroke), {"stroke": stroke})


@pytest.mark.parametrize("threshold", [0.0, 12.0])
def test_a_step_creeps_as_the_differential_equation_says(threshold):
    """K' = dead zone (v - K) / tau, integrated by SciPy; creep of a sample shows in the next."""
    weights, held = np.eye(WIDTHS)[0] * 0.1, 50.0
    values = {**CREEP_ALONE, "creep_weights": weights, "creep_thresholds[1]": threshold}
    stroke = respond(np.full(800, held), values) / NOMINAL - held

    def slope(t, k, tau):
        way = held - k
        return (way - np.clip(way, -threshold, threshold)) / tau

    t = T * np.arange(800)
    expected = sum(
        solve_ivp(slope, (0, t[-1]), [0.0], t_eval=t, args=(tau,), rtol=1e-9, atol=1e-9).y[0]
        for tau in CREEP_TIMES
    )
    np.testing.assert_allclose(stroke, 0.1 * expected, atol=1e-6)


def test_creep_goes_with_the_logarithm_of_time():
    """Equal weights of a decade each: the same way in each decade from 30 ms to 3 s."""
    values = {**CREEP_ALONE, "creep_weights": np.eye(WIDTHS)[0] * 0.02}
    stroke = respond(np.full(3001, 50.0), values)
    ways = np.diff(stroke[[30, 300, 3000]])
    assert ways[1] == pytest.approx(ways[0], rel=0.1)


def test_moves_within_the_threshold_do_not_creep():
    values = {**CREEP_ALONE, "creep_weights": np.eye(WIDTHS)[-1] * 0.1}
    volts = np.repeat([0.0, 30.0, 5.0, 37.0], 200)
    np.testing.assert_allclose(respond(volts, values), NOMINAL * volts, atol=1e-18)


@settings(max_examples=60)
@given(arrays(float, 50, elements=st.floats(0, 100)), st.integers(0, 20), st.integers(1, 4))
def test_inverse_of_forward_is_the_voltage(volts, seed, hold):
    volts = np.repeat(volts, hold)
    values = parameters(seed)
    np.testing.assert_allclose(invert(respond(volts, values), values)["volts"], volts, atol=1e-6)


@settings(max_examples=60)
@given(arrays(float, 50, elements=st.floats(0, 14e-6)), st.integers(0, 20))
def test_forward_of_inverse_is_the_stroke(stroke, seed):
    values = parameters(seed)
    sent = invert(stroke, values)
    kept = sent["limited"] == 0
    error = np.abs(respond(sent["volts"], values) - stroke)[kept]
    assert error.max(initial=0.0) < NANOMETRE


def test_a_horizon_puts_the_stroke_where_the_demand_will_be():
    t = T * np.arange(200)
    demand = 3e-6 + 1e-5 * t + 4e-5 * t**2
    runner = Runner(inverse_creeping.MODEL, {"horizon": 2 * T})
    reached = respond(runner.run(200, {"stroke": demand})["volts"], {})
    np.testing.assert_allclose(reached[3:-2], demand[5:], atol=NANOMETRE)


def test_shipped_weights_creep_and_have_an_inverse():
    runner = Runner(inverse_creeping.MODEL)
    names = [scalar.name for scalar in runner.model.derived.scalars()]
    assert runner.d[names.index("inverse.defined")] == 1
    assert max(creeping.Creeping.fields["creep_weights"].start) > 0
