"""Parameters, ports and memory of the filter."""

from typing import Any

from fmu_src.device import design
from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.estimation.optical_inertial.state import KEPT, MARKERS, SPACE, Nominal
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.records import boolean, quaternion, real, vector


class Inertial(Parameters):
    """The inertial unit: its noise, and what drifts."""

    rate_noise = real("rad/s/Hz0.5", "density of the rate", start=2e-4, min=1e-8, max=10.0)
    force_noise = real("m/s2/Hz0.5", "density of the force", start=4e-3, min=1e-8, max=100.0)
    rate_bias_walk = real("rad/s1.5", "walk of b_g", start=1e-5, min=0.0, max=1.0)
    force_bias_walk = real("m/s2.5", "walk of b_a", start=1e-4, min=0.0, max=1.0)
    rate_matrix_walk = real("1/s0.5", "walk of M_g", start=0.0, min=0.0, max=0.1)
    force_matrix_walk = real("1/s0.5", "walk of M_a", start=0.0, min=0.0, max=0.1)
    rate_bias_sigma = real("rad/s", "of b_g at the start", start=0.02, min=0.0, max=1.0)
    force_bias_sigma = real("m/s2", "of b_a at the start", start=0.2, min=0.0, max=5.0)
    rate_matrix_sigma = real(None, "of M_g at the start", start=0.01, min=0.0, max=0.2)
    force_matrix_sigma = real(None, "of M_a at the start", start=0.01, min=0.0, max=0.2)
    between = real(
        None,
        "error of the straight line between two samples, of their difference",
        start=0.1,
        min=0.0,
        max=1.0,
    )
    moving_rate = ports.MOVING_RATE
    moving_force = real(
        "m/s2/Hz0.5", "density of the force where no sample tells it", start=3.0, min=1e-2, max=1e3
    )


class Mounting(Parameters):
    """Place of the inertial unit on the tracked body, and its lag behind the tracker's clock."""

    lever = real("m", "l in B", shape=3, within=2.0)
    lever_sigma = real("m", "how well it is known", start=0.05, min=0.0, max=1.0)
    rotation = real("rad", "rotation vector of m", shape=3, within=4.0)
    rotation_sigma = real("rad", "how well it is known", start=0.05, min=0.0, max=1.0)
    rate_lag = real("s", "t_g", within=0.05)
    force_lag = real("s", "t_a", within=0.05)
    lag_sigma = real("s", "how well they are known", start=3e-3, min=0.0, max=0.1)


class Tracker(Parameters):
    """The optical tracker: its noise and its slower errors."""

    position_noise = real("m", "of each position", start=1e-4, min=1e-7, max=0.1)
    attitude_noise = real("rad", "of each attitude", start=1e-3, min=1e-6, max=1.0)
    marker_noise = real("m", "of each marker seen by itself", start=2e-4, min=1e-7, max=0.1)
    position_offset_sigma = real("m", "of o_p", start=2e-4, min=0.0, max=0.1)
    position_offset_memory = real("s", "in which o_p changes", start=5.0, min=1e-3, max=1e4)
    flicker_sigma = real("m", "of o_f", start=0.0, min=0.0, max=0.1)
    flicker_memory = real("s", "in which o_f changes", start=0.05, min=1e-3, max=1e4)
    attitude_offset_sigma = real("rad", "of o_q", start=1e-3, min=0.0, max=0.1)
    attitude_offset_memory = real("s", "in which o_q changes", start=1.0, min=1e-3, max=1e4)
    markers = real("m", "r_i in O, one a row", shape=(MARKERS, 3), start=design.MARKERS, within=1.0)
    gate = ports.gate("a pose counts less unless the one before was as unlikely")
    patience = ports.patience(0.1)


class Params(Parameters):
    """Everything that is known beforehand."""

    limits: Any = sources.Limits
    inertial = Inertial
    mounting = Mounting
    tracker = Tracker
    gravity = real("m/s2", "length of G", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    gravity_sigma = real("m/s2", "of G, mostly by the tracker's level", start=0.2, min=0.0, max=5.0)
    velocity_sigma = real("m/s", "of v at the first pose", start=0.3, min=1e-6, max=10.0)
    position_limit = ports.POSITION_LIMIT
    attitude_limit = ports.attitude_limit(0.1)


class In(ports.PoseInputs):
    """Samples of both, and single markers."""

    optical_markers_new = boolean("markers arrive at this instant; used where there is no pose")
    optical_marker1 = vector("m", "z_1 in W", within=1e3)
    optical_marker2 = vector("m", "z_2 in W", within=1e3)
    optical_marker3 = vector("m", "z_3 in W", within=1e3)
    optical_marker4 = vector("m", "z_4 in W", within=1e3)
    optical_visible1 = boolean("marker 1 is among them")
    optical_visible2 = boolean("marker 2 is among them")
    optical_visible3 = boolean("marker 3 is among them")
    optical_visible4 = boolean("marker 4 is among them")


class X(State):
    """Filter, and what is kept of the samples."""

    nominal = Nominal
    P = SPACE.covariance()
    started = boolean("a pose has come")
    unit: Any = sources.Unit
    pending = real("s", "time since the process was carried on", min=0.0)
    past = real(None, "rate and force, newest first", shape=(6, KEPT), listed=False)
    steps = real("s", "time before each of them", shape=KEPT, listed=False)
    pose = real(None, "last pose that came", shape=7)
    doubted = boolean("the last pose was beyond the gate")
    unseen = real("s", "time since a pose or a marker was used", min=0.0)


class Out(Outputs):
    """Pose of the tracked body now, how far to believe it, and what has been learnt."""

    attitude = quaternion("q_WO")
    position = vector("m", "of the tracked body in W")
    velocity = vector("m/s", "of the tracked body in W")
    body_rate = vector("rad/s", "body rate in B, bias removed")
    valid = boolean("the pose may be used")
    inertial_lost = ports.INERTIAL_LOST
    optical_lost = boolean("no pose or marker could be used of late")
    attitude_sigma = ports.ATTITUDE_SIGMA
    position_sigma = ports.POSITION_SIGMA
    velocity_sigma = ports.VELOCITY_SIGMA
    rate_bias = vector("rad/s", "b_g in B")
    rate_bias_sigma = vector("rad/s", "its standard deviation", min=0.0)
    force_bias = vector("m/s2", "b_a in B")
    force_bias_sigma = vector("m/s2", "its standard deviation", min=0.0)
    lever = vector("m", "l in B")
    lever_sigma = vector("m", "its standard deviation", min=0.0)
    mounting = quaternion("q_BO")
    mounting_sigma = vector("rad", "its standard deviation in O", min=0.0)
    rate_lag = real("s", "t_g")
    rate_lag_sigma = real("s", "its standard deviation", min=0.0)
    force_lag = real("s", "t_a")
    force_lag_sigma = real("s", "its standard deviation", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE
