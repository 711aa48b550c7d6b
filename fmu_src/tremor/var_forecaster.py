"""Vector-autoregressive forecaster: tremor as a known functional of past and future motion.

    v_k   = s_k - s_{k-1}                            motion from one stride to the next
    R_j   = sum_k g^(n-k) v_k v_{k-j}^T              correlation, what is older than tau forgotten
    A     : v_k = sum A_j v_{k-j} + e_k              least squares with the weights g^(n-k)
    s_k+h = s_k + sum v_{k+1..k+h}                   forecast, v from A, h = 1..AHEAD
    y     = sum_j w_j s_{k+j}                        j = -AHEAD..AHEAD, past and forecast

What is called tremor here is the motion behind a zero-phase Butterworth band-pass of second order,
f_1 to f_2, whose weights w are those of `zero_phase`: half of its window lies in the future. By the
law of total expectation the best causal estimate of it is that band-pass over the best forecast, so
that all there is to learn is the spectrum of the motion. A delay of the loop is a shift of w. A
slow motion hardly passes and a constant not at all, and a third-order Butterworth wash-out of
corner f_w, which the position has been through, is undone, all in the same weights.

Regressors are OWN strides of the same axis and CROSS of each other one. The matrix of the least
squares holds sums over products of any two lags, and follows from R and the last velocities: what
stands farther down a diagonal is the same sum some strides ago. A Toeplitz matrix of R alone is
nearly the same, but errs by lag over memory, with a slow intent by more than the tremor is large.
The prior stands for a while of motion that keeps its velocity with a corner of 1 Hz, as large as
the second differences are. Since y is linear in the last velocities, the forecast is folded into
one row for each axis whenever A is new, by running the recursion backwards once; a sample costs
little. A new A takes four samples, so that none takes long: three solutions and the fold.

The memory was chosen on ten recordings of hands, one value for all; nothing is trained on any. A
memory of 7 to 15 s changes the reductions there by a tenth of a point.

Coefficients that have seen little can be unstable, and their forecast anything. A tremor of f_1 or
faster that is as large as y has second differences of (2 sin(pi f_1 T))^2 y: y is limited to
LARGEST times what the largest of them, forgotten within a second, leaves room for.

It needs a second and a half of motion: until then the output fades in. Positions count from the
first one that can be trusted; while they cannot be, the motion goes on as it is forecast, fading.

| symbol | field | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| T, T_s | | stride, sample period |
| h T_s | horizon | how far ahead the tremor is wanted |
| tau | memory | time after which motion is forgotten |
| f_1, f_2 | lowest, highest | band of tremor |
| f_w | wash_out | corner of the wash-out that the position has been through |
| s | motion | (AHEAD + 1, 12): of the sample j strides and q samples ago, axis a, [j, 3 q + a] |
| R | correlation | of velocities, (OWN + 1, 9): of v_a now with v_b j strides ago, [j, 3 b + a] |
| A | coefficients | of each axis: OWN, then CROSS of the next axis and of the one after |
| | fold | (OWN, 9): share of v_b, j strides ago, in the forecast of axis a, [j, 3 a + b] |
| u | swing | largest second difference lately |
| y | tremor | tremor at the time t + horizon |
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit.functions import by_elements
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import phasors, zero_phase
from fmu_src.math.pairwise import pairwise_sum
from fmu_src.tremor import blocks
from fmu_src.tremor.ports import HORIZON, CountedMotion, In, Out

SAMPLE_PERIOD = 1e-3
STRIDE = 4
"""Samples in a stride: 250 Hz is enough for tremor."""
OWN, CROSS = 30, 6
"""Strides that the next velocity is regressed on."""
AHEAD = 60
"""Strides of the forecast, and of the past that the band-pass reaches into."""
EVERY = 100
"""Samples after which the coefficients are computed again."""
PRIOR = 0.02
"""Length of motion that the prior stands for [s]."""
PRIOR_CORNER = 1.0
"""Corner of the prior's velocity [Hz]."""
LEARNING = 1.5
"""Time in which the output fades in [s]."""
FADING = 0.97
"""Share of a velocity that is left from stride to stride where the position cannot be trusted."""
SWING_MEMORY = 1.0
"""Time in which the largest second difference is forgotten [s]."""
LARGEST = 1.5
"""Largest output, over the largest tremor that the second differences leave room for."""
LEAST_MOVE = 1e-9
"""Second difference below which nothing moves [m]."""
SIZE = OWN + 2 * CROSS
AXES = 3
LANES = 4
"""Sums that an inner product is summed up in at once, so that none waits for all terms before."""
BLOCK = 7
"""Size of a block of the least squares' equations, solved block by block: it divides SIZE."""


