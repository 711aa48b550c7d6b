"""Motion of the tip from six accelerometer channels, by what has been learnt of hand and noise.

    f    = L (A a) + n,  a = (acceleration of the tip, angular acceleration)   B, gravity left out
    b_i  = (band-pass of f_i) / (N_i sigma)        what noise alone would give has variance 1
    S    = mean of b b^T over tau                  the hand's, and 1 of noise
    S_+  = (tau_0 (I + l B P B^T) + t S) / (tau_0 + t),  B = D^-1 A,  D = diag(N_i)
    l    = c max(tr S - 6, 6 p_0) / tr B P B^T     as strong as this hand
    X    = I - S_+^-1                              Wiener gain, were S_+ the truth
    F    = X^3 (X^2 + e^2 I)^-1                    the same, what could be chance left out
    K    = (tip of A^-1) D F D^-1
    s'   = s - K (f' - f) / (2 pi f_c)^2           from sample to sample

Tremor reaches all channels at once, as the hand turns and shifts the instrument; noise reaches each
by itself. How a hand does that is learnt from the channels behind a band-pass, where tremor is: the
covariance S less that of the noise is the hand's. Taken literally, six channels determine the tip's
acceleration, but multiply noise by 7.5 across the shaft, for the turn about it rests on 20 mm. With
K a direction in which there is nothing but noise counts for nothing, and a weak hand under strong
noise is answered by less than one, so that it is not made worse. Until much of a hand has been
seen, P stands in for it, with this hand's strength, which shows at once, and c for what it cannot
know: as much rotation as translation, but for roll, of which hands have little.

The band-pass that learns is two equal second-order sections. S is a mean over some seconds, so its
eigenvalues err by some per cent, and e leaves out those that do not stand out from 1. A gain that
changes costs the forecast behind it something; tau is long therefore.

What comes out is an acceleration written as the displacement that it would be at f_c. For a filter
that knows spectra that is as good as a position: what it takes for tremor is put right by
U = (f_c / f)^2 (1 + i 2 pi f tau_s) at each frequency, which is double integration and the sensors'
lag L undone, without drift, since nothing is integrated. Gravity is left out: turning the
instrument by tremor moves it less than it moves the tip. The motion goes on from sample to sample
by differences, so that a change of K is no step.

The magnetometer has no part in this. Rotation that it tells, sampled at 1 kHz with a resolution of
40 microgauss in 10 Hz, has a noise of 45 urad/sqrt(Hz), which is 9 um/sqrt(Hz) at the tip and more
than the tremor. At 10 Hz accelerometers tell rotation across the shaft to 3 urad/sqrt(Hz), as their
data sheet has them, and to 14 as A04 does; about the shaft hands turn by 14.

tau_0, tau, c, e and P were found on ten recordings of hands.

| symbol | field or constant | meaning |
| --- | --- | --- |
| f | force | compensated specific forces of the channels [m/s2] |
| N_i | density | noise density of a channel |
| sigma | | of white noise of density 1 behind lag and band-pass |
| tau_s | lag | of the sensors' output filter L |
| A | `lever_rows` | rows of the channels: acceleration of the tip, angular acceleration |
| P, c | PRIOR, BROADER | squared densities of a before a hand has been seen, and how much larger |
| p_0 | LEAST_POWER | least strength of a hand, over that of the noise |
| tau_0 | PRIOR_TIME | time that P stands for |
| t, tau | watched, MEMORY | time that S is the mean of, and its largest value |
| e | DOUBT | how far from noise an eigenvalue has to be |
| K | gain | of the tip's acceleration |
| f_c | CENTRE | |
| s | motion | of the tip in B, as displacement at f_c [m] |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.kit import Parameters, State
from fmu_src.kit.records import Derived, Inputs, boolean, quaternion, real
from fmu_src.math import elliptic
from fmu_src.math.phasors import Pair

CHANNELS = len(kinematics.CHANNELS)
CENTRE = 10.0
"""f_c [Hz]."""
PRIOR = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 1.0]) ** 2
"""P: acceleration of the tip along the axes of B [m2/s3], angular about them [rad2/s3]."""
PRIOR_TIME = 15.0
"""tau_0 [s]."""
BROADER = 6.0
"""c."""
LEAST_POWER = 0.01
"""p_0."""
DOUBT = 0.1
"""e."""
MEMORY = 30.0
"""tau [s]."""
BAND = (6.0, 15.0)
"""Edges of the band-pass that the covariance is learnt behind [Hz]."""
SECTIONS = 2
LEAST_TIME = 1e-9
"""Added to the time watched, so that none is divided by nought [s]."""
LEARN_EVERY = 100
"""Samples after which the gain is computed again."""
GRID = np.arange(0.25, 100.0, 0.5)
"""Frequencies at which the noise is summed up [Hz]."""


class Sensing(Parameters):
    """Places of the channels, and what they add."""

    geometry: Any = kinematics.Layout
    density: Any = kinematics.DENSITY
    lag: Any = kinematics.LAG


class In(Inputs):
    """Specific forces of the accelerometers, and attitude of the instrument."""

    force = real(
        "m/s2",
        "compensated specific force in B",
        shape=CHANNELS,
        axes=kinematics.CHANNELS,
        within=1e3,
    )
    attitude = quaternion("q_WB, unit quaternion, body to world", within=1.001)
    valid = boolean("whether both can be trusted", start=True)


class Sensed(State):
    """Covariance learnt of the hand, and the tip's motion."""

    tracked = boolean("whether the last sample could be trusted")
    force = real("m/s2", "f of the last one that could", shape=CHANNELS)
    change = real("m/s2", "f since the first one, gaps left out", shape=CHANNELS)
    memory = real(None, "delayed sums of the band-pass", shape=(2 * SECTIONS, CHANNELS))
    watched = real("s", "t, time that the covariance is the mean of")
    power = real(None, "S, covariance behind the band-pass", shape=(CHANNELS, CHANNELS))
    count = real(None, "samples since the gain was computed", min=0.0, max=LEARN_EVERY)
    gain = real(None, "K", shape=(3, CHANNELS))
    motion = real("m", "s", shape=3)


