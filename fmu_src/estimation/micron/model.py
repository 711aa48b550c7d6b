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
from fmu_src.filters import triad
from fmu_src.kit import Model, Outputs, Parameters, State
from fmu_src.kit.lazy_select import either
from fmu_src.kit.records import Derived, Inputs, boolean, integer, real
from fmu_src.math import rotations

FADING = 0.02
"""Time constant by which alpha and the tip's acceleration fade without samples [s]."""
TURN = 0.3
"""Time that a hand turns one way [s]."""
UNUSED = 1e4
"""Variance of what is not measured; no larger, for the sake of single precision."""
AGREEMENT = np.radians(10.0)
"""Within which TRIAD of two samples must agree for the filter to start [rad]."""
SETTLING = 0.1
"""Share of what a hand can do that is possible while it settles, nearly at rest."""
ZERO_MEMORY = 5.0
"""Time constant by which the zero of A_D is learned at rest [s]."""
LEAST_NORTH = 0.1
"""Level part of the unit field below which it has no north to speak of: 6 deg from the vertical."""


class Params(Parameters):
    """Everything that is known beforehand."""

    geometry: Any = kinematics.Layout
    accelerometer = compensation.Accelerometer
    magnetometer = compensation.Magnetometer
    thermometer = compensation.Thermometer
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
    """What follows from the parameters alone."""

    rate_gain = real("1/m", "from A_D to alpha", shape=(3, 3))
    rate_noise = real("rad2/s2", "Xi_w, covariance of the rate's white part", shape=(3, 3))
    bias_noise = real("rad2/s2", "Xi_b, covariance that one sample adds to the bias", shape=(3, 3))
    integrator = real(None, "tip motion, state matrix", shape=(3, 3))
    integrator_input = real(None, "tip motion, input column", shape=3)
    alignment = compensation.Alignment


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
    q = real(None, "attitude q_WB", shape=4, start=(1, 0, 0, 0))
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
    channels = plausibility.Channels
    field = plausibility.Field
    rest = plausibility.Rest


class Out(Outputs):
    """Pose, tip motion, compensated channels, and how far to believe them."""

    attitude = real(None, "attitude q_WB", shape=4, axes="wxyz", start=(1, 0, 0, 0))
    rate = real("rad/s", "body rate in B, bias removed", shape=3, axes="xyz")
    rate_bias = real("rad/s", "bias of the integrated rate in B", shape=3, axes="xyz")
    tip_acceleration = real("m/s2", "tip acceleration in W without gravity", shape=3, axes="xyz")
    tip_velocity = real("m/s", "tip velocity in W, washed out", shape=3, axes="xyz")
    tip_displacement = real("m", "tip displacement in W, washed out", shape=3, axes="xyz")
    valid = boolean("the outputs may be used")
    innovation = real("rad", "attitude measured minus predicted, in B", shape=3, axes="xyz")
    innovation_squared = real(
        None,
        "normalised innovation squared of what was taken in; its mean is innovation_size when the"
        " model holds",
        min=0.0,
    )
    innovation_size = real(
        None, "degrees of freedom that were taken in: vertical 2, north 1", min=0.0, max=3.0
    )
    attitude_sigma = real(
        "rad", "standard deviation of the attitude error in B", shape=3, axes="xyz", min=0.0
    )
    rate_bias_sigma = real(
        "rad/s", "standard deviation of the rate's bias in B", shape=3, axes="xyz", min=0.0
    )
    magnetic_disturbance = boolean("the field is not believed, and north is not corrected")
    acceleration_disturbance = boolean("the hand accelerates: the vertical counts less or nothing")
    at_rest = boolean("the instrument rests")
    frozen = boolean("a channel repeats itself to the bit")
    clipped = boolean("a channel is at the end of its range")
    force = real("m/s2", "compensated specific force", shape=6, axes=kinematics.CHANNELS)
    field = real(None, "unit magnetic field in B", shape=3, axes="xyz")


