"""Attenuation of a motion by a loop, and the delay that its command bears.

    left(f)       = |A(f)|_F / sqrt(3)                tip by hand motion along any axis, rms
    left(band)    = sqrt(mean of left^2 over BAND)    of a tremor that may be anywhere in the band

For a loop that cancels a scalar with gain g and delay T, A = 1 - g exp(-i w T), so that left at
most a needs cos(w T) >= (1 + g^2 - a^2) / 2 g.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import control
import numpy as np
from scipy import optimize

from harness.analyze.linear import OpenedLoop, attenuation, modified, responses
from harness.analyze.multisine import OMEGA, ComplexArray, within
from harness.common.types import FloatArray

__all__ = [
    "BAND",
    "INTENT",
    "DelayBudget",
    "Margins",
    "band",
    "correction_of",
    "delay_budget",
    "left_of",
    "margins",
]

BAND = (8.0, 12.0)
"""Where tremor is (A04 1.1) [Hz]."""
INTENT = 2.0
"""Up to where motion is wanted [Hz]."""
LONGEST, EARLIEST = 0.1, -0.03
"""Further delays that are tried [s]."""
STEP = 1e-3
"""Between delays that are tried [s]: a hundredth of a period of tremor."""
TOLERANCE = 1e-7


@dataclass(frozen=True)
class DelayBudget:
    """Delay that the command bears.

    Attributes:
        wanted: what may be left, 0 to 1.
        left: what is left in the band as it is.
        left_worst: at the worst frequency of the band.
        spare: largest further delay with which no more than `wanted` is left in the band, at all
            smaller ones, too [s]; None: more is left as it is. Infinite: beyond what was tried.
        spare_everywhere: the same at each frequency of the band.
        best: further delay, negative for less, with which least is left in the band [s].
        best_left: what is left then.
        per_delay: change of what is left in the band by delay [1/s].
        per_gain: the same by the relative gain of the command.
        margin: delay at which a feedback loop becomes unstable [s]; infinite without feedback.
    """

    wanted: float
    left: float
    left_worst: float
    spare: float | None
    spare_everywhere: float | None
    best: float
    best_left: float
    per_delay: float
    per_gain: float
    margin: float


@dataclass(frozen=True)
class Margins:
    """Margins of a feedback loop: the worst of its characteristic loci, over the lines.

    Attributes:
        gain: factor by which the gain may rise; infinite where no line limits it.
        phase: by which the command may lag [rad]; infinite where the gain stays below 1.
        delay: by which it may be later [s]; infinite likewise.
        modulus: smallest singular value of 1 - L.
    """

    gain: float
    phase: float
    delay: float
    modulus: float


def band(values: FloatArray, low: float = BAND[0], high: float = BAND[1]) -> FloatArray:
    """Return values at the lines from `low` to `high` [Hz], (f, ...) to (lines, ...)."""
    return values[within(low, high)]


def left_of(response: ComplexArray) -> FloatArray:
    """Return what is left of a motion along any axis, (f,); A is (f, tip, axes)."""
    return np.asarray(np.linalg.norm(response, axis=(1, 2)) / math.sqrt(response.shape[2]))


def correction_of(response: ComplexArray) -> ComplexArray:
    """Return what is taken away of a motion, summed over the axes, (f,); A is (f, 3, 3)."""
    return np.asarray(np.trace(np.eye(3) - response, axis1=1, axis2=2))


def _in_band(loop: OpenedLoop) -> float:
    return float(np.sqrt(np.mean(band(left_of(attenuation(loop))) ** 2)))


def _worst(loop: OpenedLoop) -> float:
    return float(band(left_of(attenuation(loop))).max())


def delay_budget(loop: OpenedLoop, wanted: float) -> DelayBudget:
    """Compute the delay budget of a loop; see `DelayBudget`.

    Args:
        loop: measured.
        wanted: what may be left, 0 to 1.
    """
    margin = margins(loop).delay if loop.feedback else math.inf
    delays = np.arange(0.0, min(LONGEST, margin) + STEP / 2, STEP)
    tried = np.arange(EARLIEST, min(LONGEST, margin) + STEP / 2, STEP)
    at = [_in_band(modified(loop, delay)) for delay in tried]
    least = int(np.argmin(at))
    best = optimize.minimize_scalar(
        lambda delay: _in_band(modified(loop, delay)),
        bounds=(tried[max(least - 1, 0)], tried[min(least + 1, len(tried) - 1)]),
        method="bounded",
        options={"xatol": TOLERANCE},
    )
    small, share = 1e-4, 1e-2
    return DelayBudget(
        wanted=wanted,
        left=_in_band(loop),
        left_worst=_worst(loop),
        spare=_spare(_in_band, loop, wanted, delays),
        spare_everywhere=_spare(_worst, loop, wanted, delays),
        best=float(best.x),
        best_left=float(best.fun),
        per_delay=(_in_band(modified(loop, small)) - _in_band(modified(loop, -small)))
        / (2 * small),
        per_gain=(
            _in_band(modified(loop, gain=1 + share)) - _in_band(modified(loop, gain=1 - share))
        )
        / (2 * share),
        margin=margin,
    )


def _spare(
    left: Callable[[OpenedLoop], float], loop: OpenedLoop, wanted: float, delays: FloatArray
) -> float | None:
    """Return the first delay at which more than wanted is left."""
    before = 0.0
    for delay in delays:
        if left(modified(loop, delay)) > wanted:
            if delay == 0.0:
                return None
            return float(
                optimize.brentq(
                    lambda d: left(modified(loop, d)) - wanted, before, delay, xtol=TOLERANCE
                )
            )
        before = delay
    return math.inf


def margins(loop: OpenedLoop) -> Margins:
    """Return stability margins of the loop's characteristic loci; see `Margins`."""
    returned = responses(loop.returned)
    loci = _followed(np.linalg.eigvals(returned).astype(complex)).T
    gain = phase = delay = math.inf
    for locus in loci:
        # python-control closes the loop with a minus sign, 1 + G; ours is 1 - L.
        found = control.stability_margins(
            control.FrequencyResponseData(-locus, OMEGA, smooth=True), returnall=True
        )
        gains, phases, _, _, crossovers, _ = (np.atleast_1d(item) for item in found)
        gain = min([gain, *(g for g in gains if g > 1.0)])
        turns = np.radians(np.mod(phases, 360.0))
        phase = min([phase, *turns])
        delay = min([delay, *(turns / crossovers)])
    singular = np.linalg.svd(np.eye(returned.shape[1]) - returned, compute_uv=False)
    return Margins(float(gain), float(phase), float(delay), float(singular.min()))


def _followed(values: ComplexArray) -> ComplexArray:
    """Sort eigenvalues (f, n) so that each follows its own at the line before."""
    followed = values.copy()
    for k in range(1, len(values)):
        distance = np.abs(followed[k - 1][:, None] - values[k][None, :])
        _, order = optimize.linear_sum_assignment(distance)
        followed[k] = values[k][order]
    return followed
