"""Modulated stops: against a plain sum of stops, their limits, and their step-wise inverse."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fmu_src.kit.runner import Runner
from fmu_src.piezo import inverse_modulated_stops as inverse
from fmu_src.piezo import modulated_stops as operator
from fmu_src.piezo.modulated_stops import LAGS, STOPS, Stops

T = 1e-3
NANOMETRE = 1e-9
AHEAD = {"horizon": 0.0}
"""The demand is the stroke at the end of the sample."""


def parameters(seed):
    """A random operator that rises."""
    rng = np.random.default_rng(seed)
    return {
        "polynomial": [2e-5, *rng.uniform(-1e-6, 1e-6, 2)],
        "thresholds": np.cumsum(rng.uniform(0.5, 5.0, STOPS)),
        "weights_low": rng.uniform(0, 1e-6, STOPS),
        "weights_high": rng.uniform(0, 1e-6, STOPS),
        "creep": rng.uniform(0, 3e-7, LAGS),
        "lead": rng.uniform(-2e-5, 1e-4),
    }


def of_operator(values):
    return {f"operator.{name}": value for name, value in values.items()}


def respond(volts, values=None):
    return Runner(operator.MODEL, values).run(len(volts), {"volts": volts})["stroke"]


def invert(stroke, values=None, **more):
    found = {**of_operator(values or {}), **more}
    return Runner(inverse.MODEL, found).run(len(stroke), {"stroke": stroke})


def witness(volts, p):
    """The equations of the module's docstring, sample by sample."""
    plays, crept, before = np.zeros(STOPS), np.zeros(LAGS), 0.0
    strokes = []
    for v in volts:
        plays = np.clip(plays, v - p.thresholds, v + p.thresholds)
        left = np.exp(-T / p.creep_time)
        crept = left * crept + (1 - left) * before / p.span
        a = v / p.span
        loading = np.polyval([*p.polynomial[::-1], 0.0], a)
        weights = (1 - a) * p.weights_low + a * p.weights_high
        lead = p.lead * p.polynomial[0] * (a - before / p.span) / T
        strokes.append(loading - weights @ (a - plays / p.span) + p.creep @ crept + lead)
        before = v
    return np.array(strokes)


@pytest.mark.parametrize("seed", range(3))
def test_stroke_is_that_of_the_equations(seed):
    values = parameters(seed)
    volts = np.random.default_rng(seed).uniform(0, 100, 400)
    p = Stops.unpack(Stops.starts()).replace(**{k: np.asarray(v) for k, v in values.items()})
    numbers = p.replace(span=100.0, lead=values["lead"], creep_time=np.array(operator.CREEP_TIMES))
    np.testing.assert_allclose(respond(volts, values), witness(volts, numbers), atol=1e-18)


def test_stops_of_equal_ends_are_a_prandtl_ishlinskii_operator():
    """Weights w of plays, w_0 of the voltage itself: p_1 = w_0 + sum w, stops weigh w."""
    rng = np.random.default_rng(7)
    weights, direct = rng.uniform(0, 1e-6, STOPS), 5e-6
    thresholds = np.cumsum(rng.uniform(1, 4, STOPS))
    volts = rng.uniform(0, 100, 300)
    plays, expected = np.zeros(STOPS), []
    for v in volts:
        plays = np.clip(plays, v - thresholds, v + thresholds)
        expected.append(direct * v / 100 + weights @ plays / 100)
    values = {
        "polynomial": [direct + weights.sum(), 0.0, 0.0],
        "thresholds": thresholds,
        "weights_low": weights,
        "weights_high": weights,
        "creep": np.zeros(LAGS),
        "lead": 0.0,
    }
    np.testing.assert_allclose(respond(volts, values), expected, atol=1e-19)


_walks = arrays(float, 60, elements=st.floats(0, 100))


@settings(max_examples=60)
@given(_walks, st.integers(0, 20), st.integers(1, 4))
def test_inverse_of_forward_is_the_voltage(volts, seed, hold):
    """Any reversals, any rate: a voltage comes back from the stroke that it gives."""
    volts = np.repeat(volts, hold)
    values = parameters(seed)
    found = invert(respond(volts, values), values, **AHEAD)
    np.testing.assert_allclose(found["volts"], volts, atol=1e-6)
    assert not found["limited"].any()


@settings(max_examples=60)
@given(arrays(float, 60, elements=st.floats(3e-6, 12e-6)), st.integers(0, 20))
def test_forward_of_inverse_is_the_stroke(stroke, seed):
    """Within a nanometre wherever the voltage was not limited, and from there on too."""
    values = parameters(seed)
    found = invert(stroke, values, **AHEAD)
    error = np.abs(respond(found["volts"], values) - stroke)
    assert np.all(error[found["limited"] == 0] < NANOMETRE)
    assert np.all((found["volts"] >= 0) & (found["volts"] <= 100))


@settings(max_examples=30)
@given(arrays(float, 40, elements=st.floats(-1e-3, 1e-3)), st.integers(0, 20))
def test_any_demand_keeps_the_voltage_in_range_and_tells(stroke, seed):
    found = invert(stroke, parameters(seed), **AHEAD)
    assert np.all((found["volts"] >= 0) & (found["volts"] <= 100))
    reached = respond(found["volts"], parameters(seed))
    np.testing.assert_array_equal(found["limited"] == 1, np.abs(reached - stroke) > 0.1e-9)


