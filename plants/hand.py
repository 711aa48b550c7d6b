"""Hand that holds the instrument: generated or recorded motion of the tip, as a rigid body's.

    d     = d_intent + d_drift + d_jerk + d_tremor                 motion of the tip, W
    y_1'  = p (u - y_1),  y_i' = p (y_{i-1} - y_i),  i = 2..4      shaping filter, p = 2 pi corner
    d_i   = rms_s y_4 + rms_c y_4                                  slow intent, corrections
    d_t   = rms_t (I sin phi + Q cos phi),  phi' = 2 pi f          tremor; I, Q are filters, too
    f     = (f_1 + f_2) / 2 + (f_2 - f_1) / 2 tanh g               carrier; g is a filter
    e     = R_0^T d,  a = -c e_y / L,  b = c e_x / L               lateral motion by rotation
    R     = R_0 R_x(a) R_y(b) R_z(rho)                             attitude
    o     = d - R p_B,  o'' = d'' - R (alpha x p_B + w x (w x p_B))

| symbol | meaning |
| --- | --- |
| W, B | world, its origin where the tip is at rest; body |
| d | motion of the uncompensated tip [m], W |
| u | drive of a filter, held over a sample: white noise, or a few random pulses |
| y_4 | output of a filter, unit variance; its third derivative is still continuous |
| I, Q | amplitudes of an axis' tremor in and out of phase |
| phi, f | phase and frequency of the carrier, common to the axes [rad], [Hz] |
| R_0 | nominal attitude: heading about the vertical, tilt of the shaft from pointing down |
| c, L | share of lateral motion that is rotation, distance from the tip to the pivot [m] |
| a, b, rho | angles of rotation and roll about the shaft [rad] |
| p_B, o | tip in B, origin of B in W [m] |
| w, alpha | body rate and its derivative, B [rad/s], [rad/s2] |

Filters have four equal poles each, so their transition over a sample is a finite sum, exact for a
held drive, and derivatives are differences of their states: no derivative is numerical. Lateral
motion that is not rotation, and all motion along the shaft, is translation.

Intent is slow motion below 1 Hz and, several times a second, a correction: a pulse that rises and
falls back like the response of the filter. Jerk is the same, but rare. The instants of the pulses
are Poisson processes, common to the axes, the amplitudes normal. Tremor starts at its rms, with the
carrier in the middle of its band; the others start at rest and take four time constants, 4 / p,
to build up.

Starts of intent, corrections and tremor are geometric means over ten recordings of surgeons and
novices (identify.hand). Half a minute cannot tell drift from slow intent, nor a jerk from
a correction, and all of it counts as intent there; drift and jerk are chosen so small that they
leave the error to the tremor.

Real hands differ from this tremor. Seen as such a process, that of the recordings has amplitudes
with poles near 5 Hz: a period tells little about the one after the next, and the flanks of the peak
reach to 6 and 15 Hz. Here the amplitudes change within 0.2 Hz and only the carrier wanders over
the 8 to 12 Hz that papers give (A04 1.1), a quasi-sinusoid as adaptive oscillators presume it. A
filter that holds this tremor still has not been shown to hold a hand. Also, axes are independent
here; those of a hand are not.

With `recorded` the tip moves as the inputs say. What of it is intent is not known then: `intent`
is the whole motion, `tremor` is zero. Roll is generated in both cases.
"""

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.noise import standard_normal
from fmu_src.kit.records import Derived, Inputs, boolean, integer, real, vector
from fmu_src.math import rotations

ORDER = 4
"""Poles of a shaping filter: one more than derivatives that have to be continuous."""
UNIT_VARIANCE = 5.0 / 32.0
"""Integral of the squared impulse response t^3 e^-t / 6: variance over p times noise density."""
AXIS_DRAWS, COMMON_DRAWS = 6, 4
"""Standard normal draws of a sample: for each axis, and for all axes together."""
ROLL_CORNER = 3.0
"""Pole of the roll [Hz] (chosen): between the pace of corrections and of tremor."""
ROLL_ACCELERATION = 0.17
"""Roll acceleration of a hand, rms [rad/s2] (the size that serves as prior in reconstruction)."""


