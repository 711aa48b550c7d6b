"""Prandtl-Ishlinskii operators of a piezo stack, from a recording of it (A04 7.2.3, 7.3.2).

A constrained least squares fit of (7.9) to the measured response (7.10), for the modified operator,
the one with rate-dependent weights, and the one with creep. The constraints keep the inverse
defined: all slopes of the loading curve and of the saturation stay above a bound. An offset and a
drift of the displacement sensor are fitted too. s_0 is held at the nominal stroke per volt, since
scaling w against s changes nothing. For the two richer operators samples count from where the whole
range has been visited, since the first loading of a new stack is no play operator's; their zero is
then where they have it, not where the recording begins.

Given the saturation, y is linear in the unknowns, and each operator is a choice of columns:

    modified          H_i                                 weights w_i
    creeping          H_i, sum_j K_ij                     weights w_i, c_i
    rate-dependent    (1 - phi_i) G_i, phi_i G_i          slopes W_i at rest and at the rate rho_i

with G_i = H_i - H_{i+1}, so that y = sum W_i G_i, and phi_i = min(rho / rho_i, 1). A04 fits slopes
to saw-teeth of one rate each, then lines through them (7.17); fitting both ends of the lines at
once is the same for saw-teeth, and takes any other recording too. The rate is that of the stroke
of the modified operator for the voltage, which is fitted before and has no noise.

Only the recording is known of the stack. The modified operator is rate-independent: the lag of the
stack at the frequency of the recording counts as hysteresis, as in A04.

| symbol | meaning |
| --- | --- |
| v, z | recorded voltage [V] and stroke [m] |
| H, w, d, s | as in `fmu_src.piezo.prandtl_ishlinskii` |
| K, c | as in `fmu_src.piezo.creeping` |
| W, rho, rho_i | as in `fmu_src.piezo.rate_dependent` |
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.kit.runner import Runner
from fmu_src.piezo import creeping, prandtl_ishlinskii
from fmu_src.piezo.inverse_prandtl_ishlinskii import SMALLEST_SLOPE
from fmu_src.piezo.prandtl_ishlinskii import DEAD_ZONES, NOMINAL, PLAYS, Hysteresis, remember
from fmu_src.piezo.rate_dependent import RATE_LIMITS, REFERENCE_RATE

EXCITATION_FREQUENCY = 10.0
"""Saw-tooth of the recording [Hz], the middle of the tremor band (A04 7.4)."""
EXCITATION_SECONDS = 10.0
"""Length of the recording [s]: a hundred loops of falling size."""
SWEEP_TOP = 87.5
"""Largest voltage of the saw-teeth of a sweep, 12.5 um p-p (A04 7.3.2) [V]."""
SWEEP_FREQUENCIES = (*(k / 10 for k in range(1, 50)), *map(float, range(5, 41)))
"""Frequencies of the saw-teeth of a sweep [Hz] (A04 7.4)."""
SWEEP_CYCLES = 3
"""Saw-teeth of each frequency: the first one erases the memory of the frequency before."""
FEWEST_REVERSALS = 40
"""Fewest reversals of the voltage that separate the weights."""
SMALLEST_WEIGHT = 2 * SMALLEST_SLOPE
"""Bound of slopes of the loading curve, and of the saturation's in nominal strokes per volt; clear
of where the inverse ceases to be defined."""
_FAR = 1e4  # V, beyond any voltage
_WIPED = 0.02
"""Largest share of the voltage's range that may be missing if it counts as visited."""


@dataclass(frozen=True)
class HysteresisFit:
    """An identified stack.

    Attributes:
        parameters: values of the operator's record, by field.
        residual: rms of the recording less the prediction [m].
        offset: reading of the recording at zero stroke, in its middle [m].
        first: first sample that was used.
    """

    parameters: dict[str, Any]
    residual: float
    offset: float
    first: int


def excitation(rate: float, top: float = design.STACK_VOLTS) -> np.ndarray:
    """Return the voltage to record with, shape (samples,) [V].

    A saw-tooth about half the range whose amplitude falls evenly from half the range to nothing, so
    that loops of every size are in it.

    Args:
        rate: samples in a second [Hz].
        top: largest voltage [V].
    """
    t = np.arange(round(EXCITATION_SECONDS * rate)) / rate
    half = top / 2
    triangle = 1 - 4 * np.abs((EXCITATION_FREQUENCY * t) % 1 - 0.5)  # -1 at t = 0
    return half + half * (1 - t / EXCITATION_SECONDS) * triangle


def sweep(
    rate: float, frequencies: Sequence[float] = SWEEP_FREQUENCIES, top: float = SWEEP_TOP
) -> list[np.ndarray]:
    """Return saw-teeth of constant rate to record in turn, from 0 V and back (A04 7.3.2).

    Args:
        rate: samples in a second [Hz].
        frequencies: frequencies of the saw-teeth [Hz].
        top: largest voltage [V].

    Returns:
        Voltage for each frequency, (samples,) [V].
    """
    parts = []
    for frequency in frequencies:
        phase = frequency * np.arange(round(SWEEP_CYCLES / frequency * rate)) / rate
        parts.append(top * (1 - np.abs(1 - 2 * (phase % 1))))
    return parts


