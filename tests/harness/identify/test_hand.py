"""The hand's parameters from its own motion, and from the recordings."""

import numpy as np
import pytest
from scipy import signal

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.identify.hand.fit import filter_density, identify_hand
from plants.hand import MODEL, Params

pytestmark = pytest.mark.xdist_group("identify_hand")  # its tests share what takes long

RATE = 250.0
STARTS = Params.unpack(Params.starts())
FITTED = (
    "intent_rms",
    "intent_corner",
    "correction_rms",
    "correction_corner",
    "correction_rate",
    "tremor_rms",
    "tremor_bandwidth",
)


def generated(seconds, **parameters):
    tip = CompiledRunner(MODEL, {"seed": 2, **parameters}).run(round(seconds * 1000))["tip"]
    return tip[::4]


@pytest.fixture(scope="module")
def fits(data_dir):
    """Parameters of each of the ten recordings."""
    found = []
    for path in sorted((data_dir / "hand_motion_m2s2").glob("*.csv")):
        position = np.loadtxt(path, delimiter=",", usecols=(1, 2, 3)) * 1e-3
        ends = np.flatnonzero((position == 0).all(axis=1))
        found.append(identify_hand(position[: ends[0]] if len(ends) else position, RATE))
    assert len(found) == 10
    return found


def test_parameters_of_the_generator_are_found_in_its_motion():
    found = identify_hand(generated(240, tremor_bandwidth=2.0), RATE)
    assert set(found) == set(FITTED)
    expected = {name: getattr(STARTS, name) for name in FITTED} | {"tremor_bandwidth": 2.0}
    # Slow motion has few independent stretches in four minutes; a rate is a fourth moment.
    tolerance = {"intent_rms": 0.25, "intent_corner": 0.25, "correction_rate": 0.5}
    for name, value in found.items():
        np.testing.assert_allclose(
            value, expected[name], rtol=tolerance.get(name, 0.15), err_msg=name
        )


def test_other_parameters_are_found_as_well():
    other = {
        "intent_rms": np.array([50e-6, 100e-6, 400e-6]),
        "intent_corner": 0.6,
        "correction_rms": np.array([20e-6, 30e-6, 15e-6]),
        "correction_corner": 1.8,
        "correction_rate": 2.0,
        "tremor_rms": np.array([4e-6, 20e-6, 8e-6]),
        "tremor_bandwidth": 1.0,
    }
    found = identify_hand(generated(240, **other), RATE)
    for name, value in found.items():
        np.testing.assert_allclose(value, other[name], rtol=0.5, err_msg=name)


def test_a_narrow_tremor_is_seen_as_narrow():
    """Bands are a sixth of an octave, about 1 Hz at the carrier; nothing finer is resolved."""
    found = identify_hand(generated(240), RATE)
    assert found["tremor_bandwidth"] < 0.8
    np.testing.assert_allclose(found["tremor_rms"], STARTS.tremor_rms, rtol=0.25)


def test_density_is_that_of_the_filter():
    """SciPy's frequency response of four poles, scaled to unit variance."""
    f = np.linspace(0, 2000, 400_001)
    corner = 0.7
    p = 2 * np.pi * corner
    _, response = signal.freqs_zpk([], [-p] * 4, p**4, 2 * np.pi * f)
    expected = np.abs(response) ** 2 / np.trapezoid(np.abs(response) ** 2, f)
    np.testing.assert_allclose(filter_density(f, corner), expected, rtol=1e-4)


def test_declared_starts_are_the_geometric_means_of_the_recordings(fits):
    for name in FITTED[:-1]:
        mean = np.exp(np.mean(np.log([fit[name] for fit in fits]), axis=0))
        np.testing.assert_allclose(getattr(STARTS, name), mean, rtol=0.05, err_msg=name)


def test_tremor_of_hands_is_broad_unlike_the_declared_one(fits):
    bandwidth = np.array([fit["tremor_bandwidth"] for fit in fits])
    assert np.all(bandwidth > 4)
    assert STARTS.tremor_bandwidth < 0.1 * bandwidth.min()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda x: x[:, :2], r"shape \(5000, 2\), needed is \(samples, 3\)"),
        (lambda x: np.where(np.arange(5000)[:, None] == 7, np.nan, x), "nan in sample 7, axis x"),
        (lambda x: x[:1000], "4 s long, needed are at least 10 s"),
        (lambda x: x * [1, 0, 1] + 0.0, "axis y stays at 0 m"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said(change, text):
    position = np.random.default_rng(3).normal(size=(5000, 3))
    with pytest.raises(SteadytipError, match=text):
        identify_hand(change(position), RATE)


def test_a_slow_recording_is_refused():
    with pytest.raises(SteadytipError, match="20 samples in a second"):
        identify_hand(np.random.default_rng(3).normal(size=(5000, 3)), 20.0)