class Params(Parameters):
    """Size and pace of each kind of motion, and how the instrument is held."""

    seed = integer("seed of the motion", start=1, min=0, max=2**31 - 1)
    intent_rms = real(
        "m", "slow intent, rms", shape=3, start=(219e-6, 219e-6, 132e-6), min=0.0, max=0.02
    )
    intent_corner = real("Hz", "pole of slow intent", start=0.35, min=0.02, max=1.0)
    correction_rms = real(
        "m", "corrections, rms", shape=3, start=(61e-6, 50e-6, 38e-6), min=0.0, max=1e-3
    )
    correction_corner = real("Hz", "pole of the corrections", start=2.86, min=0.2, max=10.0)
    correction_rate = real("Hz", "corrections in a second", start=5.35, min=1e-3, max=20.0)
    drift_rms = real("m", "drift, rms (chosen)", shape=3, start=3e-6, min=0.0, max=0.02)
    drift_corner = real("Hz", "pole of the drift (chosen)", start=0.05, min=0.005, max=0.5)
    jerk_rms = real("m", "jerk, rms over all time (chosen)", shape=3, start=2e-6, min=0.0, max=1e-3)
    jerk_corner = real("Hz", "pole of the jerk (chosen)", start=3.0, min=0.2, max=10.0)
    jerk_rate = real("Hz", "jerks in a second (chosen)", start=0.1, min=1e-3, max=20.0)
    tremor_rms = real(
        "m", "tremor, rms", shape=3, start=(11.1e-6, 9.0e-6, 10.9e-6), min=0.0, max=1e-3
    )
    tremor_bandwidth = real(
        "Hz", "pole of the tremor's amplitudes (chosen; hands: 5)", start=0.2, min=0.01, max=5.0
    )
    tremor_frequency = real(
        "Hz", "edges f_1 and f_2 of the carrier's band", shape=2, start=(8, 12), min=2.0, max=30.0
    )
    wander_corner = real("Hz", "pole of the wander (chosen)", start=0.1, min=0.01, max=2.0)
    roll_rms = real(
        "rad",
        "roll about the shaft, rms",
        start=ROLL_ACCELERATION * math.sqrt(5) / (2 * math.pi * ROLL_CORNER) ** 2,
        min=0.0,
        max=0.1,
    )
    roll_corner = real("Hz", "pole of the roll (chosen)", start=ROLL_CORNER, min=0.02, max=10.0)
    pivot_distance = real(
        "m", "L, tip to pivot of the grip (A04 2.1.1)", start=0.1, min=0.02, max=1.0
    )
    rotation_share = real(None, "c, lateral motion that is rotation", start=0.5, min=0.0, max=1.0)
    tilt = real("rad", "shaft from straight down", start=math.pi / 4, min=0.0, max=math.pi)
    heading = real("rad", "shaft from magnetic north", start=0.0, within=math.pi)
    tip = real("m", "tip p_B in B", shape=3, start=design.TIP, within=1.0)


class In(Inputs):
    """A recording, between its samples as well (relative to the tip's place at rest)."""

    recorded = boolean("whether the tip moves as recorded")
    recorded_x = real("m", "tip in W, x", within=0.1)
    recorded_y = real("m", "tip in W, y", within=0.1)
    recorded_z = real("m", "tip in W, z", within=0.1)
    recorded_velocity = vector("m/s", "velocity of the tip in W", within=10.0)
    recorded_acceleration = vector("m/s2", "acceleration of the tip in W", within=1e3)


class Drives(Derived):
    """Factors of the filters' drives, for which their outputs have a variance of 1."""

    intent = real(None, "slow intent")
    correction = real(None, "corrections, by their rate, too")
    drift = real(None, "drift")
    jerk = real(None, "jerk, by their rate, too")
    amplitude = real(None, "amplitudes of the tremor")
    wander = real(None, "wander of the carrier")
    roll = real(None, "roll")


