"""Piezo stack with hysteresis, creep, lag and a resonance, made of slip elements.

    v'   = (u - v) / tau_v                                         charging
    F_i' = v' - sgn(F_i) (max(|F_i| - W_i(v), 0) / D)^2            slip, i = 1..6
    W_i(v) = W_i max(0.3, 1 + c (v / v_m - 1))
    h'   = v' - g |v'| h / H,  g = 1 + b rising, 1 - b falling     loop
    p    = v - sum k_i F_i - k_h h
    y_i  = s p (1 + s_2 p + s_3 p^2)                               asymmetry
    z_j' = (q y_i - z_j) / tau_j,  j = 1..5                        creep
    y'' + 2 zeta w y' + w^2 y = w^2 (y_i + sum z_j)                resonance

| symbol | meaning |
| --- | --- |
| u, v | voltage at the terminals, voltage that has reached the ceramic [V] |
| F_i, W_i, k_i | voltage held back by slip element i [V], where it begins to slip [V], its weight |
| D | how hard a slipping element is to move faster [V0.5.s0.5] |
| c, v_m | growth of the slip thresholds with the voltage, and where it counts from [V] |
| h, H, k_h, b | loop of the smallest strokes [V], its width [V], weight and lopsidedness |
| p | voltage left to strain the ceramic [V] |
| s, s_2, s_3 | stroke per volt [m/V] and its change with the voltage [1/V], [1/V2] |
| z_j, tau_j, q | creep [m], its times [s], its share of the stroke |
| w, zeta | circular frequency and damping of the stack with its levers |
| y | stroke, 0 at rest at 0 V [m] |

Slip elements in parallel are Goldfarb and Celanovic's (1997); that they creep on, instead of
stopping dead at the threshold, makes the loop widen with the rate. The loop is a first-order
Duhem (Dahl) element. No play operator occurs, so that an inverse built of them is tested against
something else than itself. The numbers were fitted to A04 chapter 7: sines of 12.5 um p-p deviate
from the best straight line by 1.08 to 1.33 um rms at 1 to 19 Hz, sensor noise included (Table 7.1:
1.13 to 1.37 um), by 14 to 15 % of peak to peak when they are slow (there: 15 %), and the slope at
the lower turning point of a triangle falls to zero between 36 and 42 Hz (there: 36 Hz). The stack
starts as new, at 0 V without a past, and leaves its virgin curve for good.

Integration in steps of half a sample: charging and loop exactly, slip by the implicit Euler rule
(a quadratic equation, solved), creep for the mean stroke of the step, resonance exactly for one
that runs straight over it. The stroke at a sample does not depend on the voltage set there.
"""

import math
from typing import Any

import casadi as ca

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, real
from fmu_src.math.pairwise import pairwise_sum

SUBSTEPS = 2
LEAST_THRESHOLD = 0.3
"""Share of a slip threshold that is left at low voltage."""


class Params(Parameters):
    """One stack; numbers of a P-885.50 with its levers, fitted to A04 chapter 7."""

    gain_error = real(None, "relative deviation of this stack's gain s", start=0.0, within=0.3)
    gain = real("m/V", "stroke per volt s", start=0.20057e-6, min=0.0, max=2e-6)
    gain_slope = real("1/V", "s_2", start=8e-4, within=1e-2)
    gain_curvature = real("1/V2", "s_3", start=-6e-6, within=1e-4)
    charging_time = real("s", "time constant tau_v", start=0.2e-3, min=1e-6, max=0.1)
    slip_threshold = real(
        "V", "W_i at the middle voltage", shape=6, start=(3, 8, 15, 23, 32, 42), min=0.0, max=200.0
    )
    slip_weight = real(
        None,
        "k_i",
        shape=6,
        start=(0.0932, 0.0932, 0.1049, 0.1166, 0.1166, 0.1166),
        min=0.0,
        max=1.0,
    )
    slip_resistance = real("V0.5.s0.5", "D", start=0.0441, min=1e-4, max=1.0)
    slip_growth = real(None, "c", start=0.25, min=0.0, max=1.0)
    middle_voltage = real("V", "v_m", start=50.0, min=1.0, max=500.0)
    loop_width = real("V", "H", start=15.0, min=0.1, max=100.0)
    loop_weight = real(None, "k_h", start=0.06, min=0.0, max=1.0)
    loop_lopsidedness = real(None, "b", start=0.15, min=0.0, max=0.9)
    creep_share = real(None, "q, share of the stroke for each time", start=0.0133, min=0.0, max=0.2)
    creep_time = real("s", "tau_j", shape=5, start=(3e-3, 30e-3, 0.3, 3.0, 30.0), min=1e-3, max=1e4)
    resonance = real("Hz", "frequency of the mode", start=700.0, min=50.0, max=2000.0)
    damping = real(None, "damping ratio zeta of the mode", start=0.06, min=0.0, max=0.9)


class In(Inputs):
    """Drive."""

    volts = real("V", "voltage u at the terminals", min=-20.0, max=120.0)


class Rows(Derived):
    """Transition of the linear parts over half a sample."""

    charging = real(None, "what is left of a voltage step")
    creep = real(None, "what is left of creep", shape=5)
    mode = real(None, "transition of (y, y' / w) about its forced motion", shape=(2, 2))
    stiffness = real("1/V", "4 k of the slip's equation x + k x^2 = over")
    growth = real("1/V", "growth of the slip thresholds with the voltage")
    growth_at_rest = real(None, "slip thresholds at 0 V, by those at the middle voltage")
    steepness = real("1/V", "of the loop, rising and falling", shape=2)
    loop_end = real("V", "h that it tends to, rising and falling", shape=2)
    gains = real("m/V", "s with its deviation")
    pace = real("rad/s", "w")
    period = real("s/rad", "1 / w")
    late = real(None, "2 zeta / (w h)")


