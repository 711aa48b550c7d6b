"""The prefilter against SciPy, and what it passes."""

import casadi as ca
import numpy as np
from scipy import signal

from fmu_src.math import elliptic
from fmu_src.math.elliptic import EllipticState, band_pass, sections

T = 1e-3


def test_runs_as_scipy_runs_its_sections():
    memory, s = ca.SX.sym("memory", EllipticState.size()), ca.SX.sym("s", 3)
    following, y = band_pass(s, EllipticState.unpack(memory), T)
    step = ca.Function("step", [memory, s], [following.pack(), y])
    signals = np.random.default_rng(5).standard_normal((500, 3))
    x, outputs = EllipticState.starts(), []
    for sample in signals:
        x, y = step(x, sample)
        outputs.append(np.array(y).ravel())
    np.testing.assert_allclose(outputs, signal.sosfilt(sections(T), signals, axis=0), atol=1e-12)


def test_keeps_the_stated_ripple_and_attenuation():
    frequencies = np.array([*elliptic.PASSBAND, 8.0, 10.0, 12.0, 1.0, 3.0, 30.0])
    _, response = signal.sosfreqz(sections(T), frequencies, fs=1 / T)
    loss = -20 * np.log10(np.abs(response))
    assert np.all(loss[:5] < elliptic.RIPPLE + 1e-6)
    assert np.all(loss[5:] > elliptic.ATTENUATION - 1e-6)
