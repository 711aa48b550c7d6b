"""The piezo stack against SciPy's integration, the design figures and A04 Table 7.1."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from fmu_src.kit.runner import Runner
from plants.piezo_stack import MODEL, Params

T = 1e-4
DRIVE = 90.0
"""Top of slow sines [V]: 12.5 um p-p at 19 Hz."""
TRAVEL = 12.5e-6
"""Peak to peak of the sines of A04 7.4 [m]."""
FREQUENCIES = (1, 4, 7, 10, 13, 16, 19)
A04 = (1.13, 1.12, 1.23, 1.19, 1.21, 1.30, 1.37)
"""The same, A04 Table 7.1, without a controller [um]."""


def run(volts, parameters=None):
    return Runner(MODEL, parameters).run(len(volts), {"volts": volts})["stroke"]


def last_cycles(frequency, cycles, settle, top=DRIVE):
    """Voltage and stroke of the last cycles of a sine from 0 V to the top."""
    samples = round((settle + cycles / frequency) / T)
    volts = top * (1 - np.cos(2 * np.pi * frequency * T * np.arange(samples))) / 2
    keep = round(cycles / frequency / T)
    return volts[-keep:], run(volts)[-keep:]


def cycles_of_travel(frequency, cycles, settle):
    """The same for the top that makes the stroke TRAVEL from end to end."""
    top = DRIVE
    for _ in range(3):
        volts, stroke = last_cycles(frequency, cycles, settle, top)
        top *= TRAVEL / np.ptp(stroke)
    return volts, stroke


def deviation(volts, stroke):
    """Residual from the best straight line."""
    return stroke - np.polyval(np.polyfit(volts, stroke, 1), volts)


def test_deviation_from_the_straight_line_is_that_of_the_thesis():
    """Table 7.1 without a model: sines of 12.5 um p-p, 0.07 um of sensor noise."""
    rng = np.random.default_rng(1)
    found = []
    for frequency in FREQUENCIES:
        volts, stroke = cycles_of_travel(frequency, 2, settle=1.0)
        found.append(deviation(volts, stroke + rng.normal(0, 0.07e-6, len(stroke))).std() * 1e6)
    np.testing.assert_allclose(found, A04, rtol=0.05)
    assert np.all(np.diff(found) > 0)


def test_loop_is_quasi_statically_as_wide_and_as_lopsided_as_that_of_a_stack():
    """13 to 15 % of peak to peak off a straight line, the branches of unlike shape."""
    volts, stroke = cycles_of_travel(0.5, 1, settle=2.0)
    half = len(volts) // 2
    span = np.ptp(stroke)
    ends = stroke[0] + (volts - volts[0]) / np.ptp(volts) * span
    assert 0.13 < np.abs(deviation(volts, stroke)).max() / span < 0.15
    assert 0.13 < np.abs(stroke - ends).max() / span < 0.15
    above = (stroke - ends)[half:].max() / span
    below = -(stroke - ends)[:half].min() / span
    assert abs(above - below) > 0.005


def test_first_slope_of_triangles_falls_with_the_rate_and_through_zero_near_36_hz():
    """Slope over the first 8 V, twice A04's first threshold, after the lower turning point."""

    def triangle(turn):
        return 1 - np.abs((turn / np.pi) % 2 - 1)

    slopes = []
    for frequency in (1, 10, 20, 36, 42):
        period = round(1 / frequency / T)
        top = 87.5
        cycles = 3
        volts = top * triangle(2 * np.pi * np.arange(cycles * period) / period)
        stroke = run(volts)[-period:]
        first = volts[-period:] <= 8.0
        first[period // 2 :] = False
        slopes.append(np.polyfit(volts[-period:][first], stroke[first], 1)[0])
    assert slopes[-2] > 0 > slopes[-1]
    assert slopes[-2] < 0.5 * slopes[0]


def test_stroke_at_100_volts_creeps_on():
    stroke = run(np.full(30_000, 100.0))
    assert 15e-6 < stroke[500] < stroke[5_000] < stroke[-1] < 19e-6
    share = Params.fields["creep_share"].start[0]
    slow = (stroke[-1] - stroke[3_000]) / stroke[3_000]
    assert 0 < slow < 4 * share


def test_step_rings_at_the_mode():
    stroke = run(
        np.full(200, 10.0), {"creep_share": 0.0, "charging_time": 1e-6, "slip_resistance": 1e-3}
    )
    f = np.fft.rfftfreq(2048, T)
    spectrum = np.abs(np.fft.rfft((stroke - stroke[-1]) * np.hanning(400)[200:], 2048))
    above = f > 300
    assert f[above][spectrum[above].argmax()] == pytest.approx(700, abs=30)
    overshoot = stroke.max() / stroke[-1] - 1
    assert overshoot == pytest.approx(np.exp(-np.pi * 0.06 / np.sqrt(1 - 0.06**2)), abs=0.03)


def scipy_stroke(p, volts):
    """The stack's equations by a stiff integrator, voltage held over each sample."""

    def slope(t, y, u):
        v, F, h, z, stroke, speed = y[0], y[1:7], y[7], y[8:13], y[13], y[14]
        dv = (u - v) / p.charging_time
        W = p.slip_threshold * max(0.3, 1 + p.slip_growth * (v / p.middle_voltage - 1))
        dF = dv - np.sign(F) * (np.maximum(np.abs(F) - W, 0) / p.slip_resistance) ** 2
        dh = dv - (1 + p.loop_lopsidedness * np.sign(dv)) * abs(dv) * h / p.loop_width
        left = v - p.slip_weight @ F - p.loop_weight * h
        y_i = p.gain * left * (1 + p.gain_slope * left + p.gain_curvature * left**2)
        dz = (p.creep_share * y_i - z) / p.creep_time
        w = 2 * np.pi * p.resonance
        force = w**2 * (y_i + z.sum() - stroke) - 2 * p.damping * w * speed
        return np.concatenate([[dv], dF, [dh], dz, [speed, force]])

    state, strokes = np.zeros(15), []
    for u in volts:
        strokes.append(state[13])
        solved = solve_ivp(
            slope, (0, T), state, "LSODA", args=(u,), rtol=1e-7, atol=1e-11, max_step=T / 4
        )
        state = solved.y[:, -1]
    return np.array(strokes)


def test_stroke_follows_the_differential_equations():
    """A minor loop within a major one, at the rates of tremor, to 30 nm of 12 um."""
    t = T * np.arange(600)
    volts = 45 * (1 - np.cos(2 * np.pi * 20 * t)) + 5 * np.sin(2 * np.pi * 90 * t)
    p = Params.unpack(Params.starts())
    np.testing.assert_allclose(run(volts), scipy_stroke(p, volts), atol=30e-9)


@settings(max_examples=30)
@given(arrays(float, 40, elements=st.floats(-20, 120)))
def test_any_drive_in_range_keeps_the_stroke_bounded(volts):
    stroke = run(np.repeat(volts, 10))
    assert np.all(np.isfinite(stroke))
    assert np.all(np.abs(stroke) < 60e-6)


@settings(max_examples=20)
@given(st.floats(5, 50), st.floats(5, 40))
def test_closed_minor_loop_returns_to_its_major_branch(bottom, size):
    """Wiping out: without creep and lag a small excursion leaves no trace."""
    still = {"creep_share": 0.0, "charging_time": 1e-6, "loop_weight": 0.0, "damping": 0.7}

    def ramp(*corners):
        return np.concatenate(
            [
                np.linspace(a, b, max(2, round(abs(b - a) * 40)))
                for a, b in itertools.pairwise(corners)
            ]
        )

    top = bottom + size
    direct = run(ramp(0, 110), still)
    looped = run(ramp(0, top, bottom, 110), still)
    assert looped[-1] == pytest.approx(direct[-1], abs=15e-9)


def test_gain_error_scales_the_stroke():
    volts = np.linspace(0, 80, 500)
    np.testing.assert_allclose(run(volts, {"gain_error": 0.1}), 1.1 * run(volts), rtol=1e-12)