class Front(Derived):
    """Geometry, band-pass and noise."""

    section = real(None, "b_0, a_1 and a_2 of a section of the band-pass", shape=3)
    sharpness = real("s2.Hz0.5/m", "1 / N_i", shape=CHANNELS)
    sigma = real("Hz0.5", "of white noise of density 1 behind lag and band-pass")
    exact = real(None, "tip of A^-1, times D", shape=(3, CHANNELS))
    broad = real(None, "B P B^T", shape=(CHANNELS, CHANNELS))


def undo(lag: Any, frequencies: Any) -> Pair:
    """Return U, from the acceleration written as displacement to displacement.

    Args:
        lag: tau_s [s].
        frequencies: f, (n,) [Hz].
    """
    integrated = (CENTRE / frequencies) ** 2
    return integrated, integrated * (2 * np.pi * lag) * frequencies


def lever_rows(geometry: kinematics.Geometry) -> Any:
    """Return A, (6, 6): channels by acceleration of the tip and angular acceleration, in B."""
    rows = []
    for site, axis in kinematics.PLACES:
        unit = ca.DM(np.eye(3)[axis])
        lever = geometry.sites[site] - geometry.tip
        rows.append(ca.horzcat(unit.T, ca.cross(lever, unit).T))
    return ca.vertcat(*rows)


def exact_tip(geometry: kinematics.Geometry) -> Any:
    """Return the tip rows of A^-1, (3, 6): acceleration of the tip as all channels determine it."""
    to_alpha = ca.solve(kinematics.lever_matrix(geometry), ca.DM.eye(3))
    columns = []
    for unit in np.eye(CHANNELS):
        alpha = to_alpha @ kinematics.differences(ca.DM(unit))
        columns.append(
            kinematics.tip_force(ca.DM(unit), alpha, ca.DM.zeros(3), geometry, ca.DM.ones(CHANNELS))
        )
    return ca.horzcat(*columns)