def identify_hysteresis(volts: np.ndarray, stroke: np.ndarray) -> HysteresisFit:
    """Fit the modified operator to a recording that begins at rest and without voltage.

    Args:
        volts: v[k] is applied during the sample interval at whose end stroke[k] is read, (N,) [V].
        stroke: displacement, from any zero, (N,) [m].

    Raises:
        SteadytipError: arrays that do not match, are not finite, hold too few reversals, or run
            against each other.
    """
    volts, stroke = check_arrays(volts, stroke)
    fit, weights = _fit(stroke, _plays(volts), _least_weights(), 0)
    return _with(fit, weights=weights)


def identify_creeping(volts: np.ndarray, stroke: np.ndarray, period: float) -> HysteresisFit:
    """Fit the operator with creep; arguments and errors are those of `identify_hysteresis`.

    Args:
        volts: voltage, (N,) [V].
        stroke: displacement, (N,) [m].
        period: time between two samples [s].
    """
    volts, stroke = check_arrays(volts, stroke)
    columns = np.hstack((_plays(volts), _crept(volts, period)))
    least = np.append(_least_weights(), np.zeros(creeping.WIDTHS))
    fit, weights = _fit(stroke, columns, least, first_known_sample(volts))
    fixed = creeping.Creeping.unpack(creeping.Creeping.starts())
    return _with(
        fit,
        weights=weights[:PLAYS],
        creep_weights=weights[PLAYS:],
        creep_thresholds=fixed.creep_thresholds,
        creep_time=fixed.creep_time,
    )


def identify_rate_dependence(volts: np.ndarray, stroke: np.ndarray, period: float) -> HysteresisFit:
    """Fit the rate-dependent operator; arguments and errors are those of `identify_hysteresis`.

    Args:
        volts: voltage, (N,) [V].
        stroke: displacement, (N,) [m].
        period: time between two samples [s].
    """
    volts, stroke = check_arrays(volts, stroke)
    rate = stroke_rate(identify_hysteresis(volts, stroke).parameters, volts, period)
    limits = np.array(RATE_LIMITS)
    share = np.minimum(rate[:, None] / limits, 1.0)
    gaps = _gaps(volts)
    # Of the weights at both ends: a weight is in the slope of its play and in those of all wider.
    columns = [np.cumsum((part * gaps)[:, ::-1], axis=1)[:, ::-1] for part in (1 - share, share)]
    least = np.tile(_least_weights(), 2)
    fit, weights = _fit(stroke, np.hstack(columns), least, first_known_sample(volts))
    resting, fast = (np.cumsum(part) for part in np.split(weights, 2))
    change = (fast - resting) / limits
    return _with(
        fit,
        weights=np.diff(resting + change * np.minimum(REFERENCE_RATE, limits), prepend=0.0),
        rate_slopes=change,
        rate_limits=limits,
        reference_rate=REFERENCE_RATE,
    )


def loading_slopes(
    volts: np.ndarray, stroke: np.ndarray, parameters: Mapping[str, Any]
) -> np.ndarray:
    """Return W of a recording of one rate with known saturation, (PLAYS,) (A04 7.3.2).

    The fit has no bounds, so that a slope can fall below zero.

    Args:
        volts: voltage, (N,) [V].
        stroke: displacement, from any zero, (N,) [m].
        parameters: parameters of a fit that gives the saturation.
    """
    saturation, dead_zones = parameters["saturation"], parameters["dead_zones"]
    corners = np.append(dead_zones, _FAR)
    values = np.append(0.0, np.cumsum(np.cumsum(saturation) * np.diff(corners)))
    stroke = stroke - np.mean(stroke - _plain_stroke(parameters, volts))
    # The first dead zone is open below.
    low = stroke / saturation[0]
    acting = np.where(stroke < 0, low, np.interp(stroke, values, corners))
    columns = np.column_stack((_gaps(volts), np.ones(len(volts))))
    known = slice(first_known_sample(volts), None)
    return np.linalg.lstsq(columns[known], acting[known], rcond=None)[0][:PLAYS]


def stroke_rate(parameters: Mapping[str, Any], volts: np.ndarray, period: float) -> np.ndarray:
    """Return the rate of the stroke for a voltage, with constant weights, (N,) [m/s].

    Args:
        parameters: values of a record that is a `Hysteresis`.
        volts: voltage, (N,) [V].
        period: time between two samples [s].
    """
    given = _plain_stroke(parameters, volts)
    return np.abs(np.diff(given, prepend=given[0])) / period


