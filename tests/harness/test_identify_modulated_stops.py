"""Modulated stops identified from recorded responses alone, and what their inverse tracks.

The stack is the plant `PiezoStack`, read through `DisplacementSensor`; nothing of either is used
but what they answer. The voltage at an instant is computed from demands up to it. Errors are those
at the sensor's instants, sensor noise and mean included.
"""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from fmu_src.kit import Runner, SteadytipError
from fmu_src.piezo import inverse_modulated_stops, modulated_stops
from harness.identify.modulated_stops import StopsFit, excitation, identify_stops
from harness.parts.recording import recordings
from plants import displacement_sensor, piezo_stack

T = 1e-3
NOISE = 0.07e-6
"""rms of the sensor at 1 kHz [m] (A04 7.4)."""
TRAVEL = 12.5e-6
"""Peak to peak of the demands [m] (A04 7.4)."""
LOWEST = 4.35e-6
"""Bottom of the demands [m], so that they lie in the middle of what 0 to 100 V reach."""
SETTLED = 1300
"""Samples before a demand counts: exercise and the way to its beginning, and 0.3 s."""


def _respond(volts, seed, **parameters):
    """What the sensor reads at the end of each millisecond that a voltage is held."""
    substeps = round(T / piezo_stack.MODEL.sample_period)
    held = np.repeat(np.append(volts, volts[-1]), substeps)
    stack = Runner(piezo_stack.MODEL, parameters).run(len(held), {"volts": held})["stroke"]
    ends = stack[substeps::substeps]
    sensor = Runner(displacement_sensor.MODEL, {"seed": seed})
    return sensor.run(len(ends), {"stroke": ends})["measured"]


@pytest.fixture(scope="module")
def recording():
    volts = excitation(1 / T)
    return volts, _respond(volts, seed=1)


@pytest.fixture(scope="module")
def fit(recording) -> StopsFit:
    return identify_stops(*recording, T)


def _demand(shape):
    """Exercise over the whole range, then a demand of TRAVEL peak to peak [m]."""
    turn = 2 * np.pi * 2.5 * T * np.arange(800)
    wanted = LOWEST + TRAVEL * (shape - shape.min()) / np.ptp(shape)
    way = np.linspace(0, 1, 200, endpoint=False)
    rise = wanted[0] * way**2 * (3 - 2 * way)
    return np.concatenate((9.8e-6 * (1 - np.cos(turn)), rise, wanted))


def _error(fit, demand, seed, **drift):
    """Reading less demand at each instant [m]."""
    parameters = {f"operator.{name}": value for name, value in fit.parameters.items()}
    inverse = Runner(inverse_modulated_stops.MODEL, parameters)
    volts = inverse.run(len(demand), {"stroke": demand})["volts"]
    read = _respond(volts, seed, **drift)[:-1] - fit.offset
    return (read - demand[1:])[SETTLED:]


def _rms(error):
    return float(np.sqrt(np.mean(error**2)))


def _sine(frequency):
    return -np.cos(2 * np.pi * frequency * T * np.arange(5000))


def _swelling():
    """1, 10 and 19 Hz together, each swelling and fading (A04 Table 7.2)."""
    t = T * np.arange(5000)
    tones = ((1, 1.0, 0.3, 0), (10, 0.6, 0.23, 1), (19, 0.35, 0.41, 2))
    return sum(
        weight * (0.6 + 0.4 * np.sin(2 * np.pi * pace * t + phase)) * np.sin(2 * np.pi * f * t)
        for f, weight, pace, phase in tones
    )


def test_operator_explains_the_recording_down_to_the_sensor_noise(fit):
    assert fit.residual < 1.1 * NOISE
    assert fit.validation < 1.1 * NOISE
    assert fit.order == min(
        c.order for c in fit.candidates if c.validated <= 1.005 * fit.validation
    )


def test_prediction_is_what_the_fmu_gives(fit, recording):
    volts, _ = recording
    stroke = Runner(modulated_stops.MODEL, fit.parameters).run(len(volts), {"volts": volts})
    np.testing.assert_allclose(fit.predict(volts), stroke["stroke"] + fit.offset, atol=1e-15)


