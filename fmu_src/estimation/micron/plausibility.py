"""Plausibility of the inertial sensors: frozen and clipped channels, field, rest.

| symbol | meaning |
| --- | --- |
| V | volts of the nine channels, six accelerometers first [V] |
| f, m | specific forces [m/s2], magnetic field [T], compensated |
| B, d | strength [T] and dip [rad] of the field; B_0, d_0 what they were undisturbed |
| A | agitation: mean square of the specific force without gravity, for an axis [m2/s4] |
| r^2 | mean square of a signal about its slow mean |

A sensor that lives has noise: a channel that repeats itself to the bit for long is frozen. The
field of the earth keeps strength and dip however the instrument turns (its direction in the body
does not tell a magnet from a turn): both are held against what they were when nothing disturbed,
learned at the start and followed slowly. A field that differs but keeps steady for long is the
undisturbed one of another place. The instrument rests where forces, their differences and the field
stay within the sensors' noise; the field tells a steady turn about the vertical from rest.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Parameters, State
from fmu_src.kit.records import integer, real

ACCELEROMETERS = 6
"""Number of accelerometers, the first of the nine channels."""
RAIL = 0.02
"""Volts from either end of the converter that are taken for the end itself."""
FIELD_MEMORY = 20.0
"""Time constant by which the undisturbed field is followed [s]."""
OTHER_MEMORY = 1.0
"""Time constant by which the present field is followed, to see if it keeps steady [s]."""
REST_MEMORY = 0.5
"""Time constant of slow means and mean squares in the detection of rest [s]."""


class Gates(Parameters):
    """Limits beyond which a measurement is not taken in, or the outputs are not valid."""

    sigma = real(
        None,
        "standard deviations of the innovation beyond which a measurement is not taken in",
        start=5.0,
        min=1.0,
        max=1e3,
    )
    force = real(
        "m/s2",
        "difference of the specific force's size from gravity beyond which it is no vertical",
        start=2.0,
        min=1e-3,
        max=100.0,
    )
    field = real(
        None,
        "relative difference of the field's strength from the undisturbed one that is let pass",
        start=0.05,
        min=1e-4,
        max=10.0,
    )
    dip = real(
        "rad",
        "difference of the field's dip from the undisturbed one that is let pass",
        start=np.radians(4.0),
        min=1e-4,
        max=4.0,
    )
    field_hold = real(
        "s",
        "time that a field must be as it was before it is believed again",
        start=0.25,
        min=0.0,
        max=60.0,
    )
    field_patience = real(
        "s",
        "time after which a field that differs but keeps steady is the undisturbed one",
        start=20.0,
        min=0.1,
        max=1e4,
    )
    tilt_patience = real(
        "s",
        "time without a vertical after which the filter starts anew",
        start=2.0,
        min=0.1,
        max=1e4,
    )
    start_patience = real(
        "s", "the same while it settles, nearly at rest", start=0.1, min=1e-2, max=1e4
    )
    tilt_outage = real(
        "s",
        "time without a vertical after which the outputs are not valid",
        start=0.5,
        min=0.0,
        max=1e4,
    )
    coherence = real(
        "s",
        "time for which a sample of the hand's acceleration stands in the vertical's weight",
        start=3e-3,
        min=1e-3,
        max=10.0,
    )
    agitation_time = real(
        "s",
        "time constant by which the hand's acceleration is followed",
        start=0.05,
        min=1e-2,
        max=60.0,
    )
    force_range = real(
        "m/s2",
        "specific force beyond which an accelerometer clips; 2 % less than its range",
        start=0.98 * 1.7 * design.STANDARD_GRAVITY,
        min=1.0,
        max=1e4,
    )
    field_range = real(
        "T",
        "field beyond which a magnetometer clips; 2 % less than its range",
        start=0.98 * 2e-4,
        min=1e-5,
        max=1.0,
    )
    difference = real(
        "m/s2",
        "difference between the channels of an axis that no hand brings about",
        start=5.0,
        min=1e-2,
        max=1e3,
    )
    frozen_samples = integer(
        "samples that are the same to the bit after which a channel is frozen; 0: never,"
        " for sensors without noise",
        start=50,
        min=0,
        max=10**6,
    )
    outage = real(
        "s",
        "time without a usable specific force after which the outputs are not valid",
        start=0.01,
        min=0.0,
        max=10.0,
    )
    rest = real(
        None,
        "rest: forces, differences and field vary by less than this many times their noise",
        start=1.25,
        min=0.0,
        max=100.0,
    )
    rest_time = real("s", "time that rest has to last", start=1.0, min=1e-2, max=60.0)
    rest_rate = real(
        "rad/s", "standard deviation of the rate at rest", start=5e-3, min=1e-6, max=1.0
    )
    tilt_limit = real(
        "rad",
        "standard deviation of the vertical beyond which the outputs are not valid",
        start=np.radians(2.0),
        min=1e-4,
        max=4.0,
    )
    heading_limit = real(
        "rad",
        "standard deviation of the north beyond which the outputs are not valid",
        start=np.radians(10.0),
        min=1e-4,
        max=4.0,
    )


class Channels(State):
    """Memory by which frozen channels are found."""

    volts = real("V", "of the last sample", shape=9, start=-1.0)
    same = real(None, "how often it came again", shape=9)


class Field(State):
    """The field when nothing disturbs, and the one that is there now."""

    strength = real("T", "B_0", start=1.0)
    dip = real("rad", "d_0")
    other_strength = real("T", "slow mean of B")
    other_dip = real("rad", "slow mean of d")
    other_for = real("s", "time that a field which is not believed has kept steady")
    fits_for = real("s", "time that it has been right in strength and dip")
    doubt = real("s", "time for which the field is still not believed")


class Rest(State):
    """Memory by which rest is found."""

    slow = real(None, "slow means of force, differences and field", shape=(3, 3))
    square = real(None, "r^2 of the three, for an axis", shape=3)
    lasted = real("s", "time that they have been quiet")


class Alive(NamedTuple):
    """Channels of a sample.

    Attributes:
        following: state.
        frozen: whether a channel is frozen.
        clipped: whether a channel is at the end of its range.
        force: whether there is a sample, and all accelerometers are neither.
        field: whether there is one, and all magnetometers are neither.
    """

    following: Channels
    frozen: Any
    clipped: Any
    force: Any
    field: Any


def alive(volts: Any, heard: Any, f: Any, m: Any, gates: Any, x: Any) -> Alive:
    """Find the channels of a sample that give what they sense.

    Args:
        volts: (9,).
        heard: whether there is a sample at all.
        f: specific forces (6,).
        m: field (3,) [T].
        gates: record `Gates`.
        x: record `Channels`.
    """
    same = ca.if_else(heard, ca.if_else(volts == x.volts, x.same + 1, 0), x.same)
    frozen = ca.logic_and(gates.frozen_samples > 0, same >= gates.frozen_samples)
    at_rail = ca.logic_or(volts < RAIL, volts > design.ADC_SPAN - RAIL)
    beyond = ca.vertcat(ca.fabs(f) > gates.force_range, ca.fabs(m) > gates.field_range)
    clipped = ca.logic_and(heard, ca.logic_or(at_rail, beyond))
    dead = ca.logic_or(frozen, clipped)
    first, rest = dead[:ACCELEROMETERS], dead[ACCELEROMETERS:]
    return Alive(
        Channels(volts=ca.if_else(heard, volts, x.volts), same=same),
        ca.mmax(frozen),
        ca.mmax(clipped),
        ca.logic_and(heard, ca.logic_not(ca.mmax(first))),
        ca.logic_and(heard, ca.logic_not(ca.mmax(rest))),
    )


def dip(along: Any) -> Any:
    """Angle of a field above the horizon [rad], from its unit vector's part along the vertical."""
    edge = 1 - 1e-9  # where the slope of the arc sine is still finite
    return ca.asin(ca.fmax(ca.fmin(along, edge), -edge))


