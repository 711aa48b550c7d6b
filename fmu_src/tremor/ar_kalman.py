"""Autoregressive predictor with Kalman adaptation: tremor from a motion forecast by strides.

    v_j    = s_{k-j} - s_{k-j-1}                     last moves, from one stride to the next
    e      = v_0 - a.v,  v = (v_1 .. v_ORDER)        what the coefficients do not explain
    g      = P v
    S      = v.g + NOISE (r + e^2 + LEAST_MOVE^2)
    a      = a + g e / S,    P = P - g g^T / S       observation of this sample
    a      = a_0 + l (a - a_0)                       Gauss-Markov, l = e^(-T_s / tau)
    P      = l^2 P + (1 - l^2) I
    r      = mean of e^2 over INNOVATION
    v_{+i} = a.(the ORDER moves before it), within REACH times the largest of the last ones
    y      = sum_j w_j s_{k+j}                       j = -AHEAD..AHEAD, past and forecast

After S. Tatinati, K. C. Veluvolu, S.-M. Hong, W. T. Latt and W. T. Ang, *Physiological Tremor
Estimation With Autoregressive (AR) Model and Kalman Filter for Robotics Applications* (2013), and
K. C. Veluvolu, S. Tatinati, S.-M. Hong and W. T. Ang, *Multistep Prediction of Physiological Tremor
for Surgical Robotics Applications* (2013): the coefficients are the state, what is observed is the
next sample, and prediction goes several strides ahead. No axis knows of the others. Every sample
is the end of a series of strides, so that an output stands at each; all series share coefficients.

The papers predict a tremor that a band-pass has separated from intent. A causal one is late, and
predicting farther makes up for it. So built, and tuned by random search over prefilter, stride,
order, noise, gain and distance, the best on hands gains 34 % a-posteriori, and that one predicts
nothing; those that do predict gain less. Here the prefilter is the difference over a stride, which
leaves all of the spectrum to learn from, and the band-pass comes last: a zero-phase one over past
and forecast (`zero_phase`), which undoes a wash-out and looks a horizon ahead in the same weights,
as in `var_forecaster`. That one solves for 42 coefficients of an axis anew ten times a second, on
the motion of all axes; this one corrects 10 with each sample.

The papers' coefficients walk at random. Here they also return to a_0 within tau, as those of
`bmflc_kf` fade: so P lies between (1 - l^2) I and I whatever comes in, and being kept as a lower
triangle it is symmetric. The noise follows the size of what is not explained, so that a hand five
times as restless is learnt as fast; and since e^2 of the very sample is in it, no sample moves the
coefficients by more than 1 / (2 sqrt(NOISE)): a reach out of rest does not throw them. A forecast
that would run away ends at REACH. While the position is not valid, nothing is learnt, and motion
goes on as it is forecast, fading and no faster than it was; afterwards positions count from there,
so that no step is seen.

Stride, ORDER, NOISE, INNOVATION, REACH and tau are tuned, by grid search on ten recordings of hand
motion, position known, for the mean of both reductions that the tests name and for the worst
recording. The optimum is broad: half and twice of NOISE, or three times tau, change the means by
0.3 points at most. A stride of 5 ms with 16 coefficients gains a point at twice the cost.

| symbol | field or constant | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| a | coefficients | of the last ORDER moves, newest first; for each axis |
| a_0 | KEEPS | the first of them without any motion seen; the others are 0 |
| P | covariance | of a, relative to what it is without any motion seen |
| r | unrest | mean square of e |
| tau | memory | within which coefficients return to a_0 |
| w | past, later | weights of the band-pass f_1 to f_2, of motion and as sums over moves ahead |
| f_w | wash_out | corner of the wash-out that the position has been through |
| h | horizon | how far ahead the tremor is wanted |
| T_s | T | sample period; a stride is STRIDE of them |
| y | tremor | tremor at the time t + h |
"""

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import phasors, zero_phase
from fmu_src.tremor.ports import HORIZON, CountedMotion, In, Out

SAMPLE_PERIOD = 1e-3
STRIDE = 8
"""Samples in a stride; tuned."""
ORDER = 10
"""Moves that the next one is regressed on; tuned."""
AHEAD = 30
"""Strides of the forecast, and of the past that the band-pass reaches into."""
NOISE = 100.0
"""Noise of an observation, over the mean square of e; tuned. Neighbours tell much the same."""
INNOVATION = 0.3
"""Over which e^2 is averaged [s]; tuned."""
REACH = 3.0
"""Largest move of a forecast, over the largest of the last ORDER; tuned."""
KEEPS = 0.95
"""a_0, a move as good as lasting; 0.8 does as well."""
FADING = 0.94
"""Share of a move that is left from stride to stride where the position cannot be trusted."""
LEAST_MOVE = 1e-9
"""Size of e below which nothing is learnt [m]."""
AXES = 3
HISTORY = STRIDE * AHEAD + 1
LOWER = ca.Sparsity.lower(ORDER)
"""Elements of P that are kept, by columns."""
PRIOR = np.eye(ORDER)[0] * KEEPS


class Params(zero_phase.Band):
    """Band, memory and horizon, and what has been done to the position before."""

    memory = real("s", "tau, within which coefficients return", start=300.0, min=1.0, max=1e4)
    wash_out: Any = zero_phase.WASH_OUT
    horizon: Any = HORIZON