class Rows(Derived):
    """Transition of the shaping filters, p_m = e^-pT (pT)^m / m!, m = 0..3, and what else stays."""

    intent = real(None, "slow intent", shape=ORDER)
    correction = real(None, "corrections", shape=ORDER)
    drift = real(None, "drift", shape=ORDER)
    jerk = real(None, "jerk", shape=ORDER)
    amplitude = real(None, "amplitudes of the tremor", shape=ORDER)
    wander = real(None, "wander of the carrier", shape=ORDER)
    roll = real(None, "roll", shape=ORDER)
    correction_threshold = real(None, "normal draw above which a correction begins")
    jerk_threshold = real(None, "normal draw above which a jerk begins")
    drives: Any = Drives
    nominal = real(None, "R_0 as a quaternion", shape=4)
    turned = real("1/m", "rotation of the shaft by lateral motion: c / L times R_0^T", shape=(3, 3))


_PHASES = np.radians([0.0, 120.0, 240.0])


class X(State):
    """Shaping filters, one axis a column, unit variance; phase of the carrier."""

    intent = real(None, "slow intent", shape=(ORDER, 3))
    correction = real(None, "corrections", shape=(ORDER, 3))
    drift = real(None, "drift", shape=(ORDER, 3))
    jerk = real(None, "jerk", shape=(ORDER, 3))
    in_phase = real(
        None,
        "amplitudes I of the tremor",
        shape=(ORDER, 3),
        start=np.tile(math.sqrt(2) * np.cos(_PHASES), (ORDER, 1)),
    )
    quadrature = real(
        None,
        "amplitudes Q of the tremor",
        shape=(ORDER, 3),
        start=np.tile(math.sqrt(2) * np.sin(_PHASES), (ORDER, 1)),
    )
    wander = real(None, "wander g of the carrier", shape=(ORDER, 1))
    roll = real(None, "roll", shape=(ORDER, 1))
    phase = real("rad", "phase phi of the carrier")


class Out(Outputs):
    """Motion of the tip, and of the body that makes it."""

    tip = vector("m", "uncompensated tip in W")
    intent = vector("m", "wanted part of it")
    tremor = vector("m", "tremor in it")
    body = vector("m", "origin of B in W")
    body_acceleration = vector("m/s2", "acceleration of the origin of B, W")
    attitude = real(None, "attitude q_WB", shape=4, axes="wxyz")
    rate = vector("rad/s", "body rate in B")
    angular_acceleration = vector("rad/s2", "angular acceleration in B")


@dataclass(frozen=True)
class Motion:
    """A quantity with its first two derivatives in time."""

    value: Any
    rate: Any
    acceleration: Any

    def __add__(self, other: "Motion") -> "Motion":
        return Motion(
            self.value + other.value,
            self.rate + other.rate,
            self.acceleration + other.acceleration,
        )

    def scaled(self, factor: Any) -> "Motion":
        """Multiply element by element with a constant."""
        return Motion(self.value * factor, self.rate * factor, self.acceleration * factor)


def pole(corner: Any) -> Any:
    """Return the pole p of a shaping filter [rad/s] from its corner [Hz]."""
    return 2 * math.pi * corner


def derive(p: Params, T: float) -> Rows:
    """Compute what follows from the parameters."""

    def transition(corner: Any) -> Any:
        x = pole(corner) * T
        return ca.exp(-x) * ca.vertcat(*(x**m / math.factorial(m) for m in range(ORDER)))

    def drive(corner: Any, rate: Any = None) -> Any:
        power = UNIT_VARIANCE * pole(corner) * T
        return 1 / ca.sqrt(power if rate is None else power * rate * T)

    corners = {
        "intent": p.intent_corner,
        "correction": p.correction_corner,
        "drift": p.drift_corner,
        "jerk": p.jerk_corner,
        "amplitude": p.tremor_bandwidth,
        "wander": p.wander_corner,
        "roll": p.roll_corner,
    }
    rates = {"correction": p.correction_rate, "jerk": p.jerk_rate}
    nominal = rotations.multiply(_about(2, p.heading), _about(1, math.pi - p.tilt))
    return Rows(
        **{name: transition(corner) for name, corner in corners.items()},
        correction_threshold=-standard_normal(p.correction_rate * T),
        jerk_threshold=-standard_normal(p.jerk_rate * T),
        drives=Drives(**{n: drive(corner, rates.get(n)) for n, corner in corners.items()}),
        nominal=nominal,
        turned=p.rotation_share / p.pivot_distance * rotations.matrix(nominal).T,
    )


