"""Operator and inverse: each other's mirror, and what both do at the edges."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fmu_src.kit.runner import Runner
from fmu_src.piezo import inverse_prandtl_ishlinskii, prandtl_ishlinskii
from fmu_src.piezo.inverse_prandtl_ishlinskii import SMALLEST_SLOPE
from fmu_src.piezo.prandtl_ishlinskii import DEAD_ZONES, NOMINAL, PLAYS, Hysteresis

NANOMETRE = 1e-9
UNLIMITED = {"amplifier.lowest": -200.0, "amplifier.highest": 200.0}

voltages = st.lists(st.floats(0.0, 100.0), min_size=2, max_size=40).map(np.array)
strokes = st.lists(st.floats(0.0, 14e-6), min_size=2, max_size=40).map(np.array)
rising_curves = st.tuples(
    st.lists(st.floats(0.05, 2.0), min_size=PLAYS, max_size=PLAYS),
    st.lists(st.floats(0.2, 2.0), min_size=DEAD_ZONES, max_size=DEAD_ZONES),
)


def _parameters(curves) -> dict:
    """Weights whose running sums are the given slopes."""
    plays, zones = curves
    return {
        "weights": np.diff(plays, prepend=0.0),
        "saturation": NOMINAL * np.diff(zones, prepend=0.0),
    }


def _forward(volts: np.ndarray, parameters: dict) -> np.ndarray:
    return Runner(prandtl_ishlinskii.MODEL, parameters).run(len(volts), {"volts": volts})["stroke"]


def _inverse(stroke: np.ndarray, parameters: dict, amplifier: dict = UNLIMITED) -> dict:
    nested = {f"hysteresis.{name}": value for name, value in parameters.items()}
    runner = Runner(inverse_prandtl_ishlinskii.MODEL, {**nested, **amplifier})
    return runner.run(len(stroke), {"stroke": stroke})


def _witness(volts: np.ndarray) -> np.ndarray:
    """Eq. 7.1 to 7.9 in plain Python, with the shipped parameters."""
    r, w, d, s = (
        np.array(Hysteresis.fields[name].start)
        for name in ("thresholds", "weights", "dead_zones", "saturation")
    )
    plays, strokes = np.zeros(PLAYS), []
    for v in volts:
        plays = np.array(
            [max(v - half, min(v + half, h)) for half, h in zip(r, plays, strict=True)]
        )
        y = float(w @ plays)
        strokes.append(s[0] * y + sum(s[j] * max(y - d[j], 0.0) for j in range(1, DEAD_ZONES)))
    return np.array(strokes)


@settings(max_examples=100)
@given(voltages)
def test_operator_is_the_equations(volts):
    np.testing.assert_allclose(_forward(volts, {}), _witness(volts), atol=1e-18)


@settings(max_examples=200)
@given(strokes, rising_curves)
def test_forward_of_inverse_is_what_was_wanted(stroke, curves):
    parameters = _parameters(curves)
    wanted = _inverse(stroke, parameters)
    assume(not wanted["limited"].any())
    assert np.abs(_forward(wanted["volts"], parameters) - stroke).max() < NANOMETRE


@settings(max_examples=200)
@given(voltages, rising_curves)
def test_inverse_of_forward_is_what_was_sent(volts, curves):
    parameters = _parameters(curves)
    sent = _inverse(_forward(volts, parameters), parameters)["volts"]
    assert np.abs(_forward(sent, parameters) - _forward(volts, parameters)).max() < NANOMETRE
    np.testing.assert_allclose(sent, volts, atol=1e-6)


@settings(max_examples=50)
@given(voltages)
def test_loops_close_whatever_came_between(volts):
    """A minor loop leaves nothing behind (A04 7.2.1): the stroke returns with the voltage."""
    path = np.concatenate(([volts.max(), volts.min()], volts, [volts.max(), volts.min()]))
    stroke = _forward(path, {})
    np.testing.assert_allclose(stroke[-2:], stroke[:2], atol=1e-18)


def test_memory_follows_the_voltage_really_sent():
    """What the amplifier cannot send does not count: afterwards the stroke is exact again."""
    stroke = np.concatenate(([20e-6], np.linspace(8e-6, 3e-6, 50), np.linspace(3e-6, 9e-6, 50)))
    run = _inverse(stroke, {}, {})
    assert run["volts"][0] == 100.0
    assert run["limited"][0] == 1
    assert not run["limited"][1:].any()
    assert np.abs(_forward(run["volts"], {}) - stroke)[1:].max() < NANOMETRE


@pytest.mark.parametrize(
    "spoiled",
    [
        {"weights[1]": -0.45},
        {"saturation[2]": -2e-7},
        {"thresholds[4]": 8.0},
        {"dead_zones[2]": 80.0},
        {"thresholds[1]": 1.0},
    ],
)
def test_weights_without_an_inverse_are_flagged_and_stay_finite(spoiled):
    nested = {f"hysteresis.{name}": value for name, value in spoiled.items()}
    runner = Runner(inverse_prandtl_ishlinskii.MODEL, nested)
    names = [scalar.name for scalar in runner.model.derived.scalars()]
    assert runner.d[names.index("inverse.defined")] == 0
    run = runner.run(3, {"stroke": np.array([1e-6, 14e-6, 3e-6])})
    assert np.isfinite(run["volts"]).all()


def test_shipped_weights_have_an_inverse_of_moderate_gain():
    runner = Runner(inverse_prandtl_ishlinskii.MODEL)
    names = [scalar.name for scalar in runner.model.derived.scalars()]
    assert runner.d[names.index("inverse.defined")] == 1
    assert Hysteresis.fields["weights"].start[0] > 10 * SMALLEST_SLOPE
