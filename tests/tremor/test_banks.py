"""Filters with a bank of fixed frequencies: what they reach on hands, and how calm they are."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from fmu_src.kit.model import Model
from fmu_src.kit.runner import Runner
from fmu_src.tremor import bmflc, bmflc_kf, oscillators
from tests.tremor.motions import T, recorded, reductions, tones

SIZE = 20e-6
HORIZON = 4e-3


@dataclass(frozen=True)
class Reached:
    """What one filter reaches, with a small margin."""

    model: Model
    a_posteriori: tuple[float, float]  # mean and worst recording, %
    in_band: tuple[float, float]
    ahead: tuple[float, float]  # means a-posteriori and in-band, 4 ms ahead
    intent: float  # of 1 mm at 1 Hz
    gain: tuple[float, float]  # of tones from 8 to 12 Hz
    phase: float  # largest, degrees


FILTERS = [
    Reached(bmflc.MODEL, (39, 28), (50.5, 48), (36, 48), 0.006, (0.52, 0.88), 31),
    Reached(bmflc_kf.MODEL, (37, 25.5), (53.5, 48), (34.5, 51.5), 0.0105, (0.5, 0.82), 26),
    Reached(oscillators.MODEL, (40, 28.5), (55.5, 52), (37, 53.5), 0.0095, (0.58, 0.86), 25),
]


@pytest.fixture(params=FILTERS, ids=lambda one: one.model.name)
def reached(request) -> Reached:
    return request.param


def _run(model: Model, position: np.ndarray, parameters: dict | None = None, **inputs):
    run = Runner(model, parameters).run(len(position), {"position": position, **inputs})
    return run["tremor"]


def _phasor(tremor: np.ndarray, frequency: float) -> np.ndarray:
    """Size and phase of a settled tone in units of `tones`, whole periods of a last second."""
    time = np.arange(len(tremor))[-1000:, None] * T
    reference = np.exp(1j * (2 * np.pi * frequency * time + np.arange(3.0)))
    return 2j * np.mean(tremor[-1000:] * reference.conj(), axis=0) / SIZE


@pytest.mark.parametrize("frequency", [8.0, 9.0, 10.0, 11.0, 12.0])
@pytest.mark.parametrize("horizon", [0.0, 4e-3, 10e-3])
def test_a_tone_comes_out_as_it_will_be_a_horizon_later(reached, frequency, horizon):
    tremor = _run(reached.model, tones(5.0, frequency), {"horizon": horizon})
    found = _phasor(tremor, frequency) * np.exp(-2j * np.pi * frequency * horizon)
    np.testing.assert_allclose(found, found[0], atol=1e-3)  # the axes are alike
    assert reached.gain[0] < abs(found[0]) < reached.gain[1]
    assert abs(np.degrees(np.angle(found[0]))) < reached.phase


@pytest.mark.parametrize("frequency", [8.0, 9.5, 12.0])
def test_a_wash_out_ahead_of_the_filter_is_undone(reached, frequency):
    """As if the position had not been through it, but for what beside a tone answers to it."""
    tone = tones(6.0, frequency)
    sections = signal.butter(3, 1.0, "highpass", fs=1 / T, output="sos")
    washed = signal.sosfilt(sections, tone, axis=0)
    plain = _phasor(_run(reached.model, tone), frequency)
    undone = _phasor(_run(reached.model, washed, {"wash_out": 1.0}), frequency)
    unaware = _phasor(_run(reached.model, washed), frequency)
    assert np.abs(undone - plain).max() < 0.07
    assert np.abs(undone - plain).max() < 0.5 * np.abs(unaware - plain).max()


def test_slow_intent_hardly_passes(reached):
    """1 Hz, 1 mm."""
    time = np.arange(10000) * T
    intent = 1e-3 * np.sin(2 * np.pi * time)
    found = _run(reached.model, np.column_stack([intent] * 3))
    assert found[3000:].std() < reached.intent * intent.std()


def test_rest_and_steady_drift_are_no_tremor(reached):
    drift = np.column_stack([np.zeros(8000), np.arange(8000) * 1e-6, np.full(8000, 0.3)])
    found = np.abs(_run(reached.model, drift)[-1000:])
    assert found[:, [0, 2]].max() < 1e-12
    assert found[:, 1].max() < 2e-6  # at 1 mm/s


@settings(max_examples=5)
@given(place=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
@pytest.mark.parametrize("model", [one.model for one in FILTERS], ids=lambda model: model.name)
def test_where_the_motion_begins_does_not_matter(model, place):
    tone = tones(1.0, 10.0)
    np.testing.assert_allclose(_run(model, tone + np.array(place)), _run(model, tone), atol=1e-11)


@pytest.mark.parametrize(("gap", "within", "after"), [(20, 0.3, 0.3), (100, 0.85, 1.0)])
def test_the_tremor_runs_on_while_the_position_is_not_valid(reached, gap, within, after):
    """Garbage is not looked at, and coming back somewhere else is no step.

    What is put out of a tone is spread over the bank, so it holds for a fraction of a period.
    """
    tone = tones(6.0, 10.0)
    valid = np.ones(len(tone))
    valid[4000 : 4000 + gap] = 0
    position = tone.copy()
    position[4000 : 4000 + gap] = 0.7
    position[4000 + gap :] += 0.02
    known = _run(reached.model, tone)
    error = np.abs(_run(reached.model, position, valid=valid) - known) / SIZE
    assert error[:4000].max() == 0.0
    assert error[4000 : 4000 + gap].max() < within
    assert error[4000 + gap :].max() < after
    assert error[4400:].max() < 0.06


def test_a_horizon_is_the_bank_running_on(reached):
    """What is put out ahead is what comes out then, if nothing more is observed."""
    generator = np.random.default_rng(11)
    position = tones(1.0, 9.3) + 1e-5 * np.cumsum(generator.standard_normal((1000, 3)), axis=0)
    valid = np.ones(1000)
    valid[900:] = 0
    later = _run(reached.model, position, valid=valid)
    ahead = _run(reached.model, position, {"horizon": 0.05}, valid=valid)
    np.testing.assert_allclose(ahead[899], later[949], atol=1e-12)
    np.testing.assert_allclose(ahead[920], later[970], atol=1e-12)


def test_without_any_valid_position_there_is_no_tremor(reached):
    tremor = _run(reached.model, np.full((300, 3), 0.7), valid=np.zeros(300))
    np.testing.assert_array_equal(tremor, 0.0)


def test_a_minute_brings_no_growth(reached):
    """The last second is the tenth, of a tone and of garbage that nobody believes."""
    tone = tones(60.0, 10.0)
    run = _run(reached.model, tone)
    np.testing.assert_allclose(run[-1000:], run[9000:10000], atol=0.01 * SIZE)
    runner = Runner(reached.model)
    runner.run(2000, {"position": tone[:2000]})
    unseen = runner.run(60000, {"position": np.full(3, 0.9), "valid": 0})["tremor"]
    assert np.abs(unseen).max() < 1.5 * SIZE
    back = runner.run(2000, {"position": tone[:2000]})["tremor"]
    np.testing.assert_allclose(back[-500:], run[1500:2000], atol=0.1 * SIZE)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("model", [one.model for one in FILTERS], ids=lambda model: model.name)
def test_nothing_in_range_makes_it_diverge(model, seed):
    generator = np.random.default_rng(seed)
    position = generator.uniform(-1, 1, (2000, 3))
    valid = generator.random(2000) < generator.choice([0.1, 0.5, 0.9, 1.0])
    run = _run(model, position, valid=valid)
    assert np.isfinite(run).all()
    assert np.abs(run).max() < 20


def _on_recordings(model: Model, data_dir: Path, horizon: float) -> np.ndarray:
    """Reductions for each raw recording, position known, (10, 2)."""
    ahead, figures = round(horizon / T), []
    for position in recorded(data_dir):
        tremor = _run(model, position, {"horizon": horizon})
        figures.append(reductions(position[ahead:], tremor[: len(position) - ahead]))
    return np.array(figures)


def test_recorded_hands_get_better_by_both_definitions(reached, data_dir):
    a_posteriori, in_band = _on_recordings(reached.model, data_dir, 0.0).T
    assert np.mean(a_posteriori) > reached.a_posteriori[0]
    assert np.min(a_posteriori) > reached.a_posteriori[1]
    assert np.mean(in_band) > reached.in_band[0]
    assert np.min(in_band) > reached.in_band[1]


def test_recorded_hands_get_better_a_horizon_ahead(reached, data_dir):
    a_posteriori, in_band = _on_recordings(reached.model, data_dir, HORIZON).T
    assert np.mean(a_posteriori) > reached.ahead[0]
    assert np.mean(in_band) > reached.ahead[1]