class Learning(zero_phase.Band):
    """Band and memory."""

    memory = real("s", "tau, time after which motion is forgotten", start=8.0, min=1.0, max=1e3)


class Params(Learning):
    """Band and memory, horizon, and wash-out of the position that comes in."""

    horizon: Any = HORIZON
    wash_out: Any = zero_phase.WASH_OUT


class X(CountedMotion):
    """Memory of the motion, and what has been learnt of it."""

    seen = real("s", "time that has been learnt from, up to the time of learning")
    count = real(None, "samples since the coefficients were computed", min=0.0, max=EVERY)
    unrest = real("m2", "mean square of second differences", shape=3)
    swing = real("m", "u, largest of them lately", shape=3)
    motion = real("m", "s", shape=(AHEAD + 1, STRIDE * AXES), listed=False)
    correlation = real("m2", "R", shape=(OWN + 1, AXES**2), listed=False)
    coefficients = real(None, "A", shape=(SIZE, AXES), listed=False)
    fold = real(None, "forecast, by velocities", shape=(OWN, AXES**2), listed=False)


class Weights(Derived):
    """The band-pass, and what forgets."""

    past = real(None, "w of now and before, newest first", shape=AHEAD + 1)
    later = real(None, "sums of w from each stride ahead on", shape=AHEAD)
    left = real(None, "g, what is left of a correlation after a sample")
    reach = real(None, "output over swing, at most")


def derive(p: Params, T: float) -> Weights:
    """Compute the band-pass for the horizon, and forgetting."""
    return weights(p, p.horizon, partial(phasors.wash_out_undone, p.wash_out), T)


def weights(p: Learning, horizon: Any, undo: Callable[[Any], phasors.Pair], T: float) -> Weights:
    """Compute the band-pass for a horizon, with what the motion has been through, and forgetting.

    Args:
        p: band and memory.
        horizon: h T_s [s].
        undo: factor that undoes that at frequencies, (n,) [Hz].
        T: sample period [s].
    """
    past, later = zero_phase.taps(p, horizon, undo, STRIDE * T, AHEAD)
    turning = 2 * ca.sin(np.pi * p.lowest * STRIDE * T)
    largest = ca.sqrt(sum(part**2 for part in undo(p.lowest)))
    return Weights(
        past=past,
        later=later,
        left=ca.exp(-T / p.memory),
        reach=LARGEST * largest / turning**2,
    )


def inner(one: Any, other: Any) -> Any:
    """Return the inner product of two columns."""
    products = one * other
    return pairwise_sum(ca.vertcat(*(ca.sum1(products[lane::LANES]) for lane in range(LANES))))


def others(axis: int) -> list[int]:
    """Return the next axis, and the one after."""
    return [(axis + turn) % AXES for turn in range(1, AXES)]


def following_velocity(coefficients: Any, velocity: Any) -> Any:
    """Predict the velocity v of the next stride, (AXES,) [m].

    Args:
        coefficients: A, (SIZE, AXES).
        velocity: v, newest first, (OWN, AXES) [m].
    """
    following = []
    for axis in range(AXES):
        crossed = [velocity[:CROSS, other] for other in others(axis)]
        regressors = ca.vertcat(velocity[:, axis], *crossed)
        following.append(inner(coefficients[:, axis], regressors))
    return ca.vertcat(*following)


