"""Zero-phase band-pass over past and future strides: what is called tremor, as weights.

    y   = sum_j w_j s_{k+j}                          j = -n..n, past and forecast
    w_j = T int Re(G e^(2 pi i f (h T_s - j T))) df  corrected where intent is, less their mean
    G   = H U
    H   = 1 / (1 + Q^4),  Q = (t^2 - a b) / ((b - a) t)
          t = tan(pi f T), a and b the same of f_1 and f_2

H is the squared gain of a Butterworth band-pass of second order: the band-pass run forwards and
backwards. A delay of the loop is a shift of w. Cut off at n strides the weights would let through
a percent of a slow motion, which is a hundred times a tremor; so they get the least change that
gives the response G has at the frequencies INTENT, and a constant vanishes, whatever else. What the
motion has been through, as a wash-out or a sensor's lag, is undone by a factor U in the same
weights.

INTENT and SOFTNESS were chosen on ten recordings of hands.

| symbol | field or argument | meaning |
| --- | --- | --- |
| s | | position |
| T, T_s | stride | stride, sample period |
| n | ahead | strides that the weights reach, both ways |
| h T_s | horizon | how far ahead the tremor is wanted |
| f_1, f_2 | lowest, highest | band of tremor |
| U | undo | undoes what the motion has been through |
| y | | tremor at the time t + horizon |
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Parameters
from fmu_src.kit.records import real
from fmu_src.math.phasors import Pair, product

GRID = (np.arange(64) + 0.5) / 64 * 60.0
"""Frequencies at which the band-pass is summed up [Hz]."""
INTENT = np.arange(0.0, 3.1, 0.5)
"""Frequencies at which the response of the weights is held [Hz]."""
SOFTNESS = 1e-2
"""Distance by which that may be missed, so that the response elsewhere changes little."""

WASH_OUT = real(
    "Hz", "f_w, wash-out that the position has been through, 0 if none", min=0.0, max=2.0
)
"""As far as the weights can undo it."""


class Band(Parameters):
    """Band of tremor."""

    lowest = real("Hz", "f_1, lower edge of the tremor's band", start=6.0, min=3.0, max=12.0)
    highest = real("Hz", "f_2, upper edge of the tremor's band", start=15.0, min=12.5, max=30.0)


def taps(
    p: Band, horizon: Any, undo: Callable[[Any], Pair], stride: float, ahead: int
) -> tuple[Any, Any]:
    """Weights w of the past, and of a forecast that comes as moves from stride to stride.

    Args:
        p: band.
        horizon: h T_s [s].
        undo: U at frequencies above 0, (n,) [Hz].
        stride: T [s].
        ahead: n.

    Returns:
        w of now and before, newest first, (n + 1,); and the sums of w from each stride ahead on,
        (n,): the first of them is the weight of now in a forecast, too.
    """
    low, high = (ca.tan(np.pi * f * stride) for f in (p.lowest, p.highest))

    def gain(frequencies: np.ndarray) -> Pair:
        """G, nothing at 0 Hz."""
        t = np.tan(np.pi * frequencies * stride)
        inside, outside = ((high - low) * ca.DM(t)) ** 4, (ca.DM(t**2) - low * high) ** 4
        undone = undo(ca.DM(np.where(frequencies > 0, frequencies, 1.0)))
        return product((inside / (inside + outside), 0.0), undone)

    lags = np.arange(-ahead, ahead + 1) * stride
    step = GRID[1] - GRID[0]
    phases = 2 * np.pi * (ca.DM(lags) - horizon) @ ca.DM(GRID).T
    real_part, imaginary = gain(GRID)
    found = 2 * stride * step * (ca.cos(phases) @ real_part + ca.sin(phases) @ imaginary)
    # Real and imaginary part of the response at the frequencies of intent, by row.
    turns = 2 * np.pi * np.outer(INTENT, lags)
    response = np.vstack((np.cos(turns), np.sin(turns)))
    square = response @ response.T + SOFTNESS * np.eye(len(response))
    correct = np.linalg.solve(square, response).T
    c, s = (of(2 * np.pi * ca.DM(INTENT) * horizon) for of in (ca.cos, ca.sin))
    real_part, imaginary = gain(INTENT)
    wanted = ca.vertcat(real_part * c - imaginary * s, real_part * s + imaginary * c)
    found -= ca.DM(correct) @ (ca.DM(response) @ found - wanted)
    found -= ca.sum1(found) / found.shape[0]
    return found[ahead::-1], ca.cumsum(found[:ahead:-1])[::-1]
