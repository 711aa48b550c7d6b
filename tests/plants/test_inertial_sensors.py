"""Static response, lag, noise and limits of the sensors against their data sheets."""

import dataclasses
import itertools
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.pack.compiled_runner import CompiledRunner
from plants.inertial_sensors import CHANNELS, MODEL, Params

T = 1e-3
QUIET = {
    f"{sensor}_{kind}": 0.0
    for sensor in ("accelerometer", "magnetometer")
    for kind in ("noise", "walk")
}
IDEAL = QUIET | {
    f"{sensor}_{kind}": 0.0
    for sensor in ("accelerometer", "magnetometer")
    for kind in ("bias", "scale_error", "misalignment", "cross_axis")
}
FINE = {"adc_bits": 24}
STEP = design.ADC_SPAN / 2**16
"""Step of the 16-bit converter [V]."""
MG = 1e-3 * design.STANDARD_GRAVITY


def run(samples, parameters, **inputs):
    return CompiledRunner(MODEL, parameters).run(samples, inputs)


def at_rest(samples, parameters):
    """Accelerometer channels [m/s2] and magnetometer channels [T] of a motionless instrument."""
    up = [0.0, 0.0, design.SITE_GRAVITY]
    out = run(samples, parameters, force1=up, force2=up, force3=up, field=[2e-5, 0, -4e-5])
    volts = out["volts"] - design.ZERO_VOLTS
    return volts[:, :6] / design.ACCELEROMETER_SCALE, volts[:, 6:] / design.MAGNETOMETER_SCALE


@settings(max_examples=40)
@given(
    arrays(float, (3, 3), elements=st.floats(-15, 15)),
    arrays(float, 3, elements=st.floats(-1e-4, 1e-4)),
)
def test_ideal_sensors_convert_each_sites_axes_to_the_nearest_code(forces, field):
    named = dict(zip(("force1", "force2", "force3"), forces, strict=True))
    volts = run(1, IDEAL, field=field, **named)["volts"][0]
    axis = {"x": 0, "y": 1, "z": 2}
    quantity = [
        design.ACCELEROMETER_SCALE * forces[int(name[1]) - 1, axis[name[2]]]
        if name[0] == "a"
        else design.MAGNETOMETER_SCALE * field[axis[name[1]]]
        for name in CHANNELS
    ]
    np.testing.assert_allclose(volts, design.ZERO_VOLTS + np.array(quantity), atol=STEP / 2 + 1e-12)
    np.testing.assert_allclose(volts / STEP, np.round(volts / STEP), atol=1e-9)


def test_misaligned_crossed_scaled_and_biased_channel():
    """Channel a2z: the sensor's own axes by SciPy, then scale, cross axis and bias."""
    turn = np.array([[0, 0, 0], [0.02, -0.05, 0.1], [0, 0, 0]])
    scale, cross, bias = np.zeros(6), np.zeros((6, 2)), np.zeros(6)
    scale[3], cross[3], bias[3] = 0.03, (0.01, -0.02), 0.4
    parameters = IDEAL | FINE
    parameters |= {
        "accelerometer_misalignment": turn,
        "accelerometer_scale_error": scale,
        "accelerometer_cross_axis": cross,
        "accelerometer_bias": bias,
    }
    force = np.array([3.0, -2.0, 8.0])
    volts = run(1, parameters, force2=force)["volts"][0, CHANNELS.index("a2z")]
    own = Rotation.from_rotvec(turn[1]).inv().apply(force)
    felt = 1.03 * own[2] + 0.01 * own[0] - 0.02 * own[1] + 0.4
    expected = design.ZERO_VOLTS + design.ACCELEROMETER_SCALE * felt
    assert volts == pytest.approx(expected, abs=1e-6)


def test_step_response_has_the_time_constant_of_the_output_filter():
    samples, after = 200, 5
    force = np.zeros((samples, 3))
    force[after:, 0] = 5.0
    volts = run(samples, IDEAL | FINE, force1=force)["volts"][:, 0]
    level = (volts - design.ZERO_VOLTS) / (5.0 * design.ACCELEROMETER_SCALE)
    t = T * np.arange(samples)
    # Between samples the input is a straight line, so its step is half a sample earlier.
    reached = np.interp(1 - np.exp(-1), level, t) - T * (after - 0.5)
    assert reached == pytest.approx(32e3 * 0.33e-6, rel=2e-3)