def _about(axis: int, angle: Any) -> Any:
    """Return the quaternion of a rotation about an axis of its own frame, (4,)."""
    parts = [ca.cos(angle / 2), 0.0, 0.0, 0.0]
    parts[1 + axis] = ca.sin(angle / 2)
    return ca.vertcat(*parts)


def _turn(axis: int, turn: Any) -> tuple[Any, Any]:
    """Return sine and cosine of the angle of such a rotation."""
    c, s = turn[0], turn[1 + axis]
    return 2 * s * c, 1 - 2 * s**2


def advance(y: Any, transition: Any, drive: Any) -> Any:
    """Return the filter states a sample later, exact for a drive held over the sample.

    Args:
        y: states, (ORDER, n).
        transition: its row of the derived record.
        drive: uncorrelated, of the variance that gives the output one of 1, (n,).
    """
    held = drive.T
    rows = [
        held + sum(transition[m] * (y[i - m, :] - held) for m in range(i + 1)) for i in range(ORDER)
    ]
    return ca.vertcat(*rows)


def motion(y: Any, corner: Any) -> Motion:
    """Return the output of a filter and its derivatives, each (n,)."""
    p = pole(corner)
    return Motion(
        y[3, :].T,
        p * (y[2, :] - y[3, :]).T,
        p**2 * (y[1, :] - 2 * y[2, :] + y[3, :]).T,
    )


def carrier(p: Params, wander: Any) -> tuple[Any, Any]:
    """Return the angular frequency of the tremor [rad/s] and its derivative [rad/s2]."""
    g = motion(wander, p.wander_corner)
    low, high = p.tremor_frequency[0], p.tremor_frequency[1]
    bend = ca.tanh(g.value[0])
    frequency = (low + high) / 2 + (high - low) / 2 * bend
    slope = (high - low) / 2 * (1 - bend * bend) * g.rate[0]
    return 2 * math.pi * frequency, 2 * math.pi * slope


def tremor(p: Params, x: X) -> Motion:
    """Compute the tremor d_t by the product rule, (3,) [m]."""
    i, q = motion(x.in_phase, p.tremor_bandwidth), motion(x.quadrature, p.tremor_bandwidth)
    w, dw = carrier(p, x.wander)
    s, c = ca.sin(x.phase), ca.cos(x.phase)
    rate = (i.rate - w * q.value) * s + (q.rate + w * i.value) * c
    acceleration = (i.acceleration - w * w * i.value - 2 * w * q.rate - dw * q.value) * s + (
        q.acceleration - w * w * q.value + 2 * w * i.rate + dw * i.value
    ) * c
    return Motion(i.value * s + q.value * c, rate, acceleration).scaled(p.tremor_rms)


def body_motion(
    p: Params, derived: Rows, tip: Motion, roll: Motion
) -> tuple[Any, Any, Any, Any, Any]:
    """Compute the motion of a rigid body whose tip moves as given.

    Args:
        p: parameters.
        derived: what follows from them.
        tip: motion of the tip, (3,) [m], W.
        roll: about the shaft, scalar [rad].

    Returns:
        Origin of B [m] and its acceleration [m/s2] in W, attitude q_WB, body rate [rad/s] and
        angular acceleration [rad/s2] in B.
    """
    across, across_rate, across_acceleration = (
        derived.turned @ part for part in (tip.value, tip.rate, tip.acceleration)
    )
    a, da, dda = -across[1], -across_rate[1], -across_acceleration[1]
    b, db, ddb = across[0], across_rate[0], across_acceleration[0]
    lateral, rolled = _about(1, b), _about(2, roll.value)
    attitude = rotations.multiply(
        rotations.multiply(derived.nominal, _about(0, a)), rotations.multiply(lateral, rolled)
    )

    # Rate and acceleration before the roll, then through it.
    sin_b, cos_b = _turn(1, lateral)
    before = ca.vertcat(da * cos_b, db, da * sin_b)
    before_derivative = ca.vertcat(
        dda * cos_b - da * db * sin_b, ddb, dda * sin_b + da * db * cos_b
    )
    sin_roll, cos_roll = _turn(2, rolled)
    unroll = ca.vertcat(
        ca.horzcat(cos_roll, sin_roll, 0), ca.horzcat(-sin_roll, cos_roll, 0), ca.SX([[0, 0, 1]])
    )
    rolling = ca.vertcat(0, 0, roll.rate)
    rate = unroll @ before + rolling
    angular_acceleration = (
        unroll @ before_derivative
        - ca.cross(rolling, unroll @ before)
        + ca.vertcat(0, 0, roll.acceleration)
    )

    R = rotations.matrix(attitude)
    lever = ca.cross(angular_acceleration, p.tip) + ca.cross(rate, ca.cross(rate, p.tip))
    origin = tip.value - R @ p.tip
    return origin, tip.acceleration - R @ lever, attitude, rate, angular_acceleration


