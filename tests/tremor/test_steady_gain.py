"""Kalman gains of the steady state against the recursion of the covariance, and whole filters."""

import numpy as np
import pytest

from fmu_src.kit.runner import Runner
from fmu_src.math import phasors
from fmu_src.tremor import bmflc_kf, oscillators

T = 1e-3


def _noise_of_phasors(module) -> np.ndarray:
    if module is bmflc_kf:
        return np.full(module.TONES, module.TREMOR_NOISE * T)
    f = module.FREQUENCIES
    width = np.array([module.WIDTHS[0] if one < module.CENTRE else module.WIDTHS[1] for one in f])
    bump = np.exp(-((f - module.CENTRE) ** 2) / (2 * width**2))
    return module.TREMOR_NOISE * T * (bump + module.FLOOR)


def _model(module) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, Q and C with each tone's parts side by side: another order than the filter's."""
    n, f = module.ORDER, module.FREQUENCIES
    size = n + 2 * len(f)
    A, Q, C = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
    A[:n, :n] = phasors.intent_transition(n, module.INTENT_MEMORY, T)
    Q[:n, :n] = module.INTENT_NOISE * phasors.intent_noise(n, T)
    C[0] = 1.0
    for i, (one, noise) in enumerate(zip(f, _noise_of_phasors(module), strict=True)):
        place = slice(n + 2 * i, n + 2 * i + 2)
        c, s = np.cos(2 * np.pi * one * T), np.sin(2 * np.pi * one * T)
        A[place, place] = np.exp(-T / module.MEMORY) * np.array([[c, -s], [s, c]])
        Q[place, place] = noise * np.eye(2)
        C[n + 2 * i] = 1.0
    return A, Q, C


@pytest.mark.parametrize("module", [bmflc_kf, oscillators])
def test_filters_are_the_kalman_filter_of_their_equations(module):
    """A filter with a covariance of its own, run until that has settled, then on the same data."""
    A, Q, C = _model(module)
    n, P = module.ORDER, np.eye(len(A))
    for _ in range(6000):
        P = A @ P @ A.T + Q
        gain = P @ C / (C @ P @ C + 1.0)
        P = P - np.outer(gain, C @ P)
    kept = gain.copy()
    intent, tones = module.FILTER.gains(T)
    half = module.TONES
    np.testing.assert_allclose(intent, kept[:n], rtol=1e-4)
    scale = np.abs(kept[n:]).max()
    np.testing.assert_allclose(tones[:half], kept[n::2], atol=1e-4 * scale)
    np.testing.assert_allclose(tones[half:], kept[n + 1 :: 2], atol=1e-4 * scale)

    position = 1e-5 * np.cumsum(np.random.default_rng(2).standard_normal((800, 3)), axis=0)
    found = Runner(module.MODEL).run(800, {"position": position})["tremor"][:, 2]
    share = module.share() if module is oscillators else np.ones(half)
    x, expected = np.zeros(len(A)), []
    for s in position[:, 2] - position[0, 2]:
        x = A @ x
        x = x + kept * (s - C @ x)
        expected.append(share @ x[n::2])
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("order", [2, 3])
def test_noise_of_the_intent_is_what_white_noise_adds_in_a_sample(order):
    added = phasors.intent_noise(order, 0.5)
    assert added.shape == (order, order)
    np.testing.assert_allclose(added[-1, -1], 0.5)  # density times time
    np.testing.assert_allclose(np.linalg.matrix_rank(added), 1)
    np.testing.assert_allclose(added[-2, -1], 0.5**2 / 2)


@pytest.mark.parametrize("order", [2, 3])
def test_an_intent_that_nobody_observes_comes_to_rest(order):
    A = phasors.intent_transition(order, 0.1, T)
    later = np.linalg.matrix_power(A, 10000) @ np.ones(order)
    np.testing.assert_allclose(A @ later, later, atol=1e-12)
    assert later[0] < 1.5