def test_filter_is_exact_for_an_input_of_straight_lines():
    """SciPy integrates the RC circuit."""
    rng = np.random.default_rng(2)
    force = np.zeros((60, 3))
    force[:, 0] = rng.uniform(-10, 10, 60)
    volts = run(60, IDEAL | FINE, force1=force)["volts"][:, 0] - design.ZERO_VOLTS
    source = force[:, 0] * design.ACCELEROMETER_SCALE
    wanted = [source[0]]
    for before, after in itertools.pairwise(source):
        circuit = solve_ivp(
            lambda t, y, a=before, b=after: (a + (b - a) * t / T - y) / design.SENSOR_LAG,
            (0, T),
            wanted[-1:],
            rtol=1e-9,
            atol=1e-12,
        )
        wanted.append(circuit.y[0, -1])
    np.testing.assert_allclose(volts, wanted, atol=1e-6)


def test_noise_at_rest_is_that_of_the_data_sheets():
    """ADXL203: 110 ug/sqrt(Hz) in the noise bandwidth pi/2 x 15.1 Hz of the filter, 0.54 mg rms."""
    force, field = at_rest(100_000, {"seed": 7} | FINE)
    corner = 1 / (2 * np.pi * 32e3 * 0.33e-6)
    expected = 0.110 * MG * np.sqrt(np.pi / 2 * corner)
    assert expected == pytest.approx(0.54 * MG, rel=0.01)
    np.testing.assert_allclose(force.std(axis=0), expected, rtol=0.05)
    # HMC2003: 40 ugauss in 10 Hz, all of its noise up to 1 kHz folded into 500 Hz.
    np.testing.assert_allclose(field.std(axis=0), 40e-10 * np.sqrt(np.pi / 2 * 1e3 / 10), rtol=0.03)


def test_spectrum_of_the_noise_is_flat_and_then_falls_with_the_filter():
    force, _ = at_rest(200_000, {"seed": 8} | FINE)
    f, power = signal.welch(force, 1 / T, nperseg=2000, axis=0)
    density = np.sqrt(power.mean(axis=1))
    corner = 1 / (2 * np.pi * design.SENSOR_LAG)
    below = (f > 1) & (f < 4)
    assert density[below].mean() == pytest.approx(0.110 * MG, rel=0.05)
    at_corner = (f > corner - 2) & (f < corner + 2)
    assert density[at_corner].mean() == pytest.approx(0.110 * MG / np.sqrt(2), rel=0.05)


def test_scenario_with_the_noise_of_the_thesis_has_its_figure():
    """A04 Table 2.3: 2.25 mg rms behind the 15 Hz filter; and the estimator is told of it."""
    text = (
        files("harness.scenario").joinpath("library/closed_loop_a04_noise.toml").read_text("utf-8")
    )
    parts = tomllib.loads(text)["part"]
    force, _ = at_rest(100_000, {**parts["sensors"], "seed": 9})
    assert set(parts["estimator"]["accelerometer"]["density"]) == set(parts["sensors"].values())
    np.testing.assert_allclose(force.std(axis=0), 2.25 * MG, rtol=0.05)


def test_noise_is_stationary_from_the_first_sample():
    """Spread over many instances at sample 0 and at sample 50."""
    parameters = (
        IDEAL | FINE | {"accelerometer_noise": Params.fields["accelerometer_noise"].start[0]}
    )
    early = np.array([run(51, parameters | {"seed": s})["volts"][[0, 50], :6] for s in range(200)])
    spread = early.std(axis=(0, 2))
    assert spread[0] == pytest.approx(spread[1], rel=0.1)


