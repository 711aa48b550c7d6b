"""Figures of merit against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from harness.results.metrics import MetricInputs, angle_between, metrics_of

STEP = 1e-3
T = np.arange(20_000) * STEP


def tone(frequency: float, amplitude: float, phase: float = 0.0) -> np.ndarray:
    """The same sine on all axes, (n, 3)."""
    wave = amplitude * np.sin(2 * np.pi * frequency * T + phase)
    return np.repeat(wave[:, None], 3, axis=1)


def value(name: str, **signals) -> float:
    return metrics_of(MetricInputs(STEP, warm_up=2.0, **signals))[name].value


@settings(max_examples=10)
@given(st.floats(0.0, 1.5), st.floats(7.5, 13.0))
def test_a_scaled_tone_is_reduced_by_its_scale_in_every_definition(scale, frequency):
    """x = v + tremor, y = v + scale * tremor: every reduction is 100 (1 - scale)."""
    intent = tone(0.5, 1e-3)
    # It dies away at the ends, where any zero-phase filter has to guess what comes next.
    tremor = tone(frequency, 50e-6) * signal.windows.tukey(len(T), 0.2)[:, None]
    given_ = {
        "tip_uncompensated": intent + tremor,
        "tip": intent + scale * tremor,
        "intent": intent,
    }
    for name in ("reduction_in_band", "reduction_in_band_axes"):
        assert value(name, **given_) == pytest.approx(100 * (1 - scale), abs=0.05)
    assert value("reduction_a_posteriori", **given_) == pytest.approx(100 * (1 - scale), abs=1e-6)
    # The target is the tremor times the gain g of its band-pass, forwards and backwards.
    sos = signal.butter(2, (6.0, 15.0), "bandpass", fs=1 / STEP, output="sos")
    g = abs(signal.sosfreqz(sos, [frequency], fs=1 / STEP)[1][0]) ** 2
    by_axis = value("reduction_a_posteriori_axes", **given_)
    assert by_axis == pytest.approx(100 * (1 - abs(g - (1 - scale)) / g), abs=0.5)


def test_rms_is_over_time_and_all_three_axes_about_the_mean():
    zero = np.zeros((len(T), 3))
    tip = tone(10.0, 10e-6) * [1.0, 2.0, 0.0] + [5e-6, 0.0, 1e-3]
    got = metrics_of(MetricInputs(STEP, tip_uncompensated=2 * tip, tip=tip, intent=zero))
    assert got["tip_rms"].value == pytest.approx(10e-6 * np.sqrt(5 / 2), rel=1e-6)
    assert got["tip_rms_uncompensated"].value == pytest.approx(20e-6 * np.sqrt(5 / 2), rel=1e-6)
    assert got["worst_excursion"].value == pytest.approx(10e-6 * np.sqrt(5), rel=1e-4)
    assert got["tip_rms"].unit == "m"


def test_what_is_not_in_the_band_does_not_count_in_band():
    tremor, drift = tone(10.0, 50e-6), tone(0.2, 1e-3)
    zero = np.zeros((len(T), 3))
    got = {"tip_uncompensated": tremor, "tip": 0.5 * tremor + drift, "intent": zero}
    assert value("reduction_in_band", **got) == pytest.approx(50.0, abs=0.1)
    assert value("reduction_a_posteriori", **got) < -1000.0


def test_a_recordings_intent_is_its_slow_part_and_the_definition_says_so():
    intent, tremor = tone(0.3, 1e-3), tone(12.0, 50e-6)
    got = metrics_of(MetricInputs(STEP, 2.0, tip_uncompensated=intent + tremor, tip=intent))
    metric = got["reduction_a_posteriori"]
    # butter(4) forwards and backwards lets 1 / (1 + (12 / 6)^8) of the tremor into v.
    left = 1 / (1 + 2.0**8)
    assert metric.value == pytest.approx(100 * (1 - left / (1 - left)), abs=0.5)
    assert "low-pass" in metric.definition
    assert "6 Hz" in metric.definition
    stated = metrics_of(
        MetricInputs(STEP, 2.0, tip_uncompensated=intent + tremor, tip=intent, intent=intent)
    )
    assert "generator" in stated["reduction_a_posteriori"].definition


def test_filters_do_not_ring_in_from_the_ends():
    """A slow motion that begins and ends far from zero has nothing in the band."""
    ramp = np.repeat(1e-3 * (1.0 + T[:, None]), 3, axis=1)
    tremor = tone(10.0, 50e-6)
    got = {"tip_uncompensated": ramp + tremor, "tip": ramp + 0.25 * tremor, "intent": ramp}
    short = metrics_of(MetricInputs(STEP, 0.0, **got))["reduction_in_band"].value
    assert short == pytest.approx(75.0, abs=0.2)


def test_a_tip_without_tremor_has_no_reduction():
    zero = np.zeros((len(T), 3))
    got = metrics_of(MetricInputs(STEP, tip_uncompensated=zero, tip=zero, intent=zero))
    assert "reduction_in_band" not in got
    assert got["tip_rms"].value == 0.0


def test_figures_whose_signals_are_missing_are_left_out():
    assert metrics_of(MetricInputs(STEP)) == {}
    only_tip = metrics_of(MetricInputs(STEP, tip=tone(10.0, 1e-6), intent=tone(10.0, 0.0)))
    assert set(only_tip) == {"tip_rms", "worst_excursion"}


def test_less_than_a_second_gives_no_figures():
    assert (
        metrics_of(MetricInputs(STEP, warm_up=19.5, tip=tone(9.0, 1.0), intent=tone(9.0, 0.0)))
        == {}
    )


def test_drive_figures():
    drive = 40.0 + tone(10.0, 3.0)
    assert value("drive_rms", actuator_voltage=drive) == pytest.approx(3.0 / np.sqrt(2), rel=1e-3)
    rate = 3.0 * 2 * np.pi * 10.0 / np.sqrt(2)
    assert value("drive_rate", actuator_voltage=drive) == pytest.approx(rate, rel=1e-3)
    saturated = (np.arange(len(T)) % 4 == 0).astype(float)[:, None]
    assert value("saturated", saturated=saturated) == pytest.approx(25.0)


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.floats(0.0, np.pi),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda a: np.linalg.norm(a) > 0.1),
)
def test_the_angle_between_attitudes_is_that_of_the_rotation_between_them(q, angle, axis):
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    vector = np.array(axis) / np.linalg.norm(axis) * np.sin(angle / 2)
    s, (a, b, c) = np.cos(angle / 2), vector
    turned = np.array(
        [
            w * s - x * a - y * b - z * c,
            w * a + x * s + y * c - z * b,
            w * b - x * c + y * s + z * a,
            w * c + x * b - y * a + z * s,
        ]
    )
    first = np.array([[w, x, y, z]])
    for sign in (1.0, -1.0):
        assert angle_between(first, sign * turned[None])[0] == pytest.approx(angle, abs=1e-9)


def test_attitude_figures_and_speed():
    true = np.tile([1.0, 0.0, 0.0, 0.0], (len(T), 1))
    off = np.tile([np.cos(0.01), np.sin(0.01), 0.0, 0.0], (len(T), 1))
    got = metrics_of(
        MetricInputs(STEP, ticks=len(T), wall=4.0, attitude_true=true, attitude_estimated=off)
    )
    assert got["attitude_error_rms"].value == pytest.approx(0.02)
    assert got["attitude_error_max"].value == pytest.approx(0.02)
    assert got["real_time_factor"].value == pytest.approx(5.0)
