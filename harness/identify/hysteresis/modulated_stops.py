"""Modulated stops of a piezo stack, from a recording of voltage and stroke.

The operator is linear in its weights once the thresholds are chosen, so that fitting it is a convex
quadratic program: least squares over the recording, with a small ridge, weights of stops not below
0, and the lower bound of the slope kept clear of 0, which keeps the inverse defined. Thresholds are
importance sampled, r_i = (V / 2) (i / n)^q, denser where a loop turns; their number n and the power
q are those that do best on blocks of the recording which the weights were not fitted to.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from scipy.signal import lfilter

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.piezo.modulated_stops import CREEP_TIMES, LAGS, SMALLEST_SLOPE, STOPS
from harness.identify.hysteresis.plays import check_arrays, first_known_sample

ORDERS = (4, 6, 8, 10, 12)
"""Numbers of stops tried."""
POWERS = (1.0, 1.6, 2.2)
"""Powers of the thresholds tried."""
BLOCK = 25
"""Samples that are fitted, or validated, in a row. Blocks are short, because few parts of a
recording move the wide plays."""
WORTH = 0.005
"""Relative gain in validation below which a larger order is not taken."""
RIDGE = 1e-3
"""Weight of a parameter of its usual size, relative to a residual of rms 1."""
MARGIN = 2.0
"""Least slope of an identified operator, in least slopes of a defined inverse."""
RESTING = 1e-3
"""Largest first voltage of a recording that begins at rest, in spans."""
TERMS = {"lead": slice(3, 4), "creep": slice(4, 4 + LAGS)}
"""Columns of the terms that may be left out of an operator."""
LARGEST_LAG = 0.1
"""Largest lag within a sample, as a share of the stroke's span over that of the voltage."""


@dataclass(frozen=True)
class Candidate:
    """An order that was tried.

    Attributes:
        order: number of stops.
        power: power of the thresholds.
        fitted: rms residual on the blocks fitted [m].
        validated: rms residual on the others [m].
    """

    order: int
    power: float
    fitted: float
    validated: float


@dataclass(frozen=True)
class StopsFit:
    """An identified stack.

    Attributes:
        parameters: values of the record `Stops`, by field.
        residual: rms of the used samples less the prediction [m].
        validation: rms residual on blocks that were not fitted [m].
        offset: reading of the recording at zero stroke [m].
        order: number of stops.
        power: power of the thresholds.
        candidates: all orders that were tried.
        first: first sample that was used.
        period: sample period [s].
    """

    parameters: dict[str, np.ndarray | float]
    residual: float
    validation: float
    offset: float
    order: int
    power: float
    candidates: tuple[Candidate, ...] = field(repr=False)
    first: int
    period: float

    def predict(self, volts: np.ndarray) -> np.ndarray:
        """Predict the stroke for a voltage, on the recording's zero, shape (N,) [m].

        Args:
            volts: voltage held over each sample of the recording's period, from rest or, where it
                begins under voltage, from having been there for long, (N,) [V].
        """
        p = self.parameters
        span, loading = float(p["span"]), np.asarray(p["polynomial"])
        columns = np.hstack(
            (
                _smooth(volts / span, self.period, np.asarray(p["creep_time"])),
                _stops(volts / span, _plays(volts / span, np.asarray(p["thresholds"]) / span)),
            )
        )
        steepness = float(p["lead"]) * loading[0] / self.period
        weights = (loading, [steepness], p["creep"], p["weights_low"], p["weights_high"])
        return columns @ np.concatenate(weights) + self.offset


def excitation(rate: float, top: float = design.STACK_VOLTS, seed: int = 1) -> np.ndarray:
    """Return the voltage to record with, from rest and back to it, shape (samples,) [V].

    One cycle over the whole range, which erases the memory of the stack; sines of nearly the
    whole range at nine frequencies from 1 to 22 Hz; a 10 Hz sine that shrinks to nothing, so
    that loops of every size are in it; and a sum of sines from 0.5 to 22 Hz that swells and fades.
    Nothing in it jumps: a step would ring, and the operator knows no resonance.

    Args:
        rate: samples in a second [Hz].
        top: largest voltage [V].
        seed: seed of the phases of the sum.
    """
    rng = np.random.default_rng(seed)
    half = top / 2

    def seconds(length: float) -> np.ndarray:
        return np.arange(round(length * rate)) / rate

    t = seconds(1.0)
    parts = [np.zeros(round(0.1 * rate)), half - half * np.cos(4 * np.pi * t)]
    t = seconds(2.0)
    for frequency in (1, 2, 4, 7, 10, 13, 16, 19, 22):
        parts.append(half - 0.96 * half * np.cos(2 * np.pi * frequency * t))
    t = seconds(10.0)
    parts.append(half - half * (1 - t / 10) * np.cos(20 * np.pi * t))
    t = seconds(20.0)
    mixed = np.zeros_like(t)
    for tone in np.arange(0.5, 22.1, 0.5):
        mixed += np.sin(2 * np.pi * (tone * t + rng.uniform())) / np.sqrt(max(tone, 1.0))
    mixed *= (0.3 + 0.7 * np.abs(np.sin(0.26 * np.pi * t))) / np.abs(mixed).max()
    mixed -= mixed[0] * np.exp(-t / 0.2)
    parts.append(half + 0.96 * half * mixed)
    return np.clip(np.concatenate(parts), 0.0, top)