@pytest.mark.slow
def test_allan_deviation_falls_with_white_noise_and_rises_with_the_random_walk():
    """With the walk made 300 times faster its turn comes 300 times earlier, at 12 s."""
    walk = 300 * Params.fields["accelerometer_walk"].start[0]
    noise = Params.fields["accelerometer_noise"].start[0]
    force, _ = at_rest(2_000_000, {"seed": 10, "accelerometer_walk": walk} | FINE)

    def allan(seconds):
        count = round(seconds / T)
        means = force[: len(force) // count * count].reshape(-1, count, 6).mean(axis=1)
        return np.sqrt((np.diff(means, axis=0) ** 2).mean() / 2)

    for seconds in (1.0, 4.0, 12.0, 40.0, 120.0):
        expected = np.sqrt(noise**2 / (2 * seconds) + walk**2 * seconds / 3)
        assert allan(seconds) == pytest.approx(expected, rel=0.15), seconds


def test_range_of_sensor_and_converter():
    over = {"force1": [100.0, 0.0, 0.0]}
    out = run(1, IDEAL, **over)
    assert out["clipped"][0] == 1
    assert out["volts"][0, 0] == pytest.approx(design.ZERO_VOLTS + 1.7, abs=STEP)

    out = run(1, IDEAL | {"accelerometer_range": 1e3}, **over)
    assert out["clipped"][0] == 1
    assert out["volts"][0, 0] == design.ADC_SPAN - STEP

    out = run(1, IDEAL, field=[-3e-4, 0.0, 0.0])
    assert out["clipped"][0] == 1
    assert out["volts"][0, 6] == pytest.approx(design.ZERO_VOLTS - 2.0, abs=STEP)

    assert run(1, IDEAL, force1=[9.0, 0.0, 0.0])["clipped"][0] == 0


def test_errors_by_default_are_those_of_a_calibrated_instrument():
    force, field = at_rest(20_000, {})
    up = np.array([design.SITE_GRAVITY if name[2] == "z" else 0 for name in CHANNELS[:6]])
    error = np.abs(force.mean(axis=0) - up)
    assert np.all((error > 0.1 * MG) & (error < 6 * MG))
    assert np.all(np.abs(field.mean(axis=0) - [2e-5, 0, -4e-5]) < 0.005 * 5e-5)


# Raw units ---------------------------------------------------------------------------------------

UNIT = design.STANDARD_GRAVITY


def volts_at(parameters, force, **more):
    """Channels of one sample, above zero, in m/s2 and T; the same force at every site."""
    out = run(1, IDEAL | FINE | parameters, force1=force, force2=force, force3=force, **more)
    volts = out["volts"][0] - design.ZERO_VOLTS
    return np.append(volts[:6] / design.ACCELEROMETER_SCALE, volts[6:] / design.MAGNETOMETER_SCALE)


@settings(max_examples=40)
@given(
    arrays(float, 3, elements=st.floats(-15, 15)),
    arrays(float, (6, 2), elements=st.floats(-0.4, 0.4)),
    arrays(float, 6, elements=st.floats(0, 0.1)),
    arrays(float, 6, elements=st.floats(-0.02, 0.02)),
)
def test_bow_droop_and_hardening(force, bow, droop, hardening):
    """The forms written out once more; channel a1x feels z in its plane and y out of it."""
    found = volts_at(
        {
            "accelerometer_bow": bow,
            "accelerometer_droop": droop,
            "accelerometer_hardening": hardening,
            "accelerometer_range": 1e3,
        },
        force,
    )
    planes = {"1": "xz", "2": "yz", "3": "xy"}
    for i, name in enumerate(CHANNELS[:6]):
        (other,) = set(planes[name[1]]) - {name[2]}
        (out,) = set("xyz") - set(planes[name[1]])
        x, y, z = (force["xyz".index(axis)] / UNIT for axis in (name[2], other, out))
        expected = x * UNIT * (1 + hardening[i] * x**2) / (1 + droop[i] * (z**2 + z / 2))
        for share, away in zip(bow[i], (y, z), strict=True):
            expected += share * (np.hypot(1, away / 0.6) - 1) / (np.hypot(1, 1 / 0.6) - 1)
        # The converter's span ends at 2.5 V about zero.
        if abs(expected) < 24:
            assert found[i] == pytest.approx(expected, abs=2e-5)


def test_what_friction_holds_back_makes_a_loop():
    """Up and down through +-1 g: the loop is 2 h high, and closed; a tremor hardly opens it."""
    turn = np.sin(np.linspace(0, 6 * np.pi, 3001))
    force = np.zeros((3001, 3))
    force[:, 0] = UNIT * turn
    h = 0.02
    parameters = IDEAL | FINE | {"accelerometer_hysteresis": h, "accelerometer_lag": 1e-5}
    given = run(3001, parameters, force1=force)["volts"][:, 0] - design.ZERO_VOLTS
    off = given / design.ACCELEROMETER_SCALE - force[:, 0]
    # Through zero upwards, downwards and upwards again.
    up, down, again = off[1000], off[1500], off[2000]
    # The shortest lag of the filter adds 0.6 mm/s2.
    assert up == pytest.approx(-h, abs=1e-3)
    assert down == pytest.approx(h, abs=1e-3)
    assert again == pytest.approx(up, abs=1e-5)
    small = np.zeros((3001, 3))
    small[:, 0] = 0.1 * turn
    given = run(3001, parameters, force1=small)["volts"][:, 0] - design.ZERO_VOLTS
    off = given / design.ACCELEROMETER_SCALE - small[:, 0]
    assert np.ptp(off) < 0.1 * h


@settings(max_examples=30)
@given(
    arrays(float, 3, elements=st.floats(-6e-5, 6e-5)),
    arrays(float, (3, 3), elements=st.floats(-0.1, 0.1)),
    arrays(float, 3, elements=st.floats(-200, 200)),
)
def test_iron_and_the_field_across(field, iron, cross):
    parameters = {"soft_iron": iron, "cross_field": cross}
    found = volts_at(parameters, np.zeros(3), field=field)[6:]
    felt = field + iron @ field
    np.testing.assert_allclose(found, felt / (1 + cross * np.roll(felt, -1)), atol=2e-11)


SLOW = dataclasses.replace(MODEL, sample_period=10.0)
"""Solved exactly between samples, too."""
THERMAL = {"accelerometer_bias_drift": 0.01, "magnetometer_bias_drift": 1e-8}
STILL = {"force1": [0, 0, 0], "field": [0, 0, 0]}


def slowly(samples, parameters, **inputs):
    out = CompiledRunner(SLOW, IDEAL | FINE | parameters).run(samples, inputs)
    return (out["volts"][:, :6] - design.ZERO_VOLTS) / design.ACCELEROMETER_SCALE, out


def test_a_warm_unit_in_the_room_of_the_thesis_does_not_drift_at_all():
    force, out = slowly(50, {})
    np.testing.assert_array_equal(force, np.broadcast_to(force[0], force.shape))
    np.testing.assert_array_equal(force[0], 0.0)
    assert out["temperature"].min() == out["temperature"].max()


def test_warming_up_takes_2_to_12_hours():
    """Each accelerometer in its own time; stress follows by its width."""
    hours = 14
    parameters = THERMAL | {"powered": 0.0, "heating": 8.0, "stress_width": 0.0}
    force, out = slowly(round(hours * 360), parameters)
    t = np.arange(len(force)) * 10.0
    for channel, constant in zip((0, 2, 4), (1800, 6300, 10800), strict=True):
        expected = -0.01 * 8 * np.exp(-t / constant)
        np.testing.assert_allclose(force[:, channel], expected, atol=1e-5)
        away = t[np.abs(force[:, channel]) > 0.02 * 0.08]
        assert 1.9 * 3600 < away[-1] < 12 * 3600
    assert out["temperature"][0] == pytest.approx(22.3, abs=1 / 16)
    assert out["temperature"][-1] == pytest.approx(30.3, abs=1 / 16)


def test_warming_and_cooling_differ_by_the_width_of_the_stress():
    """The room goes up and down by 10 K, slowly, around a warm unit."""
    day = np.concatenate((np.linspace(22, 32, 4000), np.linspace(32, 22, 4000)))
    parameters = THERMAL | {"stress_width": 1.5, "warming": 10.0}
    force, _ = slowly(8000, parameters, ambient=day)
    middle = 27.0
    up, down = force[2000, 0], force[6000, 0]
    assert day[2000] == pytest.approx(middle, abs=0.01)
    assert down - up == pytest.approx(2 * 1.5 * 0.01, rel=0.01)
    # On the way up it is the warm unit's own path, which is what its bias is of.
    assert up == pytest.approx(0.01 * (middle - 22), rel=0.02)


def test_the_scale_follows_the_temperature_and_not_the_stress():
    parameters = {"accelerometer_scale_drift": 1e-3, "accelerometer_bias_drift": 0.0}
    out = run(1, IDEAL | FINE | parameters, force1=[5.0, 0, 0], ambient=32.0)
    felt = (out["volts"][0, 0] - design.ZERO_VOLTS) / design.ACCELEROMETER_SCALE
    assert felt == pytest.approx(5.0 * 1.01, rel=1e-5)
