"""Forecaster on the accelerometers themselves: tremor without double integration and its drift.

    s    = motion of the tip in B, an acceleration       `inertial`
    y_B  = (band-pass x U) over past and forecast of s   `var_forecaster`
    y    = R(q_WB) y_B

What is called tremor is a band-pass of the displacement over past and future, and the displacement
is the acceleration times a known factor U at each frequency. So one set of weights takes from the
past and forecast acceleration to the tremor, lag and gravity included; the forecaster does not know
that what it learns the spectrum of is an acceleration.

| symbol | field | meaning |
| --- | --- | --- |
| f | force | compensated specific forces of the channels |
| q_WB | attitude | rotates body vectors into the world |
| h | horizon | how far ahead the tremor is wanted |
| y, y_B | tremor | tremor of the tip at the time t + horizon, in W and in B |
"""

from functools import partial
from typing import Any

from fmu_src.kit import State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived
from fmu_src.math import rotations
from fmu_src.tremor import inertial, var_forecaster
from fmu_src.tremor.inertial import In
from fmu_src.tremor.ports import HORIZON, Out


class Params(var_forecaster.Learning):
    """Band and memory, the sensors, and when the tremor is wanted."""

    sensing: Any = inertial.Sensing
    horizon = HORIZON


class X(State):
    """Front and forecaster."""

    front: Any = inertial.Sensed
    forecaster: Any = var_forecaster.X


class Precomputed(Derived):
    """Constants of front and forecaster, computed from the parameters."""

    front: Any = inertial.Front
    band: Any = var_forecaster.Weights


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    undo = partial(inertial.undo, p.sensing.lag)
    return Precomputed(
        front=inertial.derive(p.sensing, T),
        band=var_forecaster.weights(p, p.horizon, undo, T),
    )


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    front, motion = inertial.sense(derived.front, u.force, u.valid, x.front, T)
    learnt, out = var_forecaster.estimate(derived.band, motion, u.valid, x.forecaster, T)
    following = X(front=front, forecaster=learnt)
    return following, Out(tremor=rotations.matrix(u.attitude) @ out.tremor)


MODEL = Model.of_step(
    "InertialForecaster",
    step,
    sample_period=var_forecaster.SAMPLE_PERIOD,
    derive=derive,
    matrix=True,
)