def _plain_stroke(parameters: Mapping[str, Any], volts: np.ndarray) -> np.ndarray:
    """Return the stroke of the modified operator within an operator's parameters, (N,) [m]."""
    plain = {name: parameters[name] for name in Hysteresis.fields}
    return Runner(prandtl_ishlinskii.MODEL, plain).run(len(volts), {"volts": volts})["stroke"]


def _with(fit: HysteresisFit, **values: Any) -> HysteresisFit:
    return replace(fit, parameters={**fit.parameters, **values})


def _least_weights() -> np.ndarray:
    return np.append(SMALLEST_WEIGHT, np.zeros(PLAYS - 1))


def _fit(
    stroke: np.ndarray, columns: np.ndarray, least: np.ndarray, first: int
) -> tuple[HysteresisFit, np.ndarray]:
    """Fit the weights of the columns of y and the saturation.

    Args:
        stroke: displacement, from any zero, (N,) [m].
        columns: terms of the weighted sum y, (N, n) [V].
        least: smallest weights, (n,).
        first: sample from which to count.

    Returns:
        The fit, with all parameters but the weights, and these, (n,).
    """
    fixed = Hysteresis.unpack(Hysteresis.starts())
    thresholds, dead_zones = fixed.thresholds, fixed.dead_zones
    columns, stroke = columns[first:], stroke[first:]
    time = np.linspace(-1.0, 1.0, len(stroke))
    free = DEAD_ZONES - 1  # slopes of the saturation that are not held
    count = columns.shape[1]

    # The saturation as a curve: the distance of y along each of its pieces, times their slopes.
    lengths = np.diff(dead_zones, append=np.inf)
    low = np.where(dead_zones > 0, 0.0, -np.inf)

    def pieces(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y = columns @ x[:count]
        return np.clip(y[:, None] - dead_zones, low, lengths), np.append(1.0, x[count:-2])

    def residual(x: np.ndarray) -> np.ndarray:
        along, slopes = pieces(x)
        return along @ slopes + x[-2] + x[-1] * time - stroke / NOMINAL

    def jacobian(x: np.ndarray) -> np.ndarray:
        along, slopes = pieces(x)
        present = slopes[np.sum(along[:, 1:] > 0, axis=1)]
        sensor = (np.ones(len(stroke)), time)
        return np.column_stack((present[:, None] * columns, along[:, 1:], *sensor))

    lower = np.concatenate((least, np.full(free, SMALLEST_WEIGHT), [-np.inf, -np.inf]))
    start = np.concatenate((least + 1 / PLAYS, np.ones(free), [0.0, 0.0]))
    found = least_squares(residual, start, jacobian, bounds=(lower, np.inf))
    _, slopes = pieces(found.x)
    fit = HysteresisFit(
        parameters={
            "thresholds": thresholds,
            "dead_zones": dead_zones,
            "saturation": NOMINAL * np.diff(slopes, prepend=0.0),
        },
        residual=NOMINAL * float(np.sqrt(np.mean(found.fun**2))),
        offset=NOMINAL * float(found.x[-2]),
        first=first,
    )
    return fit, found.x[:count]


def first_known_sample(volts: np.ndarray) -> int:
    """Return the first sample after the whole range was visited, which erases the memory."""
    margin = _WIPED * np.ptp(volts)
    top, bottom = volts >= volts.max() - margin, volts <= volts.min() + margin
    return int(max(np.argmax(top), np.argmax(bottom))) + 1


def check_arrays(volts: np.ndarray, stroke: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Check a recording before identification.

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
    """Return the outputs of all plays, shape (samples, PLAYS) [V]."""
    p = Hysteresis.unpack(Hysteresis.starts())
    before, sent = ca.SX.sym("before", PLAYS), ca.SX.sym("sent")
    run = ca.Function("run", [before, sent], [remember(p, sent, before)]).mapaccum(len(volts))
    return np.array(run(np.zeros(PLAYS), volts[None, :])).T


def _gaps(volts: np.ndarray) -> np.ndarray:
    """Return G_i = H_i - H_{i+1}, the columns of the slopes, shape (samples, PLAYS) [V]."""
    plays = _plays(volts)
    return plays - np.hstack((plays[:, 1:], np.zeros((len(plays), 1))))


def _crept(volts: np.ndarray, period: float) -> np.ndarray:
    """Return the creep of each width, summed over its times, shape (samples, WIDTHS) [V]."""
    p = creeping.Creeping.unpack(creeping.Creeping.starts())
    x = creeping.Memory.unpack(ca.SX.sym("x", creeping.Memory.size()))
    sent = ca.SX.sym("sent")
    crept, _ = creeping.creep(p, creeping.derive(p, period), x)
    following = creeping.remembered(p, crept, sent, x).pack()
    run = ca.Function("run", [x.pack(), sent], [following, ca.sum2(crept)]).mapaccum(len(volts))
    return np.array(run(np.zeros(creeping.Memory.size()), volts[None, :])[1]).T