class X(State):
    """Everything that the stack remembers."""

    charge = real("V", "voltage v that has reached the ceramic")
    slip = real("V", "voltages F_i held back", shape=6)
    loop = real("V", "loop h")
    creep = real("m", "creep z_j", shape=5)
    stroke = real("m", "stroke y")
    velocity = real("m/s", "its derivative")


class Out(Outputs):
    """Stroke."""

    stroke = real("m", "stroke of the stack, 0 at rest at 0 V")


def derive(p: Params, T: float) -> Rows:
    """Compute what follows from the parameters."""
    h = T / SUBSTEPS
    w = 2 * math.pi * p.resonance
    turning = ca.sqrt(1 - p.damping**2)
    left = ca.exp(-p.damping * w * h)
    c, s = ca.cos(turning * w * h), ca.sin(turning * w * h) / turning
    growth = p.slip_growth / p.middle_voltage
    lopsided = 1 + p.loop_lopsidedness * ca.DM([1, -1])
    return Rows(
        charging=ca.exp(-h / p.charging_time),
        creep=ca.exp(-h / p.creep_time),
        mode=left * ca.vertcat(ca.horzcat(c + p.damping * s, s), ca.horzcat(-s, c - p.damping * s)),
        stiffness=4 * h / p.slip_resistance**2,
        growth=growth,
        growth_at_rest=1 - p.slip_growth,
        steepness=lopsided / p.loop_width,
        loop_end=p.loop_width / lopsided,
        gains=p.gain * (1 + p.gain_error),
        pace=w,
        period=1 / w,
        late=2 * p.damping / (w * h),
    )


def slip(p: Params, held: Any, charge: Any, rise: Any, derived: Rows) -> Any:
    """Return the slip voltages F_i after a step, (6,) [V].

    Args:
        p: parameters.
        held: F_i before, (6,) [V].
        charge: v at the end of the step [V].
        rise: change of v in it [V].
        derived: what follows from the parameters and the length of the step.
    """
    growth = derived.growth_at_rest + derived.growth * charge
    threshold = p.slip_threshold * ca.fmax(LEAST_THRESHOLD, growth)
    trial = held + rise
    over = ca.fmax(ca.fabs(trial) - threshold, 0)
    # Implicit Euler: x + k x^2 = over, x what is left beyond the threshold. The root is written so
    # that it loses no digits where k over is small.
    left = 2 * over / (1 + ca.sqrt(1 + derived.stiffness * over))
    return trial - ca.copysign(over - left, trial)


def loop(derived: Rows, held: Any, rise: Any, towards: Any) -> Any:
    """Return the loop h after a step [V], exact for a voltage that goes one way.

    Args:
        derived: what follows from the parameters.
        held: h before [V].
        rise: change of v in the step [V].
        towards: a number of the same sign, the same in all steps of a sample.
    """
    rising = towards > 0
    steepness = ca.if_else(rising, -derived.steepness[0], derived.steepness[1])
    end = ca.sign(towards) * ca.if_else(rising, derived.loop_end[0], derived.loop_end[1])
    return end + (held - end) * ca.exp(steepness * rise)


def ceramic(p: Params, derived: Rows, x: X) -> Any:
    """Return the stroke y_i of the ceramic without creep [m]."""
    strained = x.charge - p.loop_weight * x.loop - pairwise_sum(p.slip_weight * x.slip)
    bend = 1 + strained * (p.gain_slope + p.gain_curvature * strained)
    return derived.gains * strained * bend


def substep(p: Params, volts: Any, towards: Any, x: X, h: float, derived: Rows) -> X:
    """Return the state of the stack a step later.

    Args:
        p: parameters.
        volts: u [V].
        towards: u - v at the sample [V].
        x: the stack.
        h: length of the step [s].
        derived: what follows from the parameters and that.
    """
    charge = volts + (x.charge - volts) * derived.charging
    rise = charge - x.charge
    moved = x.replace(
        charge=charge,
        slip=slip(p, x.slip, charge, rise, derived),
        loop=loop(derived, x.loop, rise, towards),
    )
    before, after = ceramic(p, derived, x), ceramic(p, derived, moved)
    aim = (0.5 * p.creep_share) * (before + after)
    creep = aim + (x.creep - aim) * derived.creep

    # Forced by a straight run from `start` to `end`, the mode follows it 2 zeta / w late.
    start, end = before + pairwise_sum(x.creep), after + pairwise_sum(creep)
    way = end - start
    slope, late = way * (1 / h), derived.late * way
    free = derived.mode @ ca.vertcat(
        x.stroke - (start - late), (x.velocity - slope) * derived.period
    )
    velocity = slope + derived.pace * free[1]
    return moved.replace(creep=creep, stroke=end - late + free[0], velocity=velocity)


def step(p: Params, u: In, x: X, T: float, derived: Rows) -> tuple[X, Out]:
    """Return the stroke at this instant, and the stack at the next sample."""
    following = x
    for _ in range(SUBSTEPS):
        following = substep(p, u.volts, u.volts - x.charge, following, T / SUBSTEPS, derived)
    return following, Out(stroke=x.stroke)


MODEL = Model.of_step("PiezoStack", step, sample_period=1e-4, derive=derive)