def identify_stops(
    volts: np.ndarray,
    stroke: np.ndarray,
    period: float,
    creep_time: Sequence[float] | None = None,
    progress: Callable[[int, int], None] = lambda done, count: None,
    orders: Sequence[int] = ORDERS,
    without: Collection[str] = (),
) -> StopsFit:
    """Fit modulated stops to a recording.

    Samples count from the one at which the voltage has covered its whole range. The memory of the
    stack before is not known, and the first loading of a new stack follows no stop operator. For
    the same reason zero stroke is that of the fitted operator, not the beginning of the recording.

    Args:
        volts: v[k] is held during the sample at whose end stroke[k] is read, (N,) [V].
        stroke: displacement, from any zero, (N,) [m].
        period: time between two samples [s].
        creep_time: times of creep, (LAGS,) [s]; decades from 3 ms by default.
        progress: called with the number of candidates done and their count.
        orders: numbers of stops tried.
        without: names among `TERMS` that stay 0, to see their effect.

    Raises:
        SteadytipError: arrays that do not match, are not finite, hold too few reversals, or run
            against each other; a period that is not positive.
    """
    volts, stroke = check_arrays(volts, stroke)
    if not (np.isfinite(period) and period > 0):
        raise SteadytipError(f"period: {period} s must be above 0; it is the time of a sample")
    span = float(volts.max())
    if span <= 0:
        raise SteadytipError(f"voltage: its largest is {span} V; it must go above 0 V")
    times = np.asarray(CREEP_TIMES if creep_time is None else creep_time)
    a = volts / span
    smooth = _smooth(a, period, times)
    first = first_known_sample(volts)
    known = np.arange(len(a)) >= first
    odd = np.arange(len(a)) // BLOCK % 2 == 1
    turns = (known & odd, known & ~odd)

    found: list[Candidate] = []
    choices = [(order, power) for order in orders for power in POWERS]
    # All plays in one pass over the recording; each candidate has a part of them.
    ends = np.cumsum([0, *(order for order, _ in choices)])
    plays = _plays(a, np.concatenate([_thresholds(*choice) for choice in choices]))
    for done, (order, power) in enumerate(choices):
        progress(done, len(choices))
        columns = np.hstack((smooth, _stops(a, plays[:, ends[done] : ends[done + 1]])))
        squares = []
        for fitted, validated in (turns, turns[::-1]):
            weights, zero = _solve(
                columns[fitted], stroke[fitted], _thresholds(order, power), without
            )
            left = stroke - columns @ weights - zero
            squares.append([np.mean(left[rows] ** 2) for rows in (fitted, validated)])
        found.append(Candidate(order, power, *map(float, np.sqrt(np.mean(squares, axis=0)))))
    progress(len(choices), len(choices))

    best = _chosen(found)
    thresholds = _thresholds(best.order, best.power)
    columns = np.hstack((smooth, _stops(a, _plays(a, thresholds))))
    weights, zero = _solve(columns[known], stroke[known], thresholds, without)
    left = stroke[known] - columns[known] @ weights - zero
    return StopsFit(
        parameters=_parameters(weights, thresholds, span, times, period),
        residual=float(np.sqrt(np.mean(left**2))),
        validation=best.validated,
        offset=zero,
        order=best.order,
        power=best.power,
        candidates=tuple(found),
        first=first,
        period=period,
    )


def _thresholds(order: int, power: float) -> np.ndarray:
    """Return the half widths of the plays, in spans."""
    return 0.5 * (np.arange(1, order + 1) / order) ** power


def _smooth(a: np.ndarray, period: float, times: np.ndarray) -> np.ndarray:
    """Return the columns of p_1, p_2, p_3, the steepness and creep, shape (N, 4 + LAGS)."""
    start = a[0] if abs(a[0]) >= RESTING else 0.0
    before = np.concatenate(([start], a[:-1]))
    left = np.exp(-period / times)
    crept = [start + lfilter([1 - q], [1.0, -q], before - start) for q in left]
    return np.column_stack((a, a**2, a**3, a - before, *crept))


