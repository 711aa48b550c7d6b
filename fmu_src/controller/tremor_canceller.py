"""Tremor canceller: estimated tip motion in, piezo voltages out (A04 8.2.2).

    tremor    y_W = WflcFlc(tip displacement), a horizon ahead              A04 5.2.1
    demand    d_0 = rise d_rest - engagement R(q_WB)^T y_W                  frame 0 parallel to B
    strokes   lambda = inverse kinematics(d_0), within the stacks' range    A04 6.3
    voltages  v_i = inverse hysteresis_i(lambda_i), within the amplifier's  A04 7.2.4

Stacks push only, so the tip rests where all strokes are half their range, and has as far to go
either way. `rise` brings it there from no voltage, within `rise_time` from the first sample.
`engagement` fades the correction in within `fade_time` once the stacks have risen and the motion is
valid; when it is not, it fades the correction, which the tone model carries on meanwhile, out to
rest. Both follow s(p) = 3 p^2 - 2 p^3 of a progress p that runs from 0 to 1, so that nothing jumps.

Limits: each stroke is limited by itself, then each voltage by itself; `saturated` tells of either.
The memory of the hysteresis follows the voltage really sent.

The horizon makes up for what lies between a tip and the correction of it: the command computed
from one sample is held until the next one, where its effect is seen, and the stack lags. The
filter's wash-out is that of the estimator whose displacement comes in; 0 for a true position.

| symbol | field | meaning |
| --- | --- | --- |
| y_W | tremor | tremor of the tip in the world, at the time when the voltages act |
| q_WB | attitude | rotates body vectors into the world |
| d_rest | rest | tip at half stroke less tip at zero stroke |
| rise, engagement | rise, engagement | progress p of each, 0 to 1 |
| lambda_i, v_i | volts | stroke and voltage of stack i |
"""

from typing import Any

import casadi as ca

from fmu_src.estimation import micron
from fmu_src.kit import (
    Derived,
    Inputs,
    Model,
    Outputs,
    Parameters,
    State,
    boolean,
    real,
    rotations,
)
from fmu_src.manipulator import parallel_3dof
from fmu_src.piezo import inverse_prandtl_ishlinskii as inverse_hysteresis
from fmu_src.piezo import prandtl_ishlinskii as hysteresis
from fmu_src.tremor import wflc_flc

SAMPLE_PERIOD = 1e-3
STACK_DELAY = 0.3e-3
"""Of a stack behind the stroke asked for [s]: measured, 0.1 ms at 3 um and 0.6 ms at 0.35 um."""
ESTIMATOR_STARTS = {scalar.name: scalar.start for scalar in micron.Params.scalars()}


class Params(Parameters):
    """Tremor filter, mechanism, stacks, and how it starts."""

    filter: Any = wflc_flc.WflcFlcParams.starting(
        horizon=SAMPLE_PERIOD + STACK_DELAY, wash_out=ESTIMATOR_STARTS["washout"]
    )
    mechanism: Any = parallel_3dof.Geometry
    stack_1: Any = hysteresis.Hysteresis
    stack_2: Any = hysteresis.Hysteresis
    stack_3: Any = hysteresis.Hysteresis
    amplifier: Any = inverse_hysteresis.Range
    rise_time = real("s", "from no voltage to rest", start=0.5, min=0.01, max=60.0)
    fade_time = real("s", "correction from none to full and back", start=0.5, min=0.01, max=60.0)


class Precomputed(Derived):
    """Inverses of the stacks, and the rest position."""

    rest = real("m", "d_rest, tip at half stroke less tip at zero stroke, frame 0", shape=3)
    inverse_1: Any = inverse_hysteresis.Inverse
    inverse_2: Any = inverse_hysteresis.Inverse
    inverse_3: Any = inverse_hysteresis.Inverse