def _densities(p: Any) -> tuple[Any, Any]:
    """(S_A, S_r); the weakest channel stands for all, since A_D mixes them."""
    return ca.mmax(p.accelerometer.density) ** 2, p.roll_density**2


def derive(p: Any, T: float) -> Gains:
    """Gains and noise that hold as long as the parameters do."""
    S_A, S_r = _densities(p)
    geometry = kinematics.Geometry.of(p.geometry)
    gain = kinematics.rate_gain(geometry, S_A, S_r)
    P_D = kinematics.lever_matrix(geometry)

    def alpha_error(s: Any) -> Any:
        """Error of alpha for noise of A_D, s[:3], and roll of the hand, s[3]."""
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


def step(p: Any, u: Any, x: Any, T: float, derived: Any) -> tuple[X, Out]:
    """One sample of the sensors."""
    geometry = kinematics.Geometry.of(p.geometry)
    variances = p.accelerometer.density**2
    gates = p.gates

    # Compensation (A04 3.2)
    at = (u.temperature, p.thermometer.reference, derived.alignment)
    f = compensation.specific_forces(p.accelerometer, u.volts[:6], *at)
    field = compensation.magnetic_field(p.magnetometer, u.volts[6:], *at)
    strength = ca.sqrt(ca.sumsqr(field) + p.magnetometer.sigma**2)
    n_B = field / strength
    A_D = kinematics.differences(f)
    gravity_B = kinematics.compound(f, variances)
    weight = ca.sqrt(ca.sumsqr(gravity_B) + 1e-12)
    z_B = gravity_B / weight

    # What of the sample there is
    alive = plausibility.alive(u.volts, u.inertial_valid, f, field, gates, x.channels)
    heard_force, heard_field = alive.force, alive.field
    dead_field = ca.logic_and(u.inertial_valid, ca.logic_not(alive.field))
    upright = ca.logic_and(weight > 0.5 * p.gravity, weight < 1.5 * p.gravity)
    across = ca.sumsqr(ca.cross(z_B, n_B)) > LEAST_NORTH**2
    complete = ca.logic_and(ca.logic_and(heard_force, heard_field), ca.logic_and(upright, across))

    # Start, and start anew after a long time without a vertical
    z = triad.attitude(z_B, n_B)
    dip_measured = plausibility.dip(ca.dot(z_B, n_B))
    # Nearly at rest, a start without a vertical was a wrong one.
    young = x.age < p.settling
    lost = x.off_vertical > ca.if_else(young, gates.start_patience, gates.tilt_patience)
    familiar = plausibility.as_it_was(strength, dip_measured, gates, x.field)
    again = ca.logic_and(ca.logic_and(lost, complete), ca.logic_or(young, familiar))
    agrees = ca.sumsqr(attitude_filter.innovation(x.q, z)) < AGREEMENT**2
    going = ca.logic_and(
        ca.logic_and(x.started, ca.logic_or(x.confirmed, agrees)), ca.logic_not(again)
    )
    anew = ca.logic_not(going)
    age = ca.if_else(going, x.age + T, T * complete)

    # Differential sensing kinematics; offsets of the channels would make the rate's bias a ramp
    samples = x.age / T
    swing = gates.difference * ca.if_else(young, SETTLING, 1)
    possible = ca.logic_or(anew, ca.mmax(ca.fabs(A_D - x.zero)) < swing)
    usable = ca.logic_and(heard_force, possible)
    zero = ca.if_else(
        ca.logic_and(young, ca.logic_and(going, usable)),
        (samples * x.zero + A_D) / (samples + 1),
        ca.if_else(ca.logic_and(anew, p.settling > 0), A_D, x.zero),
    )
    (sensed,) = either(
        "angular_acceleration",
        p.method == 0,
        lambda gain, left, *_: [gain @ left],
        lambda _, left, w, layout, S: [
            kinematics.angular_acceleration(
                left, w, kinematics.Geometry.of(kinematics.Layout.unpack(layout)), (S[0], S[1]), T
            )
        ],
        derived.rate_gain,
        A_D - zero,
        x.w_i - x.b,
        p.geometry.pack(),
        ca.vertcat(*_densities(p)),
    )
    fade = np.exp(-T / FADING)
    alpha = ca.if_else(usable, sensed, fade * x.alpha)
    w_i = ca.if_else(going, x.w_i + T / 2 * (alpha + x.alpha), 0)
    tau = p.accelerometer.lag
    rate_measured = w_i + tau * alpha

    # Prediction over the sample that has passed
    white = ca.sum1(variances) / 6 / (4 * ca.fmax(tau, T / 2)) / 2
    sigma_N = ca.sqrt(p.magnetometer.sigma**2 + p.magnetometer.residue**2) / strength
    unknown = ca.if_else(usable, 0, T / 2 * p.hand_rotation**2)
    W = ca.diagcat(T**2 * derived.rate_noise, derived.bias_noise + unknown * ca.SX.eye(3))
    b_before = ca.if_else(going, x.b, 0)
    w_predict = rate_measured - b_before
    q_predicted = attitude_filter.predict_attitude(x.q, w_predict, T)
    P = attitude_filter.predict_covariance(x.P, w_predict, W, T)
    R = rotations.matrix(q_predicted)
    up_B = R[2, :].T
    heading = ca.diagcat(up_B @ up_B.T, up_B @ up_B.T)
    everything = ca.SX.eye(6)

    # Vertical, whose covariance follows what the hand does
    P_W = R @ P[:3, :3] @ R.T
    strange = ca.sumsqr(gravity_B - p.gravity * up_B) / 3
    share = T / gates.agitation_time * usable
    agitation = ca.if_else(anew, 0, x.agitation + share * (strange - x.agitation))
    hand = p.hand_acceleration**2
    tilted = p.gravity**2 * (P_W[0, 0] + P_W[1, 1]) / 3
    excess = ca.fmax(agitation - 2 * (hand + white) - tilted, 0)
    excess = ca.fmin(excess, gates.force**2)
    still = ca.logic_and(usable, ca.fabs(weight - p.gravity) < gates.force)
    tilt_residual = attitude_filter.tilt_innovation(R @ z_B)
    variance = (white + hand) / weight**2
    tilt = attitude_filter.correct(
        P,
        tilt_residual,
        ca.horzcat(R[:2, :], ca.SX.zeros(2, 3)),
        (variance + excess * gates.coherence / T / weight**2) * ca.SX.eye(2),
        ca.logic_and(going, still),
        gates.sigma,
        ca.if_else(p.decoupled, everything - heading, everything),
    )
    # A wrong vertical stays wrong, whatever acceleration it is mistaken for; a hand turns back.
    spread = variance + ca.fmax(P_W[0, 0], P_W[1, 1])
    met = ca.logic_and(still, ca.sumsqr(tilt_residual) < gates.sigma**2 * spread)
    off_vertical = ca.if_else(ca.logic_or(anew, met), 0, x.off_vertical + T)

    # North
    field_W = R @ n_B
    north_residual, H_north = attitude_filter.north_innovation(field_W)
    dip = ca.if_else(ca.logic_or(lost, anew), dip_measured, plausibility.dip(field_W[2]))
    accepted = plausibility.accepted(gates, x.field)
    as_it_was = ca.logic_or(accepted, plausibility.as_it_was(strength, dip, gates, x.field))
    level = ca.sumsqr(field_W[:2])
    has_north = level > LEAST_NORTH**2
    level_of_north = ca.fmax(level, LEAST_NORTH**2)
    opened = (np.pi / 2) ** 2 * accepted
    # Far from level the vertical's turn is one about the wrong axis by its square.
    opened = opened + ca.sumsqr(tilt.change[:3]) ** 2
    north = attitude_filter.correct(
        tilt.P + opened * ca.diagcat(heading[:3, :3], ca.SX.zeros(3, 3)),
        north_residual - H_north @ (R @ tilt.change[:3]),
        ca.horzcat(H_north @ R, ca.SX.zeros(1, 3)),
        sigma_N**2 / level_of_north,
        ca.logic_and(
            ca.logic_and(going, ca.logic_and(heard_field, has_north)),
            ca.logic_and(as_it_was, ca.logic_or(accepted, x.field.doubt <= 0)),
        ),
        gates.sigma,
        ca.if_else(p.decoupled, heading, everything),
    )
    believed = ca.logic_and(as_it_was, north.squared <= gates.sigma**2)
    field_state = plausibility.follow_field(
        strength,
        dip,
        dip_measured,
        heard_field,
        dead_field,
        believed,
        anew,
        x.age,
        gates,
        x.field,
        T,
    )

    # At rest there is no rate, and a hand that is not seen does not turn on and on. What lasts for
    # a time is the same in all samples of it.
    noise = ca.vertcat(white, 4 * white, p.magnetometer.sigma**2 + p.magnetometer.residue**2)
    rest_state, at_rest = plausibility.follow_rest(
        ca.horzcat(gravity_B, A_D, field),
        noise,
        ca.logic_and(usable, heard_field),
        anew,
        gates,
        x.rest,
        T,
    )
    resting = gates.rest_rate**2 * gates.rest_time / T
    turning = p.hand_rate**2 * TURN / T
    about_level = ca.if_else(at_rest, resting, ca.if_else(tilt.taken, UNUSED, turning))
    about_up = ca.if_else(at_rest, resting, ca.if_else(north.taken, UNUSED, turning))
    caught = ca.logic_and(plausibility.caught(heard_field, dead_field, believed, x.field), going)
    up = heading[:3, :3]
    change = tilt.change + north.change
    widened = north.P + caught * ca.diagcat(
        gates.field**2 / level_of_north * up, p.hand_rate**2 * up
    )
    # Which the rate is told of: all, about the vertical, or about the level axes alone.
    of_all = ca.logic_or(at_rest, ca.logic_not(ca.logic_or(tilt.taken, north.taken)))
    of_up = ca.logic_and(ca.logic_not(of_all), tilt.taken)

    def told(P: Any, residual: Any, up_B: Any, variances: Any, flags: Any) -> list[Any]:
        up = up_B @ up_B.T
        heading = ca.diagcat(up, up)
        corrected = attitude_filter.correct(
            P,
            residual,
            ca.horzcat(ca.SX.zeros(3, 3), ca.SX.eye(3)),
            variances[0] * (ca.SX.eye(3) - up) + variances[1] * up,
            onto=ca.if_else(
                flags[0], everything, ca.if_else(flags[1], heading, everything - heading)
            ),
        )
        return [corrected.P, corrected.change]

    P_rest, change_rest = either(
        "rate_known",
        ca.logic_and(
            going, ca.logic_or(at_rest, ca.logic_not(ca.logic_and(tilt.taken, north.taken)))
        ),
        told,
        lambda P, *_: [P, ca.SX.zeros(6)],
        widened,
        rate_measured - b_before - change[3:],
        up_B,
        ca.vertcat(about_level, about_up),
        ca.vertcat(of_all, of_up),
    )
    change = change + change_rest
    follow = ca.if_else(at_rest, T / ZERO_MEMORY, T / p.zero_memory)
    followed = ca.logic_and(ca.logic_and(going, usable), ca.logic_not(young))
    zero = zero + followed * follow * (A_D - zero)

    q = ca.if_else(going, attitude_filter.moved(q_predicted, change), ca.if_else(complete, z, x.q))
    b = b_before + ca.if_else(going, change[3:], 0)
    sigma_G = ca.sqrt(white + hand) / weight
    P_start = ca.diagcat(
        triad.covariance(z_B, n_B, sigma_G, sigma_N), p.bias_start**2 * ca.SX.eye(3)
    )
    P = ca.if_else(going, P_rest, ca.if_else(complete, P_start, x.P))
    rate = rate_measured - b

    # Tip motion: gravity removed before any integration (A04 2.26 with its sign)
    force = kinematics.tip_force(f, alpha, rate, geometry, variances)
    # Specific force and attitude must be of one age: gravity turns in the body while it is lagged.
    q_lagged = attitude_filter.predict_attitude(q, w_i - b, -tau)
    a = rotations.matrix(q_lagged) @ force - ca.vertcat(0, 0, p.gravity)
    a = ca.if_else(usable, a, fade * x.a)
    a_before = ca.if_else(going, x.a, a)
    blank = ca.vertcat(a.T, ca.SX.zeros(2, 3))
    motion = ca.if_else(
        going,
        tip_motion.advance(x.motion, derived.integrator, derived.integrator_input, a, a_before),
        blank,
    )
    velocity = motion[1, :].T + tau * (a - motion[0, :].T)
    displacement = motion[2, :].T + tau * motion[1, :].T
    # Lead (1 + tau s) / (1 + s / w_a), trapezoidal
    slow = 1 / (2 * ca.pi * p.acceleration_bandwidth)
    lead = (2 * tau / T * (a - a_before) + a + a_before - (1 - 2 * slow / T) * x.a_wide) / (
        1 + 2 * slow / T
    )
    a_wide = ca.if_else(going, lead, a)

    outage = ca.if_else(usable, 0, x.outage + T)
    P_W = R @ P[:3, :3] @ R.T
    known = ca.logic_and(
        ca.fmax(P_W[0, 0], P_W[1, 1]) < gates.tilt_limit**2, P_W[2, 2] < gates.heading_limit**2
    )
    settled = ca.logic_and(going, age >= p.settling)
    valid = ca.logic_and(
        ca.logic_and(settled, known),
        ca.logic_and(
            ca.logic_and(
                ca.logic_or(upright, ca.logic_not(usable)),
                excess < (gates.tilt_limit * p.gravity) ** 2,
            ),
            ca.logic_and(outage <= gates.outage, off_vertical <= gates.tilt_outage),
        ),
    )
    shown = ca.vertcat(
        tilt.taken * tilt_residual,
        north.taken * (north_residual - H_north[:2] @ tilt_residual),
    )

    return (
        X(
            age=age,
            started=ca.logic_or(going, complete),
            confirmed=going,
            q=q,
            w_i=w_i,
            b=b,
            zero=zero,
            P=P,
            alpha=alpha,
            a=a,
            a_wide=a_wide,
            motion=motion,
            agitation=agitation,
            off_vertical=off_vertical,
            outage=outage,
            channels=alive.following,
            field=field_state,
            rest=rest_state,
        ),
        Out(
            attitude=rotations.canonical(q),
            rate=rate,
            rate_bias=b,
            tip_acceleration=a_wide,
            tip_velocity=velocity,
            tip_displacement=displacement,
            valid=valid,
            innovation=R.T @ shown,
            innovation_squared=ca.fmax(tilt.taken * tilt.squared + north.taken * north.squared, 0),
            innovation_size=2 * tilt.taken + north.taken,
            attitude_sigma=ca.sqrt(ca.fmax(ca.diag(P)[:3], 0)),
            rate_bias_sigma=ca.sqrt(ca.fmax(ca.diag(P)[3:], 0)),
            magnetic_disturbance=ca.logic_and(
                going, ca.logic_and(u.inertial_valid, ca.logic_not(north.taken))
            ),
            acceleration_disturbance=ca.logic_and(
                going,
                ca.logic_and(usable, ca.logic_or(ca.logic_not(tilt.taken), excess > 0)),
            ),
            at_rest=at_rest,
            frozen=alive.frozen,
            clipped=alive.clipped,
            force=f,
            field=n_B,
        ),
    )


MODEL = Model(
    "MicronEstimator",
    step,
    Params,
    In,
    X,
    Out,
    sample_period=1e-3,
    derived=Gains,
    derive=derive,
)