def _plays(a: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the outputs of plays, shape (N, thresholds)."""
    start = a[0] if abs(a[0]) >= RESTING else 0.0
    plays = np.empty((len(a), len(thresholds)))
    now = np.full(len(thresholds), start)
    for k, value in enumerate(a):
        now = np.maximum(value - thresholds, np.minimum(value + thresholds, now))
        plays[k] = now
    return plays


def _stops(a: np.ndarray, plays: np.ndarray) -> np.ndarray:
    """Return the columns of the stops' weights at the low and the high end, shape (N, 2 order)."""
    stops = a[:, None] - plays
    return np.hstack((-(1 - a[:, None]) * stops, -a[:, None] * stops))


def _solve(
    columns: np.ndarray, stroke: np.ndarray, thresholds: np.ndarray, without: Collection[str]
) -> tuple[np.ndarray, float]:
    """Return weights of the columns and the stroke at zero weights by a quadratic program [m].

    Beside the weights x it has a bound t_i of |g_i - f_i| for each stop, which the lower bound of
    the slope needs.
    """
    order = len(thresholds)
    scale = float(np.ptp(stroke))
    size = columns.shape[1]
    middle, mean = columns.mean(axis=0), stroke.mean()
    spread = np.maximum(columns.std(axis=0), 1e-9)
    centred = (columns - middle) / spread
    wanted = (stroke - mean) / scale
    count = size + order
    hessian = np.zeros((count, count))
    hessian[:size, :size] = centred.T @ centred / len(stroke)
    hessian += RIDGE**2 * np.eye(count)
    gradient = np.concatenate((-centred.T @ wanted / len(stroke), np.zeros(order)))

    # Rows of the constraints, on weights in units of the recording's span of stroke.
    low, high = slice(4 + LAGS, 4 + LAGS + order), slice(4 + LAGS + order, size)
    places = np.linspace(0.0, 1.0, 11)
    slopes = np.zeros((len(places), count))
    slopes[:, 0], slopes[:, 1], slopes[:, 2], slopes[:, 3] = 1, 2 * places, 3 * places**2, 1
    slopes[:, low], slopes[:, high] = -(1 - places[:, None]), -places[:, None]
    slopes[:, size:] = -thresholds
    steady = slopes.copy()
    steady[:, 3] += 2
    bounds = np.zeros((2, order, count))
    for sign, rows in zip((1.0, -1.0), bounds, strict=True):
        rows[:, size:] = np.eye(order)
        rows[:, low], rows[:, high] = sign * np.eye(order), -sign * np.eye(order)
    constraints = np.vstack((slopes, steady, *bounds))
    constraints[:, :size] /= spread
    least = MARGIN * SMALLEST_SLOPE * design.STACK_STROKE / scale
    floor = np.concatenate((np.full(2 * len(places), least), np.zeros(2 * order)))
    smallest = np.full(count, -np.inf)
    smallest[3] = -LARGEST_LAG * spread[3]
    smallest[4 + LAGS :] = 0.0
    largest = np.full(count, np.inf)
    for name in without:
        smallest[TERMS[name]] = largest[TERMS[name]] = 0.0

    sparsity = {"h": ca.DM(hessian).sparsity(), "a": ca.DM(constraints).sparsity()}
    program = ca.conic("weights", "daqp", sparsity)
    found = program(
        h=ca.DM(hessian),
        g=gradient,
        a=ca.DM(constraints),
        lba=floor,
        lbx=smallest,
        ubx=largest,
    )
    weights = scale * np.array(found["x"]).ravel()[:size] / spread
    weights[4 + LAGS :] = np.maximum(weights[4 + LAGS :], 0.0)
    return weights, float(mean - middle @ weights)


def _chosen(found: list[Candidate]) -> Candidate:
    """Return the smallest order that does nearly as well as the best one."""
    enough = (1 + WORTH) * min(one.validated for one in found)
    order = min(one.order for one in found if one.validated <= enough)
    return min((one for one in found if one.order == order), key=lambda one: one.validated)


def _parameters(
    weights: np.ndarray,
    thresholds: np.ndarray,
    span: float,
    times: np.ndarray,
    period: float,
) -> dict[str, np.ndarray | float]:
    """Return the fields of the record `Stops`; stops beyond the order have no weight."""
    spare = STOPS - len(thresholds)
    low, high = np.split(weights[4 + LAGS :], 2)
    return {
        "span": span,
        "polynomial": weights[:3],
        "thresholds": span * np.concatenate((thresholds, 0.5 + 0.05 * np.arange(1, spare + 1))),
        "weights_low": np.pad(low, (0, spare)),
        "weights_high": np.pad(high, (0, spare)),
        "creep": weights[4 : 4 + LAGS],
        "creep_time": times,
        "lead": float(weights[3] / weights[0] * period),
    }
