"""Elliptic band-pass ahead of the adaptive frequency (A04 5.2.1).

Keeps voluntary motion, which is stronger than tremor, away from the frequency's adaptation. A04
gives order 6 and corners at 7 and 13 Hz; a band-pass of order 6 has a prototype of order 3, so it
is three second-order sections, run in the transposed direct form II:

    y   = b0 s + m1
    m1' = b1 s - a1 y + m2
    m2' = b2 s - a2 y

| symbol | field or constant | meaning |
| --- | --- | --- |
| s, y | signal | input and output of one section, three axes |
| m1, m2 | memory | delayed sums of a section, rows 2i and 2i+1 for section i |
| a, b | `sections` | coefficients for the sample period T |
"""

from collections.abc import Iterable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from scipy import signal

from fmu_src.kit import State
from fmu_src.kit.records import real

PROTOTYPE_ORDER = 3
"""Order of the low-pass prototype, and number of second-order sections."""
PASSBAND = (7.0, 13.0)
"""Corner frequencies [Hz] (A04 5.2.1)."""
RIPPLE = 1.0
"""Largest loss within the pass-band [dB]; not in A04, a common choice."""
ATTENUATION = 40.0
"""Least loss in the stop-bands [dB]; not in A04: 1 mm of intent is left with 10 um at most."""


class EllipticState(State):
    """Memory of the sections."""

    memory = real("m", "delayed sums of the sections", shape=(2 * PROTOTYPE_ORDER, 3))


@cache
def sections(T: float) -> np.ndarray:
    """Coefficients b0, b1, b2, 1, a1, a2 of the sections, shape (PROTOTYPE_ORDER, 6).

    Args:
        T: sample period [s].
    """
    return signal.ellip(
        PROTOTYPE_ORDER, RIPPLE, ATTENUATION, PASSBAND, "bandpass", output="sos", fs=1 / T
    )


def band_pass(position: Any, x: EllipticState, T: float) -> tuple[EllipticState, ca.SX]:
    """Filter one sample.

    Args:
        position: (3,) [m].
        x: memory.
        T: sample period [s].

    Returns:
        New memory, and the filtered position, (3,) [m].
    """
    memory, y = cascade(position, x.memory, np.delete(sections(T), 3, axis=1))
    return EllipticState(memory=memory), y


def cascade(s: Any, memory: Any, coefficients: Iterable[Any]) -> tuple[Any, Any]:
    """Sections of second order in a row, one sample.

    Args:
        s: input, (3,) [m].
        memory: m1 and m2 of each section, (2 sections, 3) [m].
        coefficients: b0, b1, b2, a1, a2 of each section.

    Returns:
        New memory, and the output, (3,) [m].
    """
    rows = []
    for i, (b0, b1, b2, a1, a2) in enumerate(coefficients):
        m1, m2 = memory[2 * i, :].T, memory[2 * i + 1, :].T
        y = b0 * s + m1
        rows += [b1 * s - a1 * y + m2, b2 * s - a2 * y]
        s = y
    return ca.horzcat(*rows).T, s