def test_sines_of_the_thesis_from_1_to_19_hz(fit):
    """A04 Table 7.1: 0.18 um in the mean, 0.52 um at the largest; here 0.13 and 0.45 at most."""
    errors = [_error(fit, _demand(_sine(f)), seed=f) for f in (1, 4, 7, 10, 13, 16, 19)]
    assert np.mean([_rms(e) for e in errors]) < 0.095e-6
    assert max(np.abs(e).max() for e in errors) < 0.45e-6


def test_several_tones_that_swell_and_fade(fit):
    """A04 Table 7.2: 0.13 um."""
    error = _error(fit, _demand(_swelling()), seed=50)
    assert _rms(error) < 0.1e-6
    assert np.abs(error).max() < 0.45e-6


def test_recorded_tremor(fit, data_dir):
    """A04 Table 7.3: 0.18 um; tremor band of the recorded hands, scaled to 12.5 um p-p."""
    band = butter(2, [6, 16], "bandpass", fs=250, output="sos")
    errors = []
    for seed, path in enumerate(recordings([data_dir / "hand_motion_m2s2"])):
        rows = np.loadtxt(path, delimiter=",")
        blank = np.flatnonzero(np.all(rows[:, 1:4] == 0, axis=1))
        rows = rows[: blank[0]] if blank.size else rows
        tremor = sosfiltfilt(band, rows[:, 1])[1000:2250]
        t = np.arange(len(tremor)) / 250
        motion = make_interp_spline(t, tremor, 5)(np.arange(0, t[-1], T))
        errors.append(_error(fit, _demand(motion), seed=60 + seed))
    assert len(errors) == 10
    assert np.mean([_rms(e) for e in errors]) < 0.1e-6
    assert max(np.abs(e).max() for e in errors) < 0.45e-6


def test_a_percent_of_gain_drift_costs_what_it_must(fit):
    """12.5 um p-p of 1 % is 0.044 um rms, and 1 % of the middle beside it: twice the error."""
    demand = _demand(_sine(10))
    still, drifted = (_rms(_error(fit, demand, 10, gain_error=g)) for g in (0.0, 0.01))
    assert 0.1e-6 < drifted < 0.2e-6
    assert drifted > 1.3 * still


def test_a_real_stage(data_dir):
    """Fitted on the first half, tested on the rest, rms of peak to peak."""
    rows = np.loadtxt(data_dir / "piezo_flexure" / "Model_Vi_Do.dat")
    volts, stroke = rows[:, 0], rows[:, 4] * 1e-6
    half = len(volts) // 2
    found = identify_stops(volts[:half], stroke[:half], 1 / 200)
    error = (found.predict(volts) - stroke)[half:] / np.ptp(stroke)
    assert 100 * np.std(error) < 0.25
    assert 100 * _rms(error) < 0.25


def test_known_operator_is_found_again():
    """From a stack that is such an operator, without noise."""
    volts = excitation(1 / T)
    stroke = Runner(modulated_stops.MODEL).run(len(volts), {"volts": volts})["stroke"]
    found = identify_stops(volts, stroke, T)
    assert found.residual < 5e-9
    np.testing.assert_allclose(found.predict(volts), stroke, atol=30e-9)


def test_identified_operators_always_have_an_inverse(recording):
    """Even of a recording that is nothing but noise on a slope."""
    volts, _ = recording
    rng = np.random.default_rng(2)
    found = identify_stops(volts, 1e-7 * volts + rng.normal(0, 3e-6, len(volts)), T)
    assert Runner(modulated_stops.MODEL, found.parameters).d[-1] == 1


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v, z: (v, z[:-1], T), "one length"),
        (lambda v, z: (v, np.where(np.arange(len(z)) == 3, np.nan, z), T), "stroke, sample 3: nan"),
        (lambda v, z: (v, -z, T), "falls while the voltage rises"),
        (lambda v, z: (np.linspace(0, 90, len(v)), z, T), "turns 0 times"),
        (lambda v, z: (v, z, 0.0), "must be above 0"),
        (lambda v, z: (v - 200, z, T), "must go above 0 V"),
    ],
)
def test_bad_recordings_say_what_is_wrong(recording, spoil, message):
    with pytest.raises(SteadytipError, match=message):
        identify_stops(*spoil(*recording))
