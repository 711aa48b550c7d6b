"""A stack identified from its recorded response alone, and the inverse that comes of it."""

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from fmu_src.kit.runner import Runner
from fmu_src.piezo import (
    creeping,
    inverse_creeping,
    inverse_prandtl_ishlinskii,
    prandtl_ishlinskii,
    rate_dependent,
)
from fmu_src.piezo.prandtl_ishlinskii import Hysteresis
from harness.identify.hysteresis.plays import (
    HysteresisFit,
    excitation,
    identify_creeping,
    identify_hysteresis,
    identify_rate_dependence,
    loading_slopes,
    stroke_rate,
    sweep,
)
from tests.harness.identify.commands import plant_response

RATE = 1000.0
SENSOR_NOISE = 0.07e-6
"""rms at 1 kHz [m] (A04 7.4)."""
SETTLED = 2000
"""Samples left out ahead of an error."""


def _noise(samples: int, seed: int) -> np.ndarray:
    return SENSOR_NOISE * np.random.default_rng(seed).standard_normal(samples)


@pytest.fixture(scope="module")
def recording() -> tuple[np.ndarray, np.ndarray]:
    volts = excitation(RATE)
    return volts, plant_response(volts, RATE) + _noise(len(volts), seed=74)


@pytest.fixture(scope="module")
def fit(recording) -> HysteresisFit:
    return identify_hysteresis(*recording)


def _tracking_error(amplitude: float, frequency: float) -> np.ndarray:
    """Error of the shipped inverse on the stack, without sensor noise."""
    time = np.arange(0, 5, 1 / RATE)
    rise = np.clip(time / 0.5, 0, 1)
    wanted = rise * (9e-6 - amplitude * np.cos(2 * np.pi * frequency * time))
    drive = Runner(inverse_prandtl_ishlinskii.MODEL).run(len(time), {"stroke": wanted})
    return (plant_response(drive["volts"], RATE) - wanted)[SETTLED:]


def test_the_operator_explains_the_recording_down_to_the_sensor_noise(fit):
    assert fit.residual < 1.2 * SENSOR_NOISE


def test_shipped_weights_are_what_the_identification_gives(fit):
    """Another noise, the same stack: weights within what noise does to them."""
    shipped = {name: np.array(Hysteresis.fields[name].start) for name in fit.parameters}
    np.testing.assert_allclose(fit.parameters["weights"], shipped["weights"], atol=0.03)
    np.testing.assert_allclose(fit.parameters["saturation"], shipped["saturation"], atol=3e-9)


def test_inverse_tracks_the_sine_of_the_thesis():
    """12.5 um p-p at 10 Hz, sensor noise included: A04 Table 7.1 has 0.14 um, 1.19 um without."""
    error = _tracking_error(6.25e-6, 10.0)
    error = error + _noise(len(error), seed=10)
    assert np.std(error) < 0.14e-6


def test_inverse_tracks_from_1_to_19_hz():
    """Mean over Table 7.1's frequencies (there 0.23 um); what depends on the rate remains."""
    errors = [np.std(_tracking_error(6.25e-6, f)) for f in (1, 4, 7, 10, 13, 16, 19)]
    assert np.mean(errors) < 0.13e-6


def test_small_strokes_come_out_with_the_right_size():
    """A lateral tremor of 50 um p-p takes some 0.7 um of stroke, far from the loops' full size."""
    error = _tracking_error(0.35e-6, 10.0)
    assert np.std(error) < 0.07 * 0.35e-6


def test_known_operator_is_found_again():
    """From a stack that is an operator of this kind, without noise, the weights come back."""
    weights = np.linspace(0.5, 0.05, 10)
    volts = excitation(RATE)
    model = Runner(prandtl_ishlinskii.MODEL, {"weights": weights})
    found = identify_hysteresis(volts, model.run(len(volts), {"volts": volts})["stroke"])
    np.testing.assert_allclose(found.parameters["weights"], weights, atol=2e-3)
    assert found.residual < 1e-10


def test_known_creep_is_found_again():
    """Weights of plays and creep operators come back from a stack that is such an operator."""
    known = {"weights": np.linspace(0.5, 0.05, 10), "creep_weights": [0.0, 0.03, 0.0, 0.01]}
    volts = excitation(RATE)
    stroke = Runner(creeping.MODEL, known).run(len(volts), {"volts": volts})["stroke"]
    found = identify_creeping(volts, stroke, 1 / RATE)
    assert found.residual < 1e-9
    for name, values in known.items():
        np.testing.assert_allclose(found.parameters[name], values, atol=5e-3)
    assert found.offset == pytest.approx(0.0, abs=20e-9)


def test_known_dependence_on_the_rate_is_found_again():
    """From saw-teeth of several rates (A04 7.3.2), all but the dependence of what hardly moves."""
    known = {"weights": np.linspace(0.5, 0.05, 10), "rate_slopes": np.linspace(-400, 200, 10)}
    volts = np.concatenate(sweep(RATE, (1.0, 2.0, 4.0, 6.0, *np.arange(8.0, 40.0, 4.0))))
    shipped = Runner(rate_dependent.MODEL).model.parameters
    plain = {n: np.array(shipped.fields[n].start) for n in Hysteresis.fields} | known
    rate = stroke_rate(plain, volts, 1 / RATE)
    runner = Runner(rate_dependent.MODEL, known)
    stroke = runner.run(len(volts), {"volts": volts, "rate": rate})["stroke"]
    found = identify_rate_dependence(volts, stroke, 1 / RATE)
    assert found.residual < 30e-9
    assert found.parameters["rate_slopes"][0] == pytest.approx(-400, rel=0.1)
    np.testing.assert_allclose(found.parameters["weights"][:5], known["weights"][:5], atol=0.05)


def test_every_fit_has_an_inverse(recording):
    """Rate-dependent ones at every rate that was in the recording, and more."""
    volts, stroke = recording
    found = identify_rate_dependence(volts, stroke, 1 / RATE)
    singular, defined = Runner(rate_dependent.MODEL, found.parameters).d
    assert defined == 1
    assert singular == rate_dependent.FASTEST
    creep = identify_creeping(volts, stroke, 1 / RATE).parameters
    runner = Runner(inverse_creeping.MODEL, {f"hysteresis.{n}": v for n, v in creep.items()})
    names = [scalar.name for scalar in runner.model.derived.scalars()]
    assert runner.d[names.index("inverse.defined")] == 1


def test_slopes_of_one_rate_are_those_of_a_known_operator():
    (volts,) = sweep(RATE, (5.0,))
    weights = np.linspace(0.5, 0.05, 10)
    model = Runner(prandtl_ishlinskii.MODEL, {"weights": weights})
    stroke = model.run(len(volts), {"volts": volts})["stroke"]
    fields = {n: np.array(Hysteresis.fields[n].start) for n in Hysteresis.fields}
    found = loading_slopes(volts, stroke + 1e-6, fields | {"weights": weights})
    # The last play is wider than half the saw-tooth: it does not turn.
    np.testing.assert_allclose(found[:-1], np.cumsum(weights)[:-1], atol=1e-6)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v, z: (v, z[:-1]), "one length"),
        (lambda v, z: (v, np.where(np.arange(len(z)) == 3, np.nan, z)), "stroke, sample 3: nan"),
        (lambda v, z: (v, -z), "falls while the voltage rises"),
        (lambda v, z: (np.linspace(0, 90, len(v)), z), "turns 0 times"),
    ],
)
def test_bad_recordings_say_what_is_wrong(recording, spoil, message):
    with pytest.raises(SteadytipError, match=message):
        identify_hysteresis(*spoil(*recording))