def derive(p: Sensing, T: float) -> Front:
    """Compute what follows from the parameters.

    Args:
        p: geometry and noise.
        T: sample period [s].
    """
    low, high = (np.tan(np.pi * f * T) for f in BAND)
    width, square = high - low, low * high
    total = 1 + width + square
    # |section|^2 at the frequencies of the grid, by the tangent of half the angle of a sample
    t = np.tan(np.pi * GRID * T)
    aside = (t**2 - square) / (width * t)
    lagged = 1 / (1 + (2 * np.pi * p.lag * ca.DM(GRID)) ** 2)
    geometry = kinematics.Geometry.of(p.geometry)
    levers = lever_rows(geometry) / ca.repmat(p.density, 1, CHANNELS)
    return Front(
        section=ca.DM([width, 2 * (square - 1), 1 - width + square]) / total,
        sharpness=1 / p.density,
        sigma=ca.sqrt((GRID[1] - GRID[0]) * ca.DM((1 + aside**2) ** -SECTIONS).T @ lagged),
        exact=exact_tip(geometry) * ca.repmat(p.density.T, 3, 1),
        broad=levers @ ca.diag(ca.DM(PRIOR)) @ levers.T,
    )


def _gain() -> ca.Function:
    """Record (power, watched, exact, broad) -> K D."""
    power, broad = (ca.MX.sym(name, CHANNELS, CHANNELS) for name in ("power", "broad"))
    exact, watched = ca.MX.sym("exact", 3, CHANNELS), ca.MX.sym("watched")
    one = ca.DM.eye(CHANNELS)
    size = ca.fmax(ca.trace(power) - CHANNELS, LEAST_POWER * CHANNELS)
    level = BROADER * size / ca.trace(broad)
    seen = (PRIOR_TIME * (one + level * broad) + watched * power) / (PRIOR_TIME + watched)
    X = one - ca.solve(seen, one, "ldl")
    square = X @ X
    gain = ca.solve(square + DOUBT**2 * one, square @ X, "ldl")
    return ca.Function("wiener_gain", [power, watched, exact, broad], [exact @ gain])


WIENER_GAIN = _gain()


def sense(derived: Front, force: Any, valid: Any, x: Sensed, T: float) -> tuple[Sensed, Any]:
    """Learn from one sample and return how the tip has moved.

    Args:
        derived: what follows from the parameters.
        force: f, (6,) [m/s2].
        valid: whether it can be trusted.
        x: state.
        T: sample period [s].

    Returns:
        State, and the motion of the tip in B as displacement at f_c, (3,) [m].
    """
    changed = since(force, valid, x)
    moved = motion(x, changed)

    b0, a1, a2 = (derived.section[i] for i in range(3))
    change = x.change + changed
    sections: Any = [(b0, 0.0, -b0, a1, a2)] * SECTIONS
    delayed, passed = elliptic.cascade(change, x.memory, sections)
    b = passed * derived.sharpness / derived.sigma
    watched = ca.fmin(x.watched + valid * T, MEMORY)
    power = x.power + valid * T / (watched + LEAST_TIME) * (b @ b.T - x.power)
    learnt = WIENER_GAIN(power, watched, derived.exact, derived.broad)
    gain = ca.if_else(x.count == 0, learnt * ca.repmat(derived.sharpness.T, 3, 1), x.gain, True)
    following = Sensed(
        tracked=valid,
        force=ca.if_else(valid, force, x.force),
        change=change,
        memory=delayed,
        watched=watched,
        power=power,
        count=ca.if_else(x.count + 1 >= LEARN_EVERY, 0, x.count + 1),
        gain=gain,
        motion=moved,
    )
    return following, moved


def since(force: Any, valid: Any, x: Sensed) -> Any:
    """Return the change of the forces since the last sample, (6,) [m/s2]; zero over a gap."""
    return ca.if_else(ca.logic_and(x.tracked, valid), force - x.force, 0)


def motion(x: Sensed, changed: Any) -> Any:
    """Return s, (3,) [m], from the change of the forces in a sample, (6,) [m/s2]."""
    return x.motion - x.gain @ changed / (2 * np.pi * CENTRE) ** 2
