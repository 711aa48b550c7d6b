"""Parameters, ports and memory of the filter."""

from typing import Any

import numpy as np

from fmu_src.device import design
from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.estimation.em_ekf.state import SPACE, Nominal
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.records import Inputs, boolean, quaternion, real, vector


class Inertial(Parameters):
    """Gyro and accelerometer."""

    rate_noise = real(
        "rad/s/Hz0.5", "one-sided density of the gyro's noise", start=1.75e-4, min=1e-8, max=1.0
    )
    rate_scale = real(
        None,
        "relative error of the gyro's scale and alignment, as noise over a second",
        start=3e-3,
        min=0.0,
        max=0.2,
    )
    bias_walk = real("rad/s1.5", "density of the walk of b", start=3e-6, min=0.0, max=1.0)
    bias_sigma = real("rad/s", "of b at the start", start=0.02, min=0.0, max=1.0)
    moving_rate = ports.MOVING_RATE
    force_noise = real(
        "m/s2/Hz0.5",
        "one-sided density of the accelerometer's noise",
        start=3e-3,
        min=1e-8,
        max=10.0,
    )
    force_bias_sigma = real("m/s2", "of b_a at the start", start=0.03, min=0.0, max=5.0)
    force_bias_walk = real("m/s2.5", "density of the walk of b_a", start=1e-5, min=0.0, max=1.0)
    hand_density = real(
        "m/s2/Hz0.5",
        "one-sided density of acceleration that is taken for tilt",
        start=0.02,
        min=0.0,
        max=10.0,
    )
    hand_gain = real(
        None, "how much a seen acceleration counts as noise of gravity", start=3.0, min=0.0, max=100
    )
    gravity = real("m/s2", "length of g", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    quiet = real(
        "m/s2",
        "departure of the specific force from g below which hard switching believes in gravity",
        start=0.1,
        min=0.0,
        max=10.0,
    )
    interval = real("s", "over which forces and fields are averaged", start=0.01, min=1e-3, max=1.0)


class Magnetic(Parameters):
    """Magnetometer."""

    used = boolean("whether there is one", start=True)
    strength = real(
        "T", "of the field at the site", start=design.MAGNETIC_FIELD, min=1e-6, max=1e-3
    )
    inclination = real("rad", "dip of the field", start=design.MAGNETIC_INCLINATION, within=1.5)
    noise = real("T/Hz0.5", "one-sided density of its noise", start=8.5e-8, min=0.0, max=1e-4)
    heading_density = real(
        "rad/Hz0.5",
        "one-sided density of what disturbs the heading, slow as it is",
        start=0.05,
        min=1e-6,
        max=10.0,
    )
    disturbed_density = real(
        "rad/Hz0.5",
        "the same where strength or dip tell iron: a heading is better than none",
        start=1.0,
        min=1e-6,
        max=1e3,
    )
    strength_limit = real(
        None, "departure from the strength, relative, that tells iron", start=0.08, min=0, max=1
    )
    dip_limit = real(
        "rad", "departure from the dip that tells iron", start=np.radians(5), min=0.0, max=3.0
    )
    hold = real(
        "s",
        "longest time for which strength and dip must fit before a field that showed iron counts"
        " again",
        start=2.0,
        min=0.0,
        max=60.0,
    )


class Tracker(Parameters):
    """Electromagnetic tracker, and how it is fixed to the unit and the world."""

    sigma = real("rad", "jitter s of an axis", start=np.radians(0.1), min=1e-6, max=1.0)
    generator = real(
        "m", "place of the field generator in F", shape=3, start=(0.3, 0, 0), within=10
    )
    jitter_distance = real("m", "distance x_0 of double jitter", start=0.4, min=0.01, max=1e3)
    distortion_sigma = real("rad", "of d, each axis", start=np.radians(0.4), min=0.0, max=1.0)
    distortion_angle = real(
        "rad", "turn after which d is another one", start=0.35, min=1e-3, max=100.0
    )
    distortion_time = real("s", "time after which d is another one", start=20.0, min=1e-2, max=1e5)
    mounting = real("rad", "rotation vector of h", shape=3, within=4.0)
    mounting_sigma = real("rad", "of h", start=0.0, min=0.0, max=1.0)
    registration = real("rad", "rotation vector of r", shape=3, within=4.0)
    registration_sigma = real("rad", "of r", start=0.0, min=0.0, max=1.0)
    lag = real(
        "s", "t_g, by which the inertial unit is behind the tracker's clock", start=0.0, within=0.05
    )
    gate = ports.gate("an attitude counts less")
    astray = ports.astray(2.0)
    patience = ports.patience(0.2)
    hard_switching = boolean("whether it is used only where gravity or field are not (RK III.D)")


class Params(Parameters):
    """Everything that is known beforehand."""

    limits: Any = sources.Limits
    inertial: Any = Inertial
    magnetic: Any = Magnetic
    tracker: Any = Tracker
    wait = real(
        "s", "for the tracker, before gravity and field start the filter", start=0.3, min=0, max=60
    )
    attitude_limit = ports.attitude_limit(0.02)


class In(Inputs):
    """Samples of both."""

    rate = ports.RATE
    force = ports.FORCE
    field = vector("T", "magnetometer, B", within=1.0)
    inertial_valid = ports.INERTIAL_VALID
    em_position = vector("m", "coils in F", within=100.0)
    em_attitude = ports.tracked_attitude("C in F")
    em_new = boolean("an attitude arrives at this instant")
    em_age = real("s", "its age on arrival", start=0.025, min=0.0, max=10.0)


class Gathered(State):
    """Sums over the samples since the last correction, in the body as it is now."""

    turn = quaternion("quaternion turned through")
    angle = real("rad", "angle turned through", min=0.0)
    variance = real("rad2", "what the gyro's noise added, each axis", min=0.0)
    time = real("s", "since the covariance was carried on", min=0.0)
    waited = real("s", "since gravity and field were taken", min=0.0)
    sums = real(None, "sum of forces and fields", shape=6)
    count = real(None, "samples in it", min=0.0)


class Acceleration(State):
    """Acceleration seen in the specific force."""

    slow = real("m/s2", "slow mean of the specific force in W", shape=3)
    level = real("m/s2", "departure from it, falling slowly", min=0.0)
    seen = boolean("whether there is a slow mean")


class X(State):
    """Filter, and what is kept of the samples."""

    nominal: Any = Nominal
    P = SPACE.covariance()
    started = boolean("whether the filter has an attitude")
    age = real("s", "time since the first sample", min=0.0)
    gathered: Any = Gathered
    acceleration: Any = Acceleration
    unit: Any = sources.Unit
    tracked: Any = sources.Tracked
    disturbed = boolean("whether the field was disturbed when last looked at")
    doubt = real("s", "for which its strength and dip still have to fit", min=0.0)


class Out(Outputs):
    """Attitude, and how far to believe it."""

    attitude = ports.ATTITUDE
    body_rate = vector("rad/s", "body rate in B, bias removed")
    rate_bias = vector("rad/s", "bias of the gyro in B")
    distortion = vector("rad", "distortion d of the tracker's attitude in F")
    mounting = quaternion("hand-eye rotation q_BC")
    registration = quaternion("registration q_WF")
    valid = boolean("the attitude may be used")
    inertial_lost = ports.INERTIAL_LOST
    em_lost = boolean("the tracker has said nothing usable for longer than its patience")
    accelerated = boolean("gravity counts less than half, or not at all: the body accelerates")
    magnetic_disturbance = boolean(
        "the magnetometer hardly counts: strength or dip of its field, now or not long ago"
    )
    attitude_sigma = ports.ATTITUDE_SIGMA
    rate_bias_sigma = ports.RATE_BIAS_SIGMA
    distortion_sigma = vector("rad", "standard deviation of d", min=0.0)
    mounting_sigma = vector("rad", "standard deviation of h", min=0.0)
    registration_sigma = vector("rad", "standard deviation of r", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE
