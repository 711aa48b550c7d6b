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
sensors; attitude and bias by the augmented-state filter with TRIAD as its measurement; the tip's
specific force from all channels, gravity removed, integrated twice with a wash-out.

Process noise is found by the unscented transformation of the channel noise, and of the roll that
the prior suppresses, through alpha (A04 4.4.3.3): one sample adds T alpha to w_I, hence to the
bias, and tau alpha is the white part of the rate.

Over the first `settling` seconds the instrument is nearly at rest (A04 2.3.1.1 starts so, too); the
mean of A_D over that time is taken as its zero, because offsets of some mg would give the rate a
bias that runs away faster than the filter follows.

`valid` is true when the filter has settled and the sensors are inside what a hand-held instrument
shows: specific force near gravity, a field that is not vertical.
"""

from typing import Any

import casadi as ca

from fmu_src.estimation import attitude_filter, compensation, tip_motion, triad
from fmu_src.kit import (
    Derived,
    Inputs,
    Model,
    Outputs,
    Parameters,
    State,
    boolean,
    design,
    integer,
    real,
    rotations,
)
from fmu_src.kit import sensing_kinematics as kinematics


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


class X(State):
    """Filter and integrators."""

    age = real("s", "time since the first sample")
    started = boolean("the first sample is past")
    q = real(None, "attitude q_WB", shape=4, start=(1, 0, 0, 0))
    w_i = real("rad/s", "integral of alpha", shape=3)
    b = real("rad/s", "bias of w_I", shape=3)
    zero = real("m/s2", "A_D at rest", shape=3)
    P = real(None, "covariance of attitude error and bias", shape=(6, 6))
    alpha = real("rad/s2", "angular acceleration", shape=3)
    a = real("m/s2", "tip acceleration in W, lagged", shape=3)
    a_wide = real("m/s2", "tip acceleration in W, lag put right", shape=3)
    motion = real(None, "m, v, d of the tip for each axis of W", shape=(3, 3))


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
        None, "normalised innovation squared; mean 3 when the model holds", min=0.0
    )
    attitude_sigma = real(
        "rad", "standard deviation of the attitude error in B", shape=3, axes="xyz", min=0.0
    )
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

    # Compensation (A04 3.2)
    at = (u.temperature, p.thermometer.reference, derived.alignment)
    f = compensation.specific_forces(p.accelerometer, u.volts[:6], *at)
    field = compensation.magnetic_field(p.magnetometer, u.volts[6:], *at)
    strength = ca.sqrt(ca.sumsqr(field) + p.magnetometer.sigma**2)
    n_B = field / strength

    # Differential sensing kinematics; offsets of the channels would make the rate's bias a ramp
    A_D = kinematics.differences(f)
    samples = x.age / T
    zero = ca.if_else(x.age < p.settling, (samples * x.zero + A_D) / (samples + 1), x.zero)
    alpha = ca.if_else(
        p.method == 0,
        derived.rate_gain @ (A_D - zero),
        kinematics.angular_acceleration(A_D - zero, x.w_i - x.b, geometry, _densities(p), T),
    )
    w_i = x.w_i + ca.if_else(x.started, T / 2 * (alpha + x.alpha), 0)
    tau = p.accelerometer.lag
    rate_measured = w_i + tau * alpha

    # Attitude measured by TRIAD (A04 4.4.4)
    gravity_B = kinematics.compound(f, variances)
    weight = ca.sqrt(ca.sumsqr(gravity_B) + 1e-12)
    z_B = gravity_B / weight
    white = ca.sum1(variances) / 6 / (4 * ca.fmax(tau, T / 2)) / 2
    sigma_G = ca.sqrt(white + p.hand_acceleration**2) / weight
    sigma_N = ca.sqrt(p.magnetometer.sigma**2 + p.magnetometer.residue**2) / strength
    z = triad.attitude(z_B, n_B)
    V = triad.covariance(z_B, n_B, sigma_G, sigma_N)

    # Prediction over the sample that has passed, and correction
    W = ca.diagcat(T**2 * derived.rate_noise, derived.bias_noise)
    w_predict = rate_measured - x.b
    q_predicted = attitude_filter.predict_attitude(x.q, w_predict, T)
    P_predicted = attitude_filter.predict_covariance(x.P, w_predict, W, T)
    residual = attitude_filter.innovation(q_predicted, z)
    q, b, P, squared = attitude_filter.correct(q_predicted, x.b, P_predicted, residual, V)
    P_start = ca.diagcat(V, p.bias_start**2 * ca.SX.eye(3))
    q = ca.if_else(x.started, q, z)
    b = ca.if_else(x.started, b, 0)
    P = ca.if_else(x.started, P, P_start)
    rate = rate_measured - b

    # Tip motion: gravity removed before any integration (A04 2.26 with its sign)
    force = kinematics.tip_force(f, alpha, rate, geometry, variances)
    # Specific force and attitude must be of one age: gravity turns in the body while it is lagged.
    q_lagged = attitude_filter.predict_attitude(q, w_i - b, -tau)
    a = rotations.matrix(q_lagged) @ force - ca.vertcat(0, 0, p.gravity)
    a_before = ca.if_else(x.started, x.a, a)
    blank = ca.vertcat(a.T, ca.SX.zeros(2, 3))
    motion = ca.if_else(
        x.started,
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
    a_wide = ca.if_else(x.started, lead, a)

    age = x.age + T
    settled = age >= p.settling
    upright = ca.logic_and(weight > 0.5 * p.gravity, weight < 1.5 * p.gravity)
    # A field within 6 degrees of the vertical has no north to speak of.
    has_north = ca.sumsqr(ca.cross(z_B, n_B)) > 0.01
    valid = ca.logic_and(settled, ca.logic_and(upright, has_north))

    return (
        X(
            age=age,
            started=1,
            q=q,
            w_i=w_i,
            b=b,
            zero=zero,
            P=P,
            alpha=alpha,
            a=a,
            a_wide=a_wide,
            motion=motion,
        ),
        Out(
            attitude=rotations.canonical(q),
            rate=rate,
            rate_bias=b,
            tip_acceleration=a_wide,
            tip_velocity=velocity,
            tip_displacement=displacement,
            valid=valid,
            innovation=ca.if_else(x.started, residual, 0),
            innovation_squared=ca.fmax(ca.if_else(x.started, squared, 0), 0),
            attitude_sigma=ca.sqrt(ca.fmax(ca.diag(P)[:3], 0)),
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