def as_it_was(strength: Any, dip: Any, gates: Any, x: Any) -> Any:
    """Return whether strength [T] and dip [rad] of the field are the undisturbed ones."""
    return _near(strength, dip, x.strength, x.dip, gates.field, gates.dip)


def accepted(gates: Any, x: Any) -> Any:
    """Return whether a field that is not believed has kept steady for so long that it must be.

    One that fits in strength and dip shows the filter's north to be wrong rather than itself, and
    is taken sooner.
    """
    return ca.logic_or(x.other_for > gates.field_patience, x.fits_for > gates.tilt_patience)


def caught(heard: Any, dead: Any, believed: Any, x: Any) -> Any:
    """Return whether a field that was believed until now is not any more; see `follow_field`."""
    wrong = ca.logic_or(dead, ca.logic_and(heard, ca.logic_not(believed)))
    return ca.logic_and(wrong, x.doubt <= 0)


def follow_field(
    strength: Any,
    dip: Any,
    dip_felt: Any,
    heard: Any,
    dead: Any,
    believed: Any,
    anew: Any,
    age: Any,
    gates: Any,
    x: Any,
    T: float,
) -> Field:
    """Return the state of knowledge about the field one sample later.

    Args:
        strength: [T].
        dip: by the filter's vertical [rad].
        dip_felt: by the specific force, which does not hang on the filter [rad].
        heard: whether the magnetometers gave a sample.
        dead: whether one of them is frozen or clipped.
        believed: whether the sample was as it should be.
        anew: whether the filter starts here.
        age: time since it did [s].
        gates: record `Gates`.
        x: record `Field`.
        T: sample period.
    """
    # A plain mean at first, then a slow one.
    share = ca.fmax(T / (age + T), T / FIELD_MEMORY) * believed
    followed_strength = x.strength + share * (strength - x.strength)
    followed_dip = x.dip + share * (dip - x.dip)
    familiar = accepted(gates, x)
    new = ca.logic_or(anew, familiar)
    steady = _near(strength, dip_felt, x.other_strength, x.other_dip, gates.field, gates.dip)
    doubted = ca.logic_and(heard, ca.logic_not(believed))
    unknown = ca.logic_and(doubted, ca.logic_not(new))
    waiting = ca.logic_and(unknown, steady)
    fitting = ca.logic_and(unknown, as_it_was(strength, dip, gates, x))
    other = ca.if_else(anew, 1, T / OTHER_MEMORY * heard)
    return Field(
        strength=ca.if_else(
            anew, strength, ca.if_else(familiar, x.other_strength, followed_strength)
        ),
        dip=ca.if_else(anew, dip_felt, ca.if_else(familiar, x.other_dip, followed_dip)),
        other_strength=x.other_strength + other * (strength - x.other_strength),
        other_dip=x.other_dip + other * (dip_felt - x.other_dip),
        other_for=ca.if_else(waiting, x.other_for + T, ca.if_else(heard, 0, x.other_for)),
        fits_for=ca.if_else(fitting, x.fits_for + T, ca.if_else(heard, 0, x.fits_for)),
        doubt=ca.if_else(
            new,
            0,
            ca.if_else(ca.logic_or(doubted, dead), gates.field_hold, ca.fmax(x.doubt - T, 0)),
        ),
    )


