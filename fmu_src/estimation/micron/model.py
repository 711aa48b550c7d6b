"""Pose and tip motion from the magnetometer-aided all-accelerometer unit (A04 2.3, 4.4).

| symbol | meaning |
| --- | --- |
| f | compensated specific forces of the six channels [m/s2] |
| n_B, z_B | unit vectors of the field and up, in B |
| alpha, w | angular acceleration and rate of B [rad/s2, rad/s] |
| w_I | integral of alpha: high resolution, drifting [rad/s] |
| b | its bias [rad/s] |
| q | attitude q_WB |
| tau | lag of the sensors' output filter, 15.2 Hz [s] |

At each sample: volts to f and n_B by the measurement model (`compensation`); alpha from
differences of f; w = w_I + tau alpha - b, where tau alpha puts the lag right that w_I has from the
sensors; attitude and bias by the augmented-state filter; the tip's specific force from all
channels, gravity removed, integrated twice with a wash-out.

The filter's measurement is TRIAD's attitude in its three independent numbers (A04 4.4.4): two of
the vertical, one of the field. It starts from TRIAD, once two samples agree. The vertical corrects
the tilt only, so that a hand's acceleration does not turn a north that is little known; the field
corrects the rotation about the vertical only, so that a magnet does not spoil the tilt that gravity
is removed with. With `decoupled` = false both correct what they do in TRIAD, where the field is
trusted more than the hand's unsteady vertical. Each is left out where `plausibility` or its own
innovation says so, and the covariance grows meanwhile. The covariance of the vertical is that of
sigma_C and of what the hand's acceleration is beyond it.

A lost, frozen, clipped or impossible sample is none: alpha and the tip's acceleration fade, and the
covariance grows by what a hand may do. Without a vertical or north the rate is 0 within what a hand
turns by, which keeps drift and covariance bounded; what a field that is caught has done to heading
and rate before is taken back from the covariance. While the instrument rests, its rate is 0 but for
`gates.rest_rate`.

Process noise is found by the unscented transformation of the channel noise, and of the roll that
the prior suppresses, through alpha (A04 4.4.3.3): one sample adds T alpha to w_I, hence to the
bias, and tau alpha is the white part of the rate.

Over the first `settling` seconds the instrument is nearly at rest (A04 2.3.1.1 starts so, too); the
mean of A_D over that time is taken as its zero, because offsets of some mg would give the rate a
bias that runs away faster than the filter follows. It is followed from then on, because a hand's
angular acceleration has no mean: quickly at rest, slowly otherwise.

`valid` is true when the filter has settled, knows vertical and north within limits, has had a
usable sample lately, and the specific force is near gravity. The other flags say why it may not be.
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import attitude_filter, compensation, plausibility, tip_motion
from fmu_src.estimation.micron.known_rate import correct_rate
from fmu_src.estimation.micron.north import correct_heading
from fmu_src.estimation.micron.prediction import Prediction, Turn, densities, predict, sense_turn
from fmu_src.estimation.micron.sample import Sample, compensate
from fmu_src.estimation.micron.start import Start, follow_start
from fmu_src.estimation.micron.vertical import Vertical, correct_tilt
from fmu_src.filters import triad
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, integer, quaternion, real, vector
from fmu_src.math import rotations

ZERO_MEMORY = 5.0
"""Time constant by which the zero of A_D is learned at rest [s]."""


class Params(Parameters):
    """Everything that is known beforehand."""

    geometry: Any = kinematics.Layout
    accelerometer: Any = compensation.Accelerometer
    magnetometer: Any = compensation.Magnetometer
    thermometer: Any = compensation.Thermometer
    gravity = real("m/s2", "gravity at the site", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    method = integer("alpha by: 0 linear solution, 1 nonlinear least squares", min=0, max=1)
    roll_density = real(
        "rad/s2/Hz0.5",
        "S_r^0.5, roll acceleration of a hand; 1e6 gives the plain inverse of P_D",
        start=kinematics.ROLL_DENSITY,
        min=1e-6,
        max=1e6,
    )
    hand_acceleration = real(
        "m/s2",
        "sigma_C, acceleration of the hand that the vertical is mistaken by (1 % of gravity)",
        start=0.01 * design.SITE_GRAVITY,
        min=1e-4,
        max=10.0,
    )
    hand_rotation = real(
        "rad/s2/Hz0.5",
        "angular acceleration of a hand, of which nothing is known without samples (guess)",
        start=0.4,
        min=0.0,
        max=1e3,
    )
    hand_rate = real(
        "rad/s",
        "rate of a hand, lasting for 0.3 s, while vertical or north are not known (guess)",
        start=0.1,
        min=1e-4,
        max=100.0,
    )
    decoupled = boolean(
        "the vertical corrects the tilt only, and the field the rotation about the vertical only;"
        " otherwise both correct all, as TRIAD does",
        start=True,
    )
    gates: Any = plausibility.Gates
    zero_memory = real(
        "s",
        "time constant by which the zero of the differences is followed after the settling, as a"
        " hand's angular acceleration has no mean; 1e9: never",
        start=20.0,
        min=1.0,
        max=1e9,
    )
    bias_start = real(
        "rad/s", "standard deviation of the rate at the start", start=0.05, min=1e-6, max=10.0
    )
    washout = real("Hz", "corner of the wash-out of the tip's motion", start=0.3, min=0.01, max=5.0)
    acceleration_bandwidth = real(
        "Hz", "band limit of the lag-compensated tip acceleration", start=60.0, min=1.0, max=400.0
    )
    settling = real(
        "s",
        "time at the start, nearly at rest, over which the differences of the channels are zeroed;"
        " the outputs are valid after it",
        start=1.0,
        min=0.0,
        max=60.0,
    )


class Gains(Derived):
    """Gains and noise, computed from the parameters."""

    rate_gain = real("1/m", "from A_D to alpha", shape=(3, 3))
    rate_noise = real("rad2/s2", "Xi_w, covariance of the rate's white part", shape=(3, 3))
    bias_noise = real("rad2/s2", "Xi_b, covariance that one sample adds to the bias", shape=(3, 3))
    integrator = real(None, "tip motion, state matrix", shape=(3, 3))
    integrator_input = real(None, "tip motion, input column", shape=3)
    alignment: Any = compensation.Alignment


class In(Inputs):
    """Sensor voltages of one instant."""

    volts = real(
        "V",
        "sensor output",
        start=design.ZERO_VOLTS,
        shape=9,
        axes=(*kinematics.CHANNELS, "mx", "my", "mz"),
        min=0.0,
        max=design.ADC_SPAN,
    )
    temperature: Any = compensation.TEMPERATURE
    inertial_valid = boolean("there is a sample at this instant; false: it was lost", start=True)


class X(State):
    """Filter and integrators."""

    age = real("s", "time since the start")
    started = boolean("a first sample is past")
    confirmed = boolean("a second one agrees with it")
    q = quaternion("attitude q_WB")
    w_i = real("rad/s", "integral of alpha", shape=3)
    b = real("rad/s", "bias of w_I", shape=3)
    zero = real("m/s2", "A_D at rest", shape=3)
    P = real(
        None,
        "covariance of attitude error and bias",
        shape=(6, 6),
        start=np.diag([np.pi**2] * 3 + [1.0] * 3),
    )
    alpha = real("rad/s2", "angular acceleration", shape=3)
    a = real("m/s2", "tip acceleration in W, lagged", shape=3)
    a_wide = real("m/s2", "tip acceleration in W, lag put right", shape=3)
    motion = real(None, "m, v, d of the tip for each axis of W", shape=(3, 3))
    agitation = real("m2/s4", "A, mean square of the hand's acceleration, for an axis")
    off_vertical = real("s", "time without a vertical")
    outage = real("s", "time without a usable specific force")
    channels: Any = plausibility.Channels
    field: Any = plausibility.Field
    rest: Any = plausibility.Rest


class Out(Outputs):
    """Pose, tip motion, compensated channels, and how far to believe them."""

    attitude = quaternion("attitude q_WB")
    rate = vector("rad/s", "body rate in B, bias removed")
    rate_bias = vector("rad/s", "bias of the integrated rate in B")
    tip_acceleration = vector("m/s2", "tip acceleration in W without gravity")
    tip_velocity = vector("m/s", "tip velocity in W, washed out")
    tip_displacement = vector("m", "tip displacement in W, washed out")
    valid = boolean("the outputs may be used")
    innovation = vector("rad", "attitude measured minus predicted, in B")
    innovation_squared = real(
        None,
        "normalised innovation squared of what was taken in; its mean is innovation_size when the"
        " model holds",
        min=0.0,
    )
    innovation_size = real(
        None, "degrees of freedom that were taken in: vertical 2, north 1", min=0.0, max=3.0
    )
    attitude_sigma = vector("rad", "standard deviation of the attitude error in B", min=0.0)
    rate_bias_sigma = vector("rad/s", "standard deviation of the rate's bias in B", min=0.0)
    magnetic_disturbance = boolean("the field is not believed, and north is not corrected")
    acceleration_disturbance = boolean("the hand accelerates: the vertical counts less or nothing")
    at_rest = boolean("the instrument rests")
    frozen = boolean("a channel repeats itself to the bit")
    clipped = boolean("a channel is at the end of its range")
    force = real("m/s2", "compensated specific force", shape=6, axes=kinematics.CHANNELS)
    field = vector(None, "unit magnetic field in B")


def derive(p: Params, T: float) -> Gains:
    """Return gains and noise that hold as long as the parameters do."""
    S_A, S_r = densities(p)
    geometry = kinematics.Geometry.of(p.geometry)
    gain = kinematics.rate_gain(geometry, S_A, S_r)
    P_D = kinematics.lever_matrix(geometry)

    def alpha_error(s: Any) -> Any:
        """Return the error of alpha for noise of A_D, s[:3], and roll of the hand, s[3]."""
        roll = ca.vertcat(0, 0, s[3])
        return gain @ (s[:3] + P_D @ roll) - roll

    # A density S is a variance S / 2 T of independent samples, and S / 4 tau behind the lag.
    roots = ca.sqrt(ca.vertcat(2 * S_A, 2 * S_A, 2 * S_A, S_r))
    sampled = ca.diag(roots / ca.sqrt(2 * T))
    lag = p.accelerometer.lag
    lagged = ca.diag(roots / (2 * ca.sqrt(ca.fmax(lag, T / 2))))
    A, B = tip_motion.discretise(2 * ca.pi * p.washout, T)
    return Gains(
        rate_gain=gain,
        rate_noise=attitude_filter.unscented_covariance(lambda s: lag * alpha_error(s), lagged),
        bias_noise=attitude_filter.unscented_covariance(lambda s: T * alpha_error(s), sampled),
        integrator=A,
        integrator_input=B,
        alignment=compensation.align(p.accelerometer, p.magnetometer),
    )


def step(p: Params, u: In, x: X, T: float, derived: Gains) -> tuple[X, Out]:
    """Return state and outputs after one sample of the sensors."""
    s = compensate(p, u, x, derived.alignment)
    start = follow_start(p, s, x, T)
    turn = sense_turn(p, s, start, x, T, derived.rate_gain)
    before = predict(p, s, start, turn, x, T, derived)
    tilt = correct_tilt(p, s, start, turn, before, x, T)
    north = correct_heading(p, s, start, before, tilt, x, T)
    known = correct_rate(p, s, start, turn, before, tilt, north, x, T)

    going, complete, usable = start.going, s.complete, turn.usable
    follow = ca.if_else(known.at_rest, T / ZERO_MEMORY, T / p.zero_memory)
    followed = ca.logic_and(ca.logic_and(going, usable), ca.logic_not(start.young))
    zero = turn.zero + followed * follow * (s.A_D - turn.zero)
    moved = attitude_filter.moved(before.q, known.change)
    q = ca.if_else(going, moved, ca.if_else(complete, start.z, x.q))
    b = before.b + ca.if_else(going, known.change[3:], 0)
    P_start = ca.diagcat(
        triad.covariance(s.z_B, s.n_B, tilt.sigma, before.sigma_N),
        p.bias_start**2 * ca.SX.eye(3),
    )
    P = ca.if_else(going, known.P, ca.if_else(complete, P_start, x.P))
    tip = tip_motion.follow_tip(p, s, start, turn, q, b, x, T, derived)
    outage = ca.if_else(usable, 0, x.outage + T)
    state = X(
        age=start.age,
        started=ca.logic_or(going, complete),
        confirmed=going,
        q=q,
        w_i=turn.w_i,
        b=b,
        zero=zero,
        P=P,
        alpha=turn.alpha,
        a=tip.a,
        a_wide=tip.a_wide,
        motion=tip.motion,
        agitation=tilt.agitation,
        off_vertical=tilt.off_vertical,
        outage=outage,
        channels=s.alive.following,
        field=north.state,
        rest=known.state,
    )
    taken = (tilt.correction.taken, north.correction.taken)
    used = ca.vertcat(
        taken[0] * tilt.residual,
        taken[1] * (north.residual - north.H[:2] @ tilt.residual),
    )
    nis = taken[0] * tilt.correction.nis + taken[1] * north.correction.nis
    return state, Out(
        attitude=rotations.canonical(q),
        rate=turn.rate_measured - b,
        rate_bias=b,
        tip_acceleration=tip.a_wide,
        tip_velocity=tip.velocity,
        tip_displacement=tip.displacement,
        valid=_valid(p, s, start, turn, before, tilt, P, outage),
        innovation=before.R.T @ used,
        innovation_squared=ca.fmax(nis, 0),
        innovation_size=2 * taken[0] + taken[1],
        attitude_sigma=ca.sqrt(ca.fmax(ca.diag(P)[:3], 0)),
        rate_bias_sigma=ca.sqrt(ca.fmax(ca.diag(P)[3:], 0)),
        magnetic_disturbance=ca.logic_and(
            going, ca.logic_and(u.inertial_valid, ca.logic_not(taken[1]))
        ),
        acceleration_disturbance=ca.logic_and(
            going, ca.logic_and(usable, ca.logic_or(ca.logic_not(taken[0]), tilt.excess > 0))
        ),
        at_rest=known.at_rest,
        frozen=s.alive.frozen,
        clipped=s.alive.clipped,
        force=s.f,
        field=s.n_B,
    )


def _valid(
    p: Any,
    s: Sample,
    start: Start,
    turn: Turn,
    before: Prediction,
    tilt: Vertical,
    P: Any,
    outage: Any,
) -> Any:
    """Return whether the outputs may be used."""
    gates = p.gates
    P_W = before.R @ P[:3, :3] @ before.R.T
    known = ca.logic_and(
        ca.fmax(P_W[0, 0], P_W[1, 1]) < gates.tilt_limit**2, P_W[2, 2] < gates.heading_limit**2
    )
    settled = ca.logic_and(start.going, start.age >= p.settling)
    return ca.logic_and(
        ca.logic_and(settled, known),
        ca.logic_and(
            ca.logic_and(
                ca.logic_or(s.upright, ca.logic_not(turn.usable)),
                tilt.excess < (gates.tilt_limit * p.gravity) ** 2,
            ),
            ca.logic_and(outage <= gates.outage, tilt.off_vertical <= gates.tilt_outage),
        ),
    )


MODEL = Model.of_step("MicronEstimator", step, sample_period=1e-3, derive=derive)