class Weights(Derived):
    """The band-pass, and what a sample leaves of the coefficients."""

    past = real(None, "w of now and before, newest first", shape=AHEAD + 1)
    later = real(None, "sums of w from each stride ahead on", shape=AHEAD)
    left = real(None, "l, what a sample leaves of the coefficients")


class X(CountedMotion):
    """Memory of the motion, and the coefficients."""

    unrest = real("m2", "r, mean square of what is not explained", shape=AXES)
    motion = real("m", "s, newest first", shape=(AXES, HISTORY), listed=False)
    coefficients = real(
        None, "a", shape=(ORDER, AXES), start=np.tile(PRIOR, (AXES, 1)).T, listed=False
    )
    covariance = real(
        None,
        "lower triangle of P",
        shape=(LOWER.nnz(), AXES),
        start=np.tile(np.eye(ORDER)[np.triu_indices(ORDER)], (AXES, 1)).T,
        listed=False,
    )


def derive(p: Params, T: float) -> Weights:
    """Compute the band-pass for the horizon, and forgetting."""
    past, later = zero_phase.taps(
        p, p.horizon, partial(phasors.wash_out_undone, p.wash_out), STRIDE * T, AHEAD
    )
    return Weights(past=past, later=later, left=ca.exp(-T / p.memory))


def _corrector() -> ca.Function:
    """Record (moves, (ORDER + 1,), a, triangle of P, r, l) -> (a, triangle of P, r), of an axis."""
    sizes = (ORDER + 1, ORDER, 1, 1)
    moves, a, r, left = (ca.SX.sym(n, k) for n, k in zip("varl", sizes, strict=True))
    triangle = ca.SX.sym("triangle", LOWER.nnz())
    P = ca.tril2symm(ca.SX(LOWER, triangle))
    e = moves[0] - ca.dot(a, moves[1:])
    g = P @ moves[1:]
    S = ca.dot(moves[1:], g) + NOISE * (r + e**2 + LEAST_MOVE**2)
    observed = ca.tril(P - g @ g.T / S)
    kept = left**2 * observed + (1 - left**2) * ca.DM.eye(ORDER)
    a_next = PRIOR + left * (a + g * e / S - PRIOR)
    r_next = r + SAMPLE_PERIOD / INNOVATION * (e**2 - r)
    return ca.Function(
        "correct", [moves, a, triangle, r, left], [a_next, ca.project(kept, LOWER).nz[:], r_next]
    )


def _forecaster(strides: int, reach: float) -> ca.Function:
    """Record (moves, (ORDER,), a) -> moves to come, (strides,), for one axis.

    Args:
        strides: how many.
        reach: largest of them over the largest of those before.
    """
    moves, a = ca.SX.sym("moves", ORDER), ca.SX.sym("a", ORDER)
    largest = reach * ca.mmax(ca.fabs(moves))
    known = moves[::-1]
    for _ in range(strides):
        following = ca.dot(a, known[: -ORDER - 1 : -1])
        known = ca.vertcat(known, ca.fmin(ca.fmax(following, -largest), largest))
    return ca.Function(f"forecast_{strides}", [moves, a], [known[ORDER:]])


CORRECT = _corrector().map(AXES)
FORECAST = _forecaster(AHEAD, REACH).map(AXES)
NEXT = _forecaster(1, 1.0).map(AXES)


def moves(motion: Any, count: int) -> Any:
    """Return v, from stride to stride, newest first, (count, AXES) [m].

    Args:
        motion: newest first, (AXES, HISTORY) [m].
        count: how many.
    """
    strides = motion[:, : STRIDE * count + 1 : STRIDE]
    return (strides[:, :-1] - strides[:, 1:]).T


def moved(u: In, x: X) -> tuple[Any, Any]:
    """Return the motion with this sample, (AXES, HISTORY), and its origin, (AXES,) [m]."""
    a_stride_ago = x.motion[:, STRIDE - 1 :]
    onward = FADING * NEXT(moves(a_stride_ago, ORDER), x.coefficients).T
    now, origin = phasors.count(u.position, u.valid, a_stride_ago[:, 0] + onward, x)
    return ca.horzcat(now, x.motion[:, :-1]), origin


def found(derived: Weights, motion: Any, x: X) -> Out:
    """Compute the tremor in a motion, by the coefficients of the sample before.

    Args:
        derived: what follows from the parameters.
        motion: with the present sample, (AXES, HISTORY) [m].
        x: state.
    """
    forecast = FORECAST(moves(motion, ORDER), x.coefficients).T @ derived.later
    known = motion[:, ::STRIDE] @ derived.past + derived.later[0] * motion[:, 0]
    return Out(tremor=known + forecast)


def output_function(p: Params, u: In, x: X, T: float, derived: Weights) -> Out:
    """Return the outputs of a sample alone."""
    return found(derived, moved(u, x)[0], x)


def step(p: Params, u: In, x: X, T: float, derived: Weights) -> tuple[X, Out]:
    """Compute one sample."""
    motion, origin = moved(u, x)
    last = x.coefficients, x.covariance, x.unrest.T
    corrected = CORRECT(moves(motion, ORDER + 1), *last, derived.left)
    a, P, r = (ca.if_else(u.valid, new, old) for new, old in zip(corrected, last, strict=True))
    following = X(
        tracked=u.valid,
        origin=origin,
        unrest=r.T,
        motion=motion,
        coefficients=a,
        covariance=P,
    )
    return following, found(derived, motion, x)


MODEL = Model.of_step(
    "ArKalman", step, SAMPLE_PERIOD, derive=derive, matrix=True, answer=output_function
)
