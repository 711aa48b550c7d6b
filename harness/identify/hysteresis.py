"""Modified Prandtl-Ishlinskii operator of a piezo stack, from a recording of it (A04 7.2.3).

A constrained least squares fit of (7.9) to the measured response (7.10). What is constrained keeps
the inverse defined: w_0 and all slopes of the saturation curve stay above a bound, and w_i >= 0 for
i > 0. An offset and a drift of the displacement sensor are fitted too and left out. s_0 is held at
the nominal stroke per volt, since scaling w against s changes nothing.

The recording is all that is known of the stack. The operator is rate-independent: what the stack
lags, at the frequency of the recording, is explained as hysteresis, as in A04.

| symbol | meaning |
| --- | --- |
| v, z | recorded voltage [V] and stroke [m] |
| H, w, d, s | as in `fmu_src.piezo.prandtl_ishlinskii` |
| Z_j | slopes of the saturation curve, in nominal strokes per volt |
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from fmu_src.kit import SteadytipError, design
from fmu_src.piezo.inverse_prandtl_ishlinskii import SMALLEST_SLOPE
from fmu_src.piezo.prandtl_ishlinskii import DEAD_ZONES, NOMINAL, PLAYS, Hysteresis, remember

EXCITATION_FREQUENCY = 10.0
"""Saw-tooth of the recording [Hz], the middle of the tremor band (A04 7.4)."""
EXCITATION_SECONDS = 10.0
"""Length of the recording [s]: a hundred loops of falling size."""
FEWEST_REVERSALS = 40
"""Reversals of the voltage that a recording needs for its weights to be told apart."""
SMALLEST_WEIGHT = 2 * SMALLEST_SLOPE
"""Bound of w_0, and of the saturation's slopes in nominal strokes per volt; clear of where the
inverse ceases to be defined."""


@dataclass(frozen=True)
class HysteresisFit:
    """An identified stack.

    Attributes:
        parameters: values of the record `Hysteresis`, by field.
        residual: rms of what the model leaves of the recording [m].
    """

    parameters: dict[str, np.ndarray]
    residual: float


def excitation(rate: float) -> np.ndarray:
    """Voltage to record with, shape (samples,) [V].

    A saw-tooth about half the range whose amplitude falls evenly from half the range to nothing, so
    that loops of every size are in it (A04 7.3.2 records saw-teeth too).

    Args:
        rate: samples in a second [Hz].
    """
    t = np.arange(round(EXCITATION_SECONDS * rate)) / rate
    half = design.STACK_VOLTS / 2
    triangle = 1 - 4 * np.abs((EXCITATION_FREQUENCY * t) % 1 - 0.5)  # -1 at t = 0
    return half + half * (1 - t / EXCITATION_SECONDS) * triangle


def identify_hysteresis(volts: np.ndarray, stroke: np.ndarray) -> HysteresisFit:
    """Fit the operator to a recording that begins with a stack at rest and without voltage.

    Args:
        volts: v[k] is applied during the sample interval at whose end stroke[k] is read, (N,) [V].
        stroke: displacement, from any zero, (N,) [m].

    Raises:
        SteadytipError: arrays that do not match, are not finite, hold too few reversals, or run
            against each other.
    """
    volts, stroke = checked(volts, stroke)
    fixed = Hysteresis.unpack(Hysteresis.starts())
    thresholds, dead_zones = fixed.thresholds, fixed.dead_zones
    plays = _plays(volts)
    time = np.linspace(-1.0, 1.0, len(volts))
    free = DEAD_ZONES - 1  # slopes of the saturation that are not held

    # The saturation as a curve: how far y has come along each of its pieces, times their slopes.
    lengths = np.diff(dead_zones, append=np.inf)
    least = np.where(dead_zones > 0, 0.0, -np.inf)

    def pieces(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y = plays @ x[:PLAYS]
        return np.clip(y[:, None] - dead_zones, least, lengths), np.append(1.0, x[PLAYS:-2])

    def residual(x: np.ndarray) -> np.ndarray:
        along, slopes = pieces(x)
        return along @ slopes + x[-2] + x[-1] * time - stroke / NOMINAL

    def jacobian(x: np.ndarray) -> np.ndarray:
        along, slopes = pieces(x)
        present = slopes[np.sum(along[:, 1:] > 0, axis=1)]
        return np.column_stack((present[:, None] * plays, along[:, 1:], np.ones(len(stroke)), time))

    lower = np.concatenate(
        ([SMALLEST_WEIGHT], np.zeros(PLAYS - 1), np.full(free, SMALLEST_WEIGHT), [-np.inf, -np.inf])
    )
    start = np.concatenate((np.full(PLAYS, 1 / PLAYS), np.ones(free), [0.0, 0.0]))
    found = least_squares(residual, start, jacobian, bounds=(lower, np.inf))
    _, slopes = pieces(found.x)
    return HysteresisFit(
        parameters={
            "thresholds": thresholds,
            "weights": found.x[:PLAYS],
            "dead_zones": dead_zones,
            "saturation": NOMINAL * np.diff(slopes, prepend=0.0),
        },
        residual=NOMINAL * float(np.sqrt(np.mean(found.fun**2))),
    )


def checked(volts: np.ndarray, stroke: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A recording that something can be identified from.

    Args:
        volts: voltage, (N,) [V].
        stroke: displacement, (N,) [m].

    Raises:
        SteadytipError: arrays that do not match, are not finite, hold too few reversals, or run
            against each other.
    """
    volts, stroke = np.asarray(volts, dtype=float), np.asarray(stroke, dtype=float)
    if volts.ndim != 1 or volts.shape != stroke.shape:
        raise SteadytipError(
            f"voltage and stroke must be columns of one length; got {volts.shape}, {stroke.shape}"
        )
    for name, column in (("voltage", volts), ("stroke", stroke)):
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise SteadytipError(
                f"{name}, sample {wrong[0]}: {column[wrong[0]]} must be finite; cut it out, or"
                " record again"
            )
    moves = np.diff(volts)
    moves = moves[moves != 0]
    reversals = int(np.sum(moves[1:] * moves[:-1] < 0))
    if reversals < FEWEST_REVERSALS:
        raise SteadytipError(
            f"the voltage turns {reversals} times and must {FEWEST_REVERSALS} times at least;"
            " record loops of every size, as `excitation` makes them"
        )
    if np.corrcoef(volts, stroke)[0, 1] <= 0:
        raise SteadytipError(
            "the stroke falls while the voltage rises; change the sign of one of them"
        )
    return volts, stroke


def _plays(volts: np.ndarray) -> np.ndarray:
    """Outputs of all plays, shape (samples, PLAYS) [V]."""
    p = Hysteresis.unpack(Hysteresis.starts())
    before, sent = ca.SX.sym("before", PLAYS), ca.SX.sym("sent")
    run = ca.Function("run", [before, sent], [remember(p, sent, before)]).mapaccum(len(volts))
    return np.array(run(np.zeros(PLAYS), volts[None, :])).T
