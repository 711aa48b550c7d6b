"""Rate-dependent operator: its slopes, its singular rate, and an inverse that keeps in step."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fmu_src.kit.runner import Runner
from fmu_src.piezo import inverse_rate_dependent, prandtl_ishlinskii, rate_dependent
from fmu_src.piezo.inverse_prandtl_ishlinskii import SMALLEST_SLOPE
from fmu_src.piezo.prandtl_ishlinskii import NOMINAL, PLAYS, Hysteresis
from fmu_src.piezo.rate_dependent import FASTEST, RateDependence

T = 1e-3
NANOMETRE = 1e-9
UNLIMITED = {"amplifier.lowest": -200.0, "amplifier.highest": 200.0}
LIMIT = 1e-3
"""Up to which slopes change, in the tests [m/s]."""


def parameters(seed, falling=False):
    """Random slopes at rest and at LIMIT; below SMALLEST_SLOPE there where some fall too far."""
    rng = np.random.default_rng(seed)
    resting, fast = rng.uniform(0.1, 2.0, (2, PLAYS))
    if falling:
        fast[rng.integers(PLAYS)] = -rng.uniform(0.1, 1.0)
    change = (fast - resting) / LIMIT
    reference = rng.uniform(0, LIMIT)
    return {
        "weights": np.diff(resting + change * reference, prepend=0.0),
        "rate_slopes": change,
        "rate_limits": LIMIT,
        "reference_rate": reference,
    }


def forward(volts, rate, values):
    inputs = {"volts": volts, "rate": rate}
    return Runner(rate_dependent.MODEL, values).run(len(volts), inputs)


def inverse(stroke, values, **inputs):
    nested = {f"hysteresis.{name}": value for name, value in values.items()}
    runner = Runner(inverse_rate_dependent.MODEL, {**nested, **UNLIMITED})
    return runner.run(len(stroke), {"stroke": stroke, **inputs})


def limits(values):
    runner = Runner(rate_dependent.MODEL, values)
    names = [scalar.name for scalar in rate_dependent.Limits.scalars()]
    return dict(zip(names, runner.d, strict=True))


def witness(volts, rates, values):
    """(7.17) to (7.19) in plain Python, below the singular rate."""
    r, d, s = (
        np.array(RateDependence.fields[name].start)
        for name in ("thresholds", "dead_zones", "saturation")
    )
    plays, strokes = np.zeros(PLAYS), []
    for v, rate in zip(volts, rates, strict=True):
        plays = np.clip(plays, v - r, v + r)
        moved = min(abs(rate), LIMIT) - values["reference_rate"]
        w = np.diff(np.cumsum(values["weights"]) + values["rate_slopes"] * moved, prepend=0.0)
        y = w @ plays
        strokes.append(s[0] * y + sum(s[j] * max(y - d[j], 0.0) for j in range(1, len(d))))
    return np.array(strokes)


_volts = arrays(float, 40, elements=st.floats(0, 100))
_strokes = arrays(float, 40, elements=st.floats(0, 14e-6))
_rates = arrays(float, 40, elements=st.floats(-2e-3, 2e-3))
_seeds = st.integers(0, 30)


@settings(max_examples=60)
@given(_volts, _rates, _seeds)
def test_stroke_is_that_of_the_equations(volts, rates, seed):
    values = parameters(seed)
    found = forward(volts, rates, values)
    np.testing.assert_allclose(found["stroke"], witness(volts, rates, values), atol=1e-17)
    assert not found["singular"].any()


def test_without_dependence_it_is_the_modified_operator():
    volts = np.random.default_rng(1).uniform(0, 100, 200)
    plain = Runner(prandtl_ishlinskii.MODEL).run(200, {"volts": volts})["stroke"]
    still = {
        name: np.array(Hysteresis.fields[name].start) for name in ("weights", "saturation")
    } | {"rate_slopes": 0.0}
    rates = np.linspace(-2e-3, 2e-3, 200)
    np.testing.assert_allclose(forward(volts, rates, still)["stroke"], plain, rtol=1e-12)


@settings(max_examples=60)
@given(_strokes, _rates, _seeds, st.booleans())
def test_forward_of_inverse_is_the_stroke_however_the_rate_changes(stroke, rates, seed, falling):
    """Above the singular rate too: both then have the last slopes with an inverse."""
    values = parameters(seed, falling)
    sent = inverse(stroke, values, rate=rates, rate_valid=1.0)
    reached = forward(sent["volts"], sent["rate_used"], values)
    kept = sent["limited"] == 0
    assert np.abs(reached["stroke"] - stroke)[kept].max(initial=0.0) < NANOMETRE
    np.testing.assert_array_equal(reached["singular"], sent["singular"])


@settings(max_examples=60)
@given(_volts, _rates, _seeds)
def test_inverse_of_forward_is_the_voltage(volts, rates, seed):
    values = parameters(seed)
    stroke = forward(volts, rates, values)["stroke"]
    sent = inverse(stroke, values, rate=rates, rate_valid=1.0)["volts"]
    np.testing.assert_allclose(sent, volts, atol=1e-6)


@settings(max_examples=40)
@given(_seeds)
def test_singular_rate_is_where_the_first_slope_gets_too_small(seed):
    """Against a search over rates, and FASTEST where there is none."""
    values = parameters(seed, falling=True)
    rates = np.linspace(0, LIMIT, 20_001)
    moved = rates[:, None] - values["reference_rate"]
    sums = np.cumsum(values["weights"]) + values["rate_slopes"] * moved
    first = rates[np.argmax(sums.min(axis=1) < SMALLEST_SLOPE)]
    assert limits(values)["singular_rate"] == pytest.approx(first, abs=rates[1])
    assert limits(values)["defined"] == 1
    assert limits(parameters(seed))["singular_rate"] == FASTEST


def test_above_the_singular_rate_there_is_a_warning_and_the_last_safe_slope():
    """A fast sine between slow ones: flagged while fast, finite, and exact again afterwards."""
    values = parameters(3, falling=True)
    singular = limits(values)["singular_rate"]
    t = T * np.arange(3000)
    frequency = np.where((t > 1) & (t < 2), 25.0, 0.5)
    stroke = 6e-6 - 5e-6 * np.cos(2 * np.pi * np.cumsum(frequency) * T)
    sent = inverse(stroke, values)
    assert np.all(np.isfinite(sent["volts"]))
    np.testing.assert_array_equal(sent["singular"], np.abs(sent["rate_used"]) > singular)
    assert sent["singular"].any()
    assert not sent["singular"][:900].any()
    assert not sent["singular"][2100:].any()
    # A voltage for the last safe slope is the same however much faster the demand is.
    for factor in (1.0, 5.0):
        rate = np.append(np.zeros(5), factor * 1.01 * singular)
        stroke = np.append(np.linspace(0, 5e-6, 5), 4e-6)
        last = inverse(stroke, values, rate=rate, rate_valid=1.0)
        assert last["singular"][-1] == 1
        assert last["volts"][-1] == pytest.approx(
            inverse(stroke, values, rate=np.append(rate[:-1], singular), rate_valid=1.0)["volts"][
                -1
            ]
        )


def test_the_rate_is_that_of_the_demand():
    """From the last three samples; a parabola's is exact, and a horizon looks ahead of it."""
    t = T * np.arange(60)
    stroke = 3e-6 + 50e-6 * t + 400e-6 * t**2
    plain = inverse(stroke, {})["rate_used"]
    np.testing.assert_allclose(plain[3:], 50e-6 + 800e-6 * t[3:], rtol=1e-6, atol=1e-12)
    runner = Runner(inverse_rate_dependent.MODEL, {"horizon": 2 * T})
    early = runner.run(60, {"stroke": stroke})["rate_used"]
    np.testing.assert_allclose(early[3:], 50e-6 + 800e-6 * (t[3:] + 2 * T), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    "spoiled",
    [
        {"weights[1]": -0.9},
        {"saturation[2]": -2e-7},
        {"thresholds[4]": 8.0},
        {"dead_zones[2]": 80.0},
        {"rate_slopes[3]": 1e5, "reference_rate": 5e-4},
    ],
)
def test_weights_without_an_inverse_are_flagged_and_stay_finite(spoiled):
    assert limits(spoiled)["defined"] == 0
    sent = inverse(np.array([1e-6, 14e-6, 3e-6]), spoiled)
    assert np.isfinite(sent["volts"]).all()


def test_shipped_slopes_have_an_inverse_at_the_rates_of_tremor():
    """12.5 um p-p at 19 Hz is 746 um/s (A04 7.3.2)."""
    assert limits({})["defined"] == 1
    assert limits({})["singular_rate"] > 746e-6
    assert np.abs(RateDependence.fields["rate_slopes"].start).max() > 0
    assert RateDependence.fields["saturation"].start[0] == NOMINAL