def test_shipped_operator_has_an_inverse():
    runner = Runner(operator.MODEL)
    derived = dict(zip([s.name for s in operator.Constants.scalars()], runner.d, strict=True))
    assert derived["defined"] == 1
    assert derived["smallest_slope"] > 0.1 * operator.NOMINAL


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        ({"weights_low": np.full(STOPS, 3e-6)}, "stops heavier than the loading rises"),
        ({"thresholds": np.linspace(50, 1, STOPS)}, "thresholds that fall"),
        ({"lead": -2e-3}, "a lag that makes the inverse swing"),
        ({"polynomial": [2e-5, -2e-5, 0.0]}, "loading that falls at the top"),
    ],
)
def test_operators_without_an_inverse_are_told(spoil, why):
    runner = Runner(operator.MODEL, spoil)
    assert runner.d[-1] == 0, why
    volts = invert(np.linspace(0, 1e-5, 50), spoil, **AHEAD)["volts"]
    assert np.all(np.isfinite(volts))
    assert np.all((volts >= 0) & (volts <= 100))


@settings(max_examples=30)
@given(st.integers(0, 20), arrays(float, 30, elements=st.floats(0, 100)))
def test_smallest_slope_is_a_lower_bound(seed, volts):
    """Finite differences over the voltage of one sample, from any memory."""
    runner = Runner(operator.MODEL, parameters(seed))
    runner.run(len(volts), {"volts": volts})
    memory = runner.x.copy()
    strokes = []
    for v in np.linspace(0, 100, 41):
        runner.x[:] = memory
        strokes.append(runner.run(1, {"volts": v})["stroke"][0])
    smallest = dict(zip([s.name for s in operator.Constants.scalars()], runner.d, strict=True))
    assert np.diff(strokes).min() / 2.5 >= smallest["smallest_slope"] * (1 - 1e-9)


def test_horizon_puts_the_stroke_where_the_demand_will_be():
    """A parabola is extrapolated exactly; without a horizon the stroke is a sample early."""
    t = T * np.arange(200)
    demand = 6e-6 + 2e-5 * t + 4e-5 * t**2
    reached = respond(invert(demand)["volts"])
    np.testing.assert_allclose(reached[3:-1], demand[4:], atol=NANOMETRE)
    early = respond(invert(demand, **AHEAD)["volts"])
    np.testing.assert_allclose(early[3:], demand[3:], atol=NANOMETRE)


def test_first_demand_is_not_extrapolated_from_nothing():
    """Three samples are needed for a parabola, two for a line."""
    reached = respond(invert(np.full(5, 8e-6))["volts"])
    np.testing.assert_allclose(reached, 8e-6, atol=NANOMETRE)


@pytest.mark.parametrize("horizon", [0.0, T])
def test_gain_adapts_to_a_stack_that_has_drifted(horizon):
    """A stack of 5 % more gain, 0.07 um of sensor noise: found within half a percent."""
    t = T * np.arange(20_000)
    demand = 9e-6 + 3e-6 * np.sin(2 * np.pi * 9 * t)
    rng = np.random.default_rng(3)
    runner = Runner(inverse.MODEL, {"horizon": horizon, "adaptation_time": 2.0})
    stack = Runner(operator.MODEL)
    reached, gain = 0.0, []
    for k, wanted in enumerate(demand):
        measured = reached + 0.07e-6 * rng.standard_normal()
        found = runner.run(
            1, {"stroke": wanted, "measured": measured, "measured_valid": float(k > 0)}
        )
        reached = 1.05 * stack.run(1, {"volts": found["volts"]})["stroke"][0]
        gain.append(found["gain"][0])
    assert gain[0] == 1.0
    assert np.mean(gain[-5000:]) == pytest.approx(1.05, abs=0.005)
    assert np.std(gain[-5000:]) < 0.005


def test_gain_stays_without_leave_to_learn():
    t = T * np.arange(500)
    demand = 9e-6 + 3e-6 * np.sin(2 * np.pi * 9 * t)
    inputs = {"stroke": demand, "measured": 2 * demand}
    still = Runner(inverse.MODEL, {"adaptation_time": 1.0}).run(500, inputs)
    assert np.all(still["gain"] == 1.0)
    off = Runner(inverse.MODEL).run(500, {**inputs, "measured_valid": 1.0})
    assert np.all(off["gain"] == 1.0)


@given(st.integers(0, 2**32 - 1), st.floats(1e-8, 1e-5))
def test_the_short_way_finds_what_the_search_finds(seed, pace):
    """A random walk of the demand: where no break point lies between, both give one voltage."""
    records = (Stops, operator.Constants, inverse.Range)
    values = [ca.DM(record.starts()) for record in records]
    values[1] = DERIVE(values[0])
    memory = np.array(operator.Memory.starts())
    steps = pace * np.random.default_rng(seed).standard_normal(60)
    short = 0
    for stroke in np.clip(7e-6 + np.cumsum(steps), -1e-6, 16e-6):
        volts, found, searched, memory = WAYS(*values, stroke, memory)
        if found:
            assert float(volts) == pytest.approx(float(searched), abs=1e-9)
            short += 1
    assert short > 0


def _ways() -> tuple[ca.Function, ca.Function]:
    records = (Stops, operator.Constants, inverse.Range)
    p, d, a = (ca.SX.sym(record.__name__, record.size()) for record in records)
    stroke, memory = ca.SX.sym("stroke"), ca.SX.sym("x", operator.Memory.size())
    stops, constants = Stops.unpack(p), operator.Constants.unpack(d)
    x = operator.Memory.unpack(memory)
    given_to_both = (stops, constants, records[2].unpack(a), stroke, x)
    volts, found = inverse.nearby(*given_to_both)
    searched = inverse.anywhere(*given_to_both)
    following = operator.remember(stops, constants, searched, x).pack()
    derived = operator.derive(stops, T).pack()
    return (
        ca.Function("derive", [p], [derived]),
        ca.Function("ways", [p, d, a, stroke, memory], [volts, found, searched, following]),
    )


DERIVE, WAYS = _ways()
