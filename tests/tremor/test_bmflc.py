"""BMFLC against its equations, and a tone of the grid without fading."""

import numpy as np
from scipy import signal

from fmu_src.kit.runner import Runner
from fmu_src.tremor import bmflc

T = 1e-3


def test_is_the_equations():
    """Weights, references and high-passes in plain NumPy, one axis, weights not as phasors."""
    tau, memory, corner, horizon = 0.05, 0.3, 6.0, 3e-3
    position = 1e-5 * np.cumsum(np.random.default_rng(1).standard_normal((600, 3)), axis=0)
    names = {"time_constant": tau, "memory": memory, "corner": corner, "horizon": horizon}
    found = Runner(bmflc.MODEL, names).run(600, {"position": position})["tremor"][:, 1]

    s = position[:, 1] - position[0, 1]
    b, a = signal.butter(1, corner, "highpass", fs=1 / T)
    for _ in range(bmflc.HIGH_PASS_ORDER):
        s = signal.lfilter(b, a, s)
    f = np.linspace(7.0, 13.0, bmflc.TONES)
    passes = signal.freqz(b, a, f, fs=1 / T)[1] ** bmflc.HIGH_PASS_ORDER
    w_sin, w_cos, expected = np.zeros(bmflc.TONES), np.zeros(bmflc.TONES), []
    for k in range(600):
        phi = 2 * np.pi * f * k * T
        epsilon = s[k] - np.sum(w_sin * np.sin(phi) + w_cos * np.cos(phi))
        w_sin = np.exp(-T / memory) * w_sin + 2 * T / tau * np.sin(phi) * epsilon
        w_cos = np.exp(-T / memory) * w_cos + 2 * T / tau * np.cos(phi) * epsilon
        later = np.exp(1j * (phi + 2 * np.pi * f * horizon))
        expected.append(np.sum(((w_sin + 1j * w_cos) / passes * later).imag))
    assert np.std(expected) > 1e-6
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_lasting_tone_of_the_grid_is_put_out_exactly():
    """Without fading, phase and size are those of a horizon later, high-passes undone."""
    time = np.arange(20000) * T
    for frequency, horizon, corner in ((8.0, 0.0, 10.0), (10.0, 0.01, 5.0), (12.0, 0.02, 10.0)):
        tone = 20e-6 * np.sin(2 * np.pi * frequency * time[:, None] + np.arange(3.0))
        later = 20e-6 * np.sin(2 * np.pi * frequency * (time[:, None] + horizon) + np.arange(3.0))
        names = {"memory": 1000.0, "time_constant": 1.0, "corner": corner, "horizon": horizon}
        run = Runner(bmflc.MODEL, names).run(len(tone), {"position": tone})["tremor"]
        assert np.abs(run - later)[-1000:].max() < 0.01 * 20e-6