def step(p: Params, u: In, x: X, T: float, derived: Rows, normal: Any) -> tuple[X, Out]:
    """Return the outputs at this instant, and the state at the next sample."""
    intent = motion(x.intent, p.intent_corner).scaled(p.intent_rms) + motion(
        x.correction, p.correction_corner
    ).scaled(p.correction_rms)
    drift = motion(x.drift, p.drift_corner).scaled(p.drift_rms)
    jerk = motion(x.jerk, p.jerk_corner).scaled(p.jerk_rms)
    trembling = tremor(p, x)
    generated = intent + drift + jerk + trembling
    recorded = ca.vertcat(u.recorded_x, u.recorded_y, u.recorded_z)
    tip = Motion(
        ca.if_else(u.recorded, recorded, generated.value),
        ca.if_else(u.recorded, u.recorded_velocity, generated.rate),
        ca.if_else(u.recorded, u.recorded_acceleration, generated.acceleration),
    )
    roll = motion(x.roll, p.roll_corner).scaled(p.roll_rms)
    body, body_acceleration, attitude, rate, angular_acceleration = body_motion(
        p, derived, tip, roll
    )

    axes = ca.reshape(normal[: 3 * AXIS_DRAWS], 3, AXIS_DRAWS)
    to_intent, to_drift, to_in_phase, to_quadrature, size, jolt = ca.horzsplit(axes)
    to_wander, to_roll, chance, jerk_chance = ca.vertsplit(normal[3 * AXIS_DRAWS :])
    drives = derived.drives
    to_correction = (chance > derived.correction_threshold) * size
    to_jerk = (jerk_chance > derived.jerk_threshold) * jolt
    wander = advance(x.wander, derived.wander, drives.wander * to_wander)
    (w, dw), (w_next, dw_next) = carrier(p, x.wander), carrier(p, wander)
    # Hermite's rule: the integral of a cubic through both ends is good to a part in 1e15 here.
    phase = x.phase + T * (w + w_next) / 2 + T**2 * (dw - dw_next) / 12
    following = X(
        intent=advance(x.intent, derived.intent, drives.intent * to_intent),
        correction=advance(x.correction, derived.correction, drives.correction * to_correction),
        drift=advance(x.drift, derived.drift, drives.drift * to_drift),
        jerk=advance(x.jerk, derived.jerk, drives.jerk * to_jerk),
        in_phase=advance(x.in_phase, derived.amplitude, drives.amplitude * to_in_phase),
        quadrature=advance(x.quadrature, derived.amplitude, drives.amplitude * to_quadrature),
        wander=wander,
        roll=advance(x.roll, derived.roll, drives.roll * to_roll),
        phase=phase - 2 * math.pi * ca.floor(phase / (2 * math.pi)),
    )
    return following, Out(
        tip=tip.value,
        intent=ca.if_else(u.recorded, recorded, intent.value),
        tremor=ca.if_else(u.recorded, 0, trembling.value),
        body=body,
        body_acceleration=body_acceleration,
        attitude=attitude,
        rate=rate,
        angular_acceleration=angular_acceleration,
    )


MODEL = Model.of_step(
    "Hand", step, sample_period=1e-3, draws=3 * AXIS_DRAWS + COMMON_DRAWS, derive=derive
)
