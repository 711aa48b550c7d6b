"""The assembly: does it cancel, start and stop smoothly, and keep its limits."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation

from fmu_src.controller import correction, tremor_canceller
from fmu_src.device import design
from fmu_src.kit.runner import Runner
from fmu_src.manipulator import parallel_3dof
from fmu_src.piezo import modulated_stops, rate_dependent
from fmu_src.tremor import inertial_forecaster, var_forecaster
from plants import hand, instrument, piezo_stack

T = 1e-3
TRUE_POSITION = {"filter.wash_out": 0.0, "tremor_filter": 1}
"""And the filter that finds a tone at once."""
FILTERS = (1, 2)
OPERATORS = (1, 2, 3)
READY = round(1.0 / T)
"""Samples until the stacks have risen and the correction has been faded in."""


def _runner(parameters: dict | None = None) -> Runner:
    return Runner(tremor_canceller.MODEL, {**TRUE_POSITION, **(parameters or {})})


def _tone(seconds: float, amplitude: float, frequency: float = 10.0) -> np.ndarray:
    time = np.arange(round(seconds / T)) * T
    return amplitude * np.sin(2 * np.pi * frequency * time[:, None] + np.array([0.0, 1.0, 2.0]))


def _strokes(
    volts: np.ndarray, operator: int = 3, initial: float = 0.0, rate: np.ndarray | None = None
) -> np.ndarray:
    """By the controller's own operator, at `initial` volts for long before, (samples, 3) [m].

    A rate-dependent operator takes the rate of the strokes, (samples, 3) [m/s].
    """
    columns = []
    for stack, column in enumerate(volts.T):
        inputs = {"volts": column}
        if operator == 3:
            runner = Runner(modulated_stops.MODEL)
            thresholds = np.array(modulated_stops.THRESHOLDS)
            crept = np.full(modulated_stops.LAGS, initial / design.STACK_VOLTS)
            runner.x[:] = [*np.maximum(initial - thresholds, 0), *crept, initial]
        else:
            runner = Runner(rate_dependent.MODEL, {} if operator == 2 else {"rate_slopes": 0.0})
            runner.run(1, {"volts": initial})
            inputs["rate"] = 0.0 if rate is None else rate[:, stack]
        columns.append(runner.run(len(column), inputs)["stroke"])
    return np.column_stack(columns)


def _deflection(volts: np.ndarray, operator: int = 3) -> np.ndarray:
    """Tip in frame 0 by the controller's own operator and kinematics, (samples, 3) [m]."""
    argument = ca.SX.sym("strokes", 3)
    geometry = parallel_3dof.Geometry.unpack(ca.SX(parallel_3dof.Geometry.starts()))
    forward = ca.Function("forward", [argument], [parallel_3dof.forward(geometry, argument)])
    return np.array(forward(_strokes(volts, operator).T)).T


REST = np.array([0.0, 0.0, design.LEVER_GAIN * design.STACK_STROKE / 2])


@pytest.mark.parametrize("operator", [1, 3])
@pytest.mark.parametrize("angles", [(0, 0, 0), (40, -20, 70)])
def test_deflection_is_the_negated_tremor_seen_from_the_handle(angles, operator):
    """With its own models in place of the plant, nothing is lost on the way to the tip."""
    body = Rotation.from_euler("xyz", angles, degrees=True)
    attitude = body.as_quat(scalar_first=True)
    inputs = {"tip_displacement": _tone(4.0, 20e-6), "attitude": attitude}
    run = _runner({"operator": operator}).run(4000, inputs)
    deflection = _deflection(run["volts"], operator)[READY:]
    wanted = REST - body.inv().apply(run["tremor"][READY:])
    np.testing.assert_allclose(deflection, wanted, atol=1e-9)
    assert not run["saturated"].any()


def test_the_rate_dependent_inverse_is_that_of_its_operator():
    """Each stroke, at the rate of its last two samples, comes out of the forward operator."""
    run = _runner({"operator": 2}).run(3000, {"tip_displacement": _tone(3.0, 20e-6)})
    geometry = parallel_3dof.Geometry.unpack(ca.SX(parallel_3dof.Geometry.starts()))
    argument = ca.SX.sym("tip", 3)
    inverse = ca.Function("inverse", [argument], [parallel_3dof.inverse(geometry, argument)])
    wanted = np.array(inverse((REST - run["tremor"]).T)).T
    rate = np.diff(wanted, axis=0, prepend=wanted[:1]) / T
    strokes = _strokes(run["volts"], 2, rate=rate)
    np.testing.assert_allclose(strokes[READY + 1 :], wanted[READY + 1 :], atol=1e-9)
    assert not run["singular"].any()


