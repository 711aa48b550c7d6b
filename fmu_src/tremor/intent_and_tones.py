"""Kalman filter of slow intent and a bank of fading tones, in its steady state.

    v    = intent and its derivatives, v' = A v + noise
    z_i  = phasor of frequency f_i, z_i' = e^((i 2 pi f_i - 1 / tau_m) T) z_i + noise
    s    = first of v + sum Re z_i + noise
    v, z = expected + gain (s - expected)

The gain is that of the Kalman filter in its steady state (`phasors.steady_gain`). While the
position is not valid, nothing is learnt and the model runs on.

| symbol | field | meaning |
| --- | --- | --- |
| f_i | frequencies | of the tones [Hz] |
| tau_m | memory | time within which the tones fade [s] |
| v | | place, speed and, in the third order, acceleration |
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from fmu_src.kit import State
from fmu_src.math import phasors

_INTENT = ("place", "speed", "acceleration")

S = TypeVar("S", bound=State)


@dataclass(frozen=True, eq=False)
class IntentAndTones:
    """Filter of one design.

    Attributes:
        frequencies: f, (TONES,) [Hz].
        memory: tau_m [s].
        tremor_noise: density of each part of each phasor's noise, (TONES,) [1/s]; that of the
            position is 1.
        order: of the intent, 2 or 3.
        intent_memory: time within which all of the intent but its place fades [s].
        intent_noise: density of the noise of its highest derivative's derivative; that of the
            position is 1.
    """

    frequencies: np.ndarray
    memory: float
    tremor_noise: np.ndarray
    order: int
    intent_memory: float
    intent_noise: float

    def _turn(self, T: float) -> np.ndarray:
        """Return the complex factor of each tone from one sample to the next, (TONES,)."""
        return np.exp((2j * np.pi * self.frequencies - 1 / self.memory) * T)

    @cache  # noqa: B019 - filters are constants of their modules
    def gains(self, T: float) -> tuple[np.ndarray, np.ndarray]:
        """Compute the gains of the intent, (order,), and of the phasors, (2 TONES,)."""
        return phasors.steady_gain(
            phasors.intent_transition(self.order, self.intent_memory, T),
            self.intent_noise * phasors.intent_noise(self.order, T),
            self._turn(T),
            self.tremor_noise * T,
        )

    def advance(self, position: Any, valid: Any, x: S, T: float) -> S:
        """Advance by one sample.

        Args:
            position: s, (3,) [m].
            valid: 1 to learn from this sample, 0 to let the model run on.
            x: state with `tracked`, `origin`, `phasors`, `place`, `speed` and, in the third order,
                `acceleration`.
            T: sample period [s].
        """
        intent_gain, phasor_gain = self.gains(T)
        turn = self._turn(T)
        names = _INTENT[: self.order]
        state: Any = x
        z = phasors.apply(ca.DM(np.concatenate([turn.real, turn.imag])), state.phasors)
        v = ca.DM(phasors.intent_transition(self.order, self.intent_memory, T)) @ ca.vertcat(
            *(getattr(x, name).T for name in names)
        )
        expected = v[0, :].T + phasors.total(z)
        motion, origin = phasors.count(position, valid, expected, x)
        error = (valid * (motion - expected)).T
        v = v + ca.DM(intent_gain) @ error
        z = z + ca.DM(phasor_gain) @ error
        intent = {name: v[row, :].T for row, name in enumerate(names)}
        return type(x)(tracked=valid, origin=origin, phasors=z, **intent)
