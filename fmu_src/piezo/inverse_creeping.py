"""Inverse of the Prandtl-Ishlinskii operator with creep: voltage that gives a stroke.

    y = demand z, a horizon h ahead                `demand`
    v : sum w_i H_i(v) = S^-1(y) - sum_i c_i sum_j K_ij

Creep at the end of a sample is known before its voltage is chosen; what it leaves over is inverted
as in `inverse_prandtl_ishlinskii`. The memory carried is the forward operator's, moved by the
voltage really sent.

| symbol | field | meaning |
| --- | --- | --- |
| z | stroke | stroke wanted |
| v | volts | voltage, within amplifier.lowest and amplifier.highest |
| h T | horizon | how far ahead of the demand the voltage has to be |
| others | | as in `creeping` and `inverse_prandtl_ishlinskii` |
"""

from typing import Any

from fmu_src.kit import State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived
from fmu_src.piezo import creeping
from fmu_src.piezo import inverse_prandtl_ishlinskii as inverse
from fmu_src.piezo.creeping import Creeping, Memory, Pace
from fmu_src.piezo.demand import Demand, ahead, seen
from fmu_src.piezo.inverse_prandtl_ishlinskii import In, Inverse, Out, drive, invert


class Params(inverse.Params):
    """The operator to invert, and the amplifier."""

    hysteresis: Any = Creeping


class X(State):
    """Memory of the stack and of the demand."""

    stack: Any = Memory
    demand: Any = Demand


class Precomputed(Derived):
    """Inverse operator and creep in a sample, computed from the parameters."""

    inverse: Any = Inverse
    pace: Any = Pace


def derive(p: Params, T: float) -> Precomputed:
    """Compute the inverse operator, and creep in a sample."""
    return Precomputed(inverse=invert(p.hysteresis), pace=creeping.derive(p.hysteresis, T))


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    wanted, _ = ahead(u.stroke, x.demand, p.horizon / T)
    crept, added = creeping.creep(p.hysteresis, derived.pace, x.stack)
    volts, limited, _ = drive(
        p.hysteresis, derived.inverse, p.amplifier, wanted, x.stack.plays, added
    )
    stack = creeping.remembered(p.hysteresis, crept, volts, x.stack)
    following = X(stack=stack, demand=seen(u.stroke, x.demand))
    return following, Out(volts=volts, limited=limited)


MODEL = Model.of_step("InverseCreepPrandtlIshlinskii", step, sample_period=1e-3, derive=derive)