def follow_rest(
    signals: Any, variances: Any, heard: Any, anew: Any, gates: Any, x: Any, T: float
) -> tuple[Rest, Any]:
    """State one sample later, and whether the instrument rests.

    Args:
        signals: specific force, differences of channels and field, (3, 3), one a column.
        variances: of the noise of an axis of each, (3,).
        heard: whether the sample can be used.
        anew: whether the filter starts here.
        gates: record `Gates`.
        x: record `Rest`.
        T: sample period.
    """
    share = ca.if_else(anew, 1, T / REST_MEMORY * heard)
    apart = signals - x.slow
    square = x.square + T / REST_MEMORY * heard * (ca.sum1(apart**2).T / 3 - x.square)
    square = ca.if_else(anew, variances * gates.rest**2, square)
    quiet = ca.logic_and(heard, ca.logic_not(ca.mmax(square > gates.rest**2 * variances)))
    lasted = ca.if_else(ca.logic_and(quiet, ca.logic_not(anew)), x.lasted + T, 0)
    return (
        Rest(slow=x.slow + share * apart, square=square, lasted=lasted),
        lasted >= gates.rest_time,
    )


def _near(strength: Any, dip: Any, strength_0: Any, dip_0: Any, field: Any, angle: Any) -> Any:
    return ca.logic_and(
        ca.fabs(strength - strength_0) <= field * strength_0, ca.fabs(dip - dip_0) <= angle
    )