class In(Inputs):
    """What the estimator knows."""

    tip_displacement = real(
        "m", "estimated displacement of the tip, frame W", shape=3, axes="xyz", min=-1.0, max=1.0
    )
    attitude = real(
        None,
        "q_WB, unit quaternion, body to world",
        shape=4,
        axes="wxyz",
        start=(1.0, 0.0, 0.0, 0.0),
        min=-1.001,
        max=1.001,
    )
    valid = boolean("whether the motion can be trusted", start=True)


class X(State):
    """Memories of the parts, and progress of start and correction."""

    filter: Any = wflc_flc.WflcFlcState
    plays_1 = real("V", "H of stack 1", shape=hysteresis.PLAYS)
    plays_2 = real("V", "H of stack 2", shape=hysteresis.PLAYS)
    plays_3 = real("V", "H of stack 3", shape=hysteresis.PLAYS)
    rise = real(None, "progress of the start", min=0.0, max=1.0)
    engagement = real(None, "progress of the correction", min=0.0, max=1.0)


class Out(Outputs):
    """Drive, and what it is to cancel."""

    volts = real("V", "v, voltages of the stacks", shape=3)
    tremor = real("m", "y_W, tremor of the tip, frame W", shape=3, axes="xyz")
    frequency = real("Hz", "its frequency along each axis", shape=3, axes="xyz")
    saturated = boolean("whether a stroke or a voltage had to be limited")


def derive(p: Params, T: float) -> Precomputed:
    """Inverses of the stacks, and the rest position."""
    half = p.mechanism.longest_stroke / 2
    lift = parallel_3dof.height(p.mechanism, half) - parallel_3dof.height(p.mechanism, 0.0)
    return Precomputed(
        rest=ca.vertcat(0.0, 0.0, lift),
        inverse_1=inverse_hysteresis.invert(p.stack_1),
        inverse_2=inverse_hysteresis.invert(p.stack_2),
        inverse_3=inverse_hysteresis.invert(p.stack_3),
    )


def smooth(progress: Any) -> ca.SX:
    """From 0 to 1 with slopes of 0 at both ends."""
    return progress**2 * (3 - 2 * progress)


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """One sample."""
    filtered, found = wflc_flc.estimate(p.filter, u.tip_displacement, u.valid, x.filter, T)

    rise = ca.fmin(x.rise + T / p.rise_time, 1.0)
    towards = ca.if_else(ca.logic_and(u.valid, rise >= 1), 1.0, -1.0)
    engagement = ca.fmin(ca.fmax(x.engagement + towards * T / p.fade_time, 0.0), 1.0)
    correction = -rotations.matrix(u.attitude).T @ found.tremor
    demand = smooth(rise) * derived.rest + smooth(engagement) * correction

    strokes, reachable = parallel_3dof.limited(
        p.mechanism, parallel_3dof.inverse(p.mechanism, demand)
    )
    stacks = zip(
        (p.stack_1, p.stack_2, p.stack_3),
        (derived.inverse_1, derived.inverse_2, derived.inverse_3),
        ca.vertsplit(strokes),
        (x.plays_1, x.plays_2, x.plays_3),
        strict=True,
    )
    volts, limited, plays = zip(
        *(
            inverse_hysteresis.drive(stack, inverse, p.amplifier, stroke, memory)
            for stack, inverse, stroke, memory in stacks
        ),
        strict=True,
    )
    saturated = ca.logic_or(ca.logic_not(reachable), ca.mmax(ca.vertcat(*limited)))
    following = X(
        filter=filtered,
        plays_1=plays[0],
        plays_2=plays[1],
        plays_3=plays[2],
        rise=rise,
        engagement=engagement,
    )
    return following, Out(
        volts=ca.vertcat(*volts),
        tremor=found.tremor,
        frequency=found.frequency,
        saturated=saturated,
    )


MODEL = Model(
    "TremorCanceller",
    step,
    Params,
    In,
    X,
    Out,
    sample_period=SAMPLE_PERIOD,
    derived=Precomputed,
    derive=derive,
)