def _regression() -> ca.Function:
    """Record (correlation, moves, prior, left, left^-STRIDE, scale) -> blocks.

    For the first axis: of R, its rows of blocks up to the diagonal, then of r. The correlation is
    the first block row of the sums C over products of any two lags. Its other entries are the same
    sums a stride earlier, C_{i+1,j+1} = (C_ij - D_ij) / g^STRIDE, D the products that came in
    since: so that they are as exact as if each had been summed up by itself. Moves are velocities
    at every sample, in the order of the motion.
    """
    correlation = ca.SX.sym("correlation", OWN + 1, AXES**2)
    moves = ca.SX.sym("moves", OWN + 1, STRIDE * AXES)
    prior, left, back, scale = (ca.SX.sym(n) for n in ("prior", "left", "back", "scale"))
    # Product q of the last stride was made of the velocities of sample q.
    shares = [left ** (q / 2) for q in range(STRIDE)]

    @cache
    def weighted(lag: int, axis: int) -> list[Any]:
        return [shares[q] * moves[lag, AXES * q + axis] for q in range(STRIDE)]

    @cache
    def summed(i: int, a: int, j: int, b: int) -> Any:
        """Return C of axis a at lag i and axis b at lag j."""
        if i > j:
            return summed(j, b, i, a)
        if i == 0:
            return correlation[j, AXES * b + a]
        pairs = zip(weighted(i - 1, a), weighted(j - 1, b), strict=True)
        came_in = sum(one * other for one, other in pairs)
        return (summed(i - 1, a, j - 1, b) - came_in) * back

    places = [(lag, 0) for lag in range(1, OWN + 1)]
    places += [(lag, axis) for axis in (1, 2) for lag in range(1, CROSS + 1)]
    keeps = float(np.exp(-2 * np.pi * PRIOR_CORNER * STRIDE * SAMPLE_PERIOD))
    R = ca.SX(ca.Sparsity.lower(SIZE), 0)
    for row, one in enumerate(places):
        for column, other in enumerate(places[: row + 1]):
            R[row, column] = (summed(*one, *other) + (prior if row == column else 0)) * scale
    r = ca.horzcat(*(summed(0, 0, *place) for place in places))
    r[0] += prior * keeps
    starts = range(0, SIZE, BLOCK)
    pieces = [R[i : i + BLOCK, j : j + BLOCK] for i in starts for j in starts if j <= i]
    pieces += [r[i : i + BLOCK] * scale for i in starts]
    return ca.Function("regression", [correlation, moves, prior, left, back, scale], pieces)