def test_too_fast_a_tremor_for_a_rate_dependent_operator_is_told():
    """Slopes that reach zero at 2 um/s: 20 um of tremor at 10 Hz moves the stacks faster."""
    falling = {f"stack_{k}.rate_slopes[5]": -1e6 for k in (1, 2, 3)}
    falling |= {f"stack_{k}.reference_rate": 0.0 for k in (1, 2, 3)}
    inputs = {"tip_displacement": _tone(3.0, 20e-6)}
    run = _runner({"operator": 2, **falling}).run(3000, inputs)
    assert run["singular"][2000:].mean() > 0.5
    assert np.all(np.isfinite(run["volts"]))
    plain = _runner({"operator": 1, **falling}).run(3000, inputs)
    assert not plain["singular"].any()


@pytest.mark.parametrize("tremor_filter", FILTERS)
@pytest.mark.parametrize("operator", OPERATORS)
def test_generated_tremor_is_cancelled_on_plants_that_share_no_code(operator, tremor_filter):
    """Hand, stacks and instrument of `plants`; position known, the command acts a sample later."""
    samples = 12000
    moved = Runner(hand.MODEL, {"seed": 20}).run(samples)
    inputs = {"tip_displacement": moved["tip"], "attitude": moved["attitude"]}
    chosen = {"operator": operator, "tremor_filter": tremor_filter}
    run = _runner(chosen).run(samples, inputs)
    volts = np.vstack([np.zeros(3), run["volts"][:-1]])
    substeps = round(T / piezo_stack.MODEL.sample_period)
    strokes = np.column_stack(
        [
            Runner(piezo_stack.MODEL).run(
                substeps * samples, {"volts": np.repeat(column, substeps)}
            )["stroke"][substeps - 1 :: substeps]
            for column in volts.T
        ]
    )
    pose = {name: moved[name] for name in ("body", "attitude")}
    tips = Runner(instrument.MODEL).run(samples, {**pose, "stroke": strokes})
    sections = signal.butter(4, (6, 16), "bandpass", fs=1 / T, output="sos")
    before, after = (
        signal.sosfiltfilt(sections, tips[name], axis=0)[3000:] for name in ("free_tip", "tip")
    )
    assert np.std(after) < (0.35 if tremor_filter == 1 else 0.25) * np.std(before)


def test_the_forecaster_inside_is_the_one_outside():
    """Same horizon, same wash-out, same motion: same tremor; the other filter learns nothing."""
    motion = np.cumsum(np.random.default_rng(4).standard_normal((3000, 3)), axis=0) * 1e-6
    given = {"filter.horizon": 2e-3, "filter.wash_out": 0.3, "tremor_filter": 2}
    inside = _runner(given).run(3000, {"tip_displacement": motion})["tremor"]
    alone = Runner(var_forecaster.MODEL, {"horizon": 2e-3, "wash_out": 0.3})
    np.testing.assert_allclose(inside, alone.run(3000, {"position": motion})["tremor"], atol=1e-12)


def test_the_forecaster_on_forces_inside_is_the_one_outside():
    """Same horizon, same noise, same forces: same tremor."""
    force = np.cumsum(np.random.default_rng(4).standard_normal((3000, 6)), axis=0) * 1e-3
    attitude = Rotation.from_euler("xyz", (40, -20, 70), degrees=True).as_quat(scalar_first=True)
    inputs = {"force": force, "attitude": attitude}
    given = {"filter.horizon": 2e-3, "tremor_filter": 3, "sensing.density": 2e-3}
    inside = _runner(given).run(3000, inputs)["tremor"]
    alone = Runner(inertial_forecaster.MODEL, {"horizon": 2e-3, "sensing.density": 2e-3})
    np.testing.assert_allclose(inside, alone.run(3000, inputs)["tremor"], atol=1e-12)


def test_a_filter_outside_is_followed():
    """Its tremor comes out as it came in, and is what the voltages cancel."""
    tremor = _tone(1.5, 20e-6)
    run = _runner({"tremor_filter": 4, "rise_time": 0.2, "fade_time": 0.2}).run(
        len(tremor), {"external_tremor": tremor}
    )
    np.testing.assert_array_equal(run["tremor"], tremor)
    moved = _deflection(run["volts"])[READY:] - REST
    np.testing.assert_allclose(moved, -tremor[READY:], atol=0.05e-6)


