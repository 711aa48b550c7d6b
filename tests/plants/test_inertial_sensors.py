"""Static response, lag, noise and limits of the sensors against their data sheets."""

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

from fmu_src.kit import design
from fmu_src.pack.compiled import CompiledRunner
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


@settings(deadline=None, max_examples=40)
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
    text = files("harness").joinpath("scenarios/closed_loop_a04_noise.toml").read_text("utf-8")
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