def _solver() -> ca.Function:
    """Record (correlation, moves, prior, left) -> A, (SIZE,), of one axis; see `_regression`."""
    correlation = ca.MX.sym("correlation", OWN + 1, AXES**2)
    moves = ca.MX.sym("moves", OWN + 1, STRIDE * AXES)
    prior, left = ca.MX.sym("prior"), ca.MX.sym("left")
    # Scaled, so that single precision has no very small numbers to work with.
    scale = 1 / (correlation[0, 0] + prior)
    found = list(_regression()(correlation, moves, prior, left, 1 / left**STRIDE, scale))
    rows = [[found.pop(0) for _ in range(row + 1)] for row in range(SIZE // BLOCK)]
    solution = ca.vertcat(*blocks.solve(rows, found))
    return ca.Function("solve_axis", [correlation, moves, prior, left], [solution])


def _folder() -> ca.Function:
    """Record (coefficients, (SIZE, AXES), sums of weights, (AHEAD,)) -> fold, (OWN, AXES^2).

    y holds sum_h later_h v_{k+h}, and v_{k+h} is the first block of F^h applied to the last
    velocities, F the companion matrix of A. So the fold is sum_h later_h E F^h, by Horner's rule
    from the farthest h on; a product with F is a shift and the first block times A.
    """
    fold, g = ca.SX.sym("fold", OWN, AXES**2), ca.SX.sym("g")
    A = ca.SX.sym("A", SIZE, AXES)
    columns = []
    for axis in range(AXES):
        first = fold[0, AXES * axis : AXES * (axis + 1)]
        first[axis] += g
        for b in range(AXES):
            column = ca.vertcat(fold[1:, AXES * axis + b], 0) + first[b] * A[:OWN, b]
            for a in others(b):
                at = OWN + CROSS * others(a).index(b)
                column[:CROSS] += first[a] * A[at : at + CROSS, a]
            columns.append(column)
    horner = ca.Function("horner", [fold, A, g], [ca.horzcat(*columns)], {"cse": True})
    coefficients = ca.MX.sym("coefficients", SIZE, AXES)
    later = ca.MX.sym("later", AHEAD)
    folded: Any = ca.MX(ca.DM.zeros(*fold.shape))
    for h in reversed(range(AHEAD)):
        folded = horner(folded, coefficients, later[h])
    return ca.Function("fold_forecast", [coefficients, later], [folded])


SOLVE_AXIS, FOLD_FORECAST = _solver(), _folder()


@cache
def learning(T: float) -> ca.Function:
    """Record (count, band, state) -> (coefficients, fold): one part of a round of learning.

    Args:
        T: sample period [s].
    """
    band, state = ca.MX.sym("band", Weights.size()), ca.MX.sym("x", X.size())
    derived, x = Weights.unpack(band), X.unpack(state)
    correlation: Any = x.correlation
    moves: Any = x.motion[: OWN + 1, :] - x.motion[1 : OWN + 2, :]
    parts = []
    for axis in range(AXES):
        # With the axis whose turn it is in front: the solution knows the first axis only.
        order = (axis + np.arange(AXES)) % AXES
        pairs = (AXES * order[:, None] + order).flatten().tolist()
        samples = (AXES * np.arange(STRIDE)[:, None] + order).flatten().tolist()
        prior = AXES * PRIOR / T * (x.unrest[axis] + LEAST_MOVE**2)
        columns = [x.coefficients[:, other] for other in range(AXES)]
        columns[axis] = SOLVE_AXIS(correlation[:, pairs], moves[:, samples], prior, derived.left)
        parts.append((f"learn_{axis}", ca.horzcat(*columns), x.fold))
    parts.append(("learn_fold", x.coefficients, FOLD_FORECAST(x.coefficients, derived.later)))
    functions = [ca.Function(name, [band, state], results) for name, *results in parts]
    known = ca.Function("known", [band, state], [x.coefficients, x.fold])
    return ca.Function.conditional("learning", functions, known)


def moved(position: Any, valid: Any, x: X) -> tuple[Any, Any]:
    """Return the origin of the motion, (3,) [m], and the motion now and whole strides before.

    Args:
        position: s, (3,) [m].
        valid: whether it can be trusted.
        x: state.

    Returns:
        Origin, and motion, newest first, (AHEAD + 1, AXES) [m].
    """
    # Where the motion goes on by itself, a little less each stride.
    there = x.motion[:, -AXES:]
    moves = there[:OWN, :] - there[1 : OWN + 1, :]
    expected = there[0, :].T + FADING * following_velocity(x.coefficients, moves)
    origin = ca.if_else(x.tracked, x.origin, position - expected)
    now = ca.if_else(valid, position - origin, expected)
    return origin, ca.vertcat(now.T, there[:-1, :])


def velocities(motion: Any) -> Any:
    """Return v, from stride to stride, newest first, (OWN + 1, AXES) [m]."""
    return motion[: OWN + 1, :] - motion[1 : OWN + 2, :]


def swing(velocity: Any, x: X, T: float) -> Any:
    """Return u, the largest second difference lately, (3,) [m].

    Args:
        velocity: v, newest first, (OWN + 1, AXES) [m].
        x: state.
        T: sample period [s].
    """
    turn = velocity[0, :] - velocity[1, :]
    return ca.fmax(ca.fabs(turn.T), np.exp(-T / SWING_MEMORY) * x.swing)


def found(derived: Weights, motion: Any, swung: Any, seen: Any, x: X) -> Any:
    """Return y, the tremor in a motion, (3,) [m].

    Args:
        derived: what follows from the parameters.
        motion: as from `moved`, (AHEAD + 1, AXES) [m].
        swung: u, (3,) [m].
        seen: time that has been learnt from [s].
        x: state.
    """
    velocity = velocities(motion)[:OWN, :]
    tremor = []
    for axis in range(AXES):
        known = inner(derived.past, motion[:, axis])
        shares = [
            inner(x.fold[:, AXES * axis + other], velocity[:, other]) for other in range(AXES)
        ]
        ahead = derived.later[0] * motion[0, axis] + sum(shares)
        tremor.append(known + ahead)
    limit = derived.reach * swung
    return seen / LEARNING * ca.fmax(-limit, ca.fmin(limit, ca.vertcat(*tremor)))


def estimate_outputs(derived: Weights, position: Any, valid: Any, x: X, T: float) -> Out:
    """Return the outputs of `estimate` alone."""
    _, motion = moved(position, valid, x)
    swung = swing(velocities(motion), x, T)
    return Out(tremor=found(derived, motion, swung, ca.fmin(x.seen + valid * T, LEARNING), x))


def estimate(derived: Weights, position: Any, valid: Any, x: X, T: float) -> tuple[X, Out]:
    """Compute one sample of the filter, as a part of a larger model.

    Args:
        derived: what follows from the parameters.
        position: s, (3,) [m].
        valid: 1 to learn from this sample, 0 not to.
        x: state.
        T: sample period [s].
    """
    perceived = perceiving(T)(derived.pack(), position, valid, x.pack())
    origin, motion, correlation, unrest, swung, seen, tremor = perceived
    coefficients, fold = learning(T)(x.count, derived.pack(), x.pack())
    following = X(
        tracked=valid,
        origin=origin,
        seen=seen,
        count=ca.if_else(x.count + 1 >= EVERY, 0, x.count + 1),
        unrest=unrest,
        swing=swung,
        motion=ca.horzcat(motion, x.motion[:, :-AXES]),
        correlation=correlation,
        coefficients=coefficients,
        fold=fold,
    )
    return following, Out(tremor=tremor)


def perceive(derived: Weights, position: Any, valid: Any, x: X, T: float) -> tuple[Any, ...]:
    """Return what a sample tells.

    That is origin, motion by strides, correlation, unrest, swing, time learnt from, and tremor.

    Args:
        derived: what follows from the parameters.
        position: s, (3,) [m].
        valid: 1 to learn from this sample, 0 not to.
        x: state.
        T: sample period [s].
    """
    origin, motion = moved(position, valid, x)
    velocity = velocities(motion)
    newest = velocity[0, :].T
    products = [newest[a] * velocity[:, b] for b in range(AXES) for a in range(AXES)]
    turn = newest - velocity[1, :].T
    swung = swing(velocity, x, T)
    seen = ca.fmin(x.seen + valid * T, LEARNING)
    return (
        origin,
        motion,
        derived.left * x.correlation + ca.horzcat(*products),
        derived.left * x.unrest + (1 - derived.left) * turn**2,
        swung,
        seen,
        found(derived, motion, swung, seen, x),
    )


@cache
def perceiving(T: float) -> ca.Function:
    """Record (band, position, valid, state) -> `perceive`, by elements."""
    return by_elements("perceive", partial(perceive, T=T), Weights, AXES, 1, X)


def step(p: Params, u: In, x: X, T: float, derived: Weights) -> tuple[X, Out]:
    """Compute one sample."""
    return estimate(derived, u.position, u.valid, x, T)


def output_function(p: Params, u: In, x: X, T: float, derived: Weights) -> Out:
    """Return the outputs of a sample alone."""
    return estimate_outputs(derived, u.position, u.valid, x, T)


MODEL = Model.of_step(
    "VarForecaster", step, SAMPLE_PERIOD, derive=derive, matrix=True, answer=output_function
)
