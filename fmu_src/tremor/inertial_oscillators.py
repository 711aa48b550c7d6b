"""Intent and oscillators on the accelerometers themselves: a Kalman filter without an integrator.

    s    = motion of the tip in B, an acceleration       `inertial`
    y_B  = sum W_i Re(U_i e^((i 2 pi f_i - 1 / tau_m) h) z_i)   oscillators of s, `oscillators`
    y    = R(q_WB) y_B

The filter tells oscillators from intent in an acceleration as it does in a position, and with the
settings that were found for positions; each oscillator has one frequency, at which the factor U
from acceleration to displacement is a number.

| symbol | field | meaning |
| --- | --- | --- |
| f | force | compensated specific forces of the channels |
| q_WB | attitude | rotates body vectors into the world |
| h | horizon | how far ahead the tremor is wanted |
| y, y_B | tremor | tremor of the tip at the time t + h, in W and in B |
"""

from functools import partial
from typing import Any

from fmu_src.kit import Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived
from fmu_src.math import rotations
from fmu_src.tremor import inertial, oscillators
from fmu_src.tremor.inertial import In
from fmu_src.tremor.ports import HORIZON, Out


class Params(Parameters):
    """The sensors, and when the tremor is wanted."""

    sensing: Any = inertial.Sensing
    horizon = HORIZON


class X(State):
    """Front, and intent and oscillators."""

    front: Any = inertial.Sensed
    filter: Any = oscillators.OscillatorState


class Precomputed(Derived):
    """Constants of front and oscillators, computed from the parameters."""

    front: Any = inertial.Front
    factors: Any = oscillators.Factors


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    undo = partial(inertial.undo, p.sensing.lag)
    return Precomputed(
        front=inertial.derive(p.sensing, T), factors=oscillators.factors(p.horizon, undo)
    )


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    front, motion = inertial.sense(derived.front, u.force, u.valid, x.front, T)
    learnt, out = oscillators.estimate(derived.factors, motion, u.valid, x.filter, T)
    following = X(front=front, filter=learnt)
    return following, Out(tremor=rotations.matrix(u.attitude) @ out.tremor)


MODEL = Model.of_step("InertialOscillators", step, sample_period=1e-3, derive=derive, matrix=True)