@pytest.mark.parametrize("operator", [1, 3])
def test_start_is_smooth_and_ends_at_half_stroke(operator):
    """No tremor: from no voltage to rest, never faster than the ramp asks for."""
    rise_time = 0.5
    run = _runner({"rise_time": rise_time, "operator": operator}).run(READY)
    deflection = _deflection(run["volts"], operator)
    assert np.all(run["volts"][0] < 0.1)
    np.testing.assert_allclose(deflection[-1], REST, atol=1e-9)
    steps = np.diff(deflection[:, 2])
    assert steps.min() > -1e-12
    assert steps.max() < 1.01 * 1.5 * REST[2] * T / rise_time
    assert not run["saturated"].any()


@pytest.mark.parametrize("initial", [20.0, 90.0])
@pytest.mark.parametrize("operator", [1, 3])
def test_start_is_smooth_from_any_voltage(operator, initial):
    """From where the stacks are, up or down, to rest, and no faster than the ramp asks for."""
    rise_time = 0.5
    given = {"rise_time": rise_time, "operator": operator, "initial_volts": initial}
    run = _runner(given).run(READY)
    np.testing.assert_allclose(run["volts"][0], initial, atol=0.1)
    strokes = _strokes(run["volts"], operator, initial)
    rest = design.STACK_STROKE / 2
    np.testing.assert_allclose(strokes[-1], rest, atol=1e-9)
    way = rest - strokes[0]
    steps = np.diff(strokes, axis=0) * np.sign(way)
    assert steps.min() > -1e-12
    assert steps.max() < 1.02 * 1.5 * np.abs(way).max() * T / rise_time


def test_hold_brings_the_tip_to_rest_smoothly_and_lets_it_go_again():
    samples, begun, ended = 6000, 2000, 4000
    hold = np.zeros(samples)
    hold[begun:ended] = 1
    tone = _tone(6.0, 20e-6)
    run = _runner({"fade_time": 0.5}).run(samples, {"tip_displacement": tone, "hold": hold})
    correction = _deflection(run["volts"]) - REST
    np.testing.assert_allclose(correction[begun + 501 : ended], 0.0, atol=1e-9)
    assert not run["engagement"][begun + 501 : ended].any()
    steps = np.abs(np.diff(correction[READY:], axis=0))
    assert steps.max() < 1.3 * 20e-6 * 2 * np.pi * 10.0 * T
    # The tremor was followed all the while, so that the correction is right when it is back.
    np.testing.assert_allclose(correction[-1000:], -run["tremor"][-1000:], atol=1e-9)


def test_hold_from_the_first_sample_on_rises_to_rest_and_stays():
    run = _runner().run(2000, {"tip_displacement": _tone(2.0, 20e-6), "hold": 1.0})
    np.testing.assert_allclose(_deflection(run["volts"])[-500:], [REST] * 500, atol=1e-9)


def test_correction_fades_out_while_the_motion_is_not_valid_and_in_again():
    samples, lost, found = 5000, 2000, 3500
    valid = np.ones(samples)
    valid[lost:found] = 0
    tone = _tone(5.0, 20e-6)
    tone[lost:found] = 0.4  # what comes meanwhile is not looked at
    run = _runner({"fade_time": 0.5}).run(samples, {"tip_displacement": tone, "valid": valid})
    correction = _deflection(run["volts"]) - REST
    resting = correction[lost + 501 : found]
    np.testing.assert_allclose(resting, 0.0, atol=1e-9)
    steps = np.abs(np.diff(correction[READY:], axis=0))
    assert steps.max() < 1.3 * 20e-6 * 2 * np.pi * 10.0 * T
    again = correction[-500:] + run["tremor"][-500:]
    np.testing.assert_allclose(again, 0.0, atol=1e-9)


def test_a_demand_beyond_the_stroke_is_limited_and_told_and_leaves_no_trace():
    large, small = _tone(3.0, 150e-6), _tone(3.0, 10e-6)
    run = _runner().run(6000, {"tip_displacement": np.vstack([large, small])})
    assert run["saturated"][2000:3000].any()
    assert not run["saturated"][4500:].any()
    correction = _deflection(run["volts"])[4500:] - REST
    np.testing.assert_allclose(correction, -run["tremor"][4500:], atol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1.0))
def test_voltages_stay_within_the_amplifier(seed, scale):
    generator = np.random.default_rng(seed)
    inputs = {
        "tip_displacement": scale * generator.uniform(-1, 1, (1500, 3)),
        "attitude": generator.uniform(-1, 1, (1500, 4)),
        "valid": generator.integers(0, 2, 1500),
    }
    volts = _runner({"rise_time": 0.1, "fade_time": 0.1}).run(1500, inputs)["volts"]
    assert np.all((volts >= 0) & (volts <= design.STACK_VOLTS))


def test_cost_leaves_room_for_a_microcontroller():
    """5 us a sample on a desktop machine, at some 0.4 ns an instruction (`make bench`)."""
    assert correction.acting(T).n_instructions() < 10_000
