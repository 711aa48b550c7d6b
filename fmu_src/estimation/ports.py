"""Ports and parameters that estimators with a tracker and an inertial unit have in common.

| symbol | meaning |
| --- | --- |
| B, W | body of the inertial unit, world |
| q | attitude q_WB |
| d | age of a measurement when it arrives [s] |
"""

from typing import Any

from fmu_src.kit.records import Inputs, boolean, quaternion, real, vector

MOVING_RATE = real(
    "rad/s/Hz0.5", "density of the rate where no sample reports it", start=1.0, min=1e-3, max=100
)
POSITION_LIMIT = real(
    "m", "standard deviation beyond which the pose is not valid", start=0.02, min=1e-6, max=10.0
)
RATE = vector("rad/s", "body rate in B, by the gyros", within=1e3)
FORCE = vector("m/s2", "specific force in B, by the accelerometers", within=1e4)
INERTIAL_VALID = boolean(
    "the inertial sample is fresh: false between those of a slow unit and where one is lost",
    start=True,
)
ATTITUDE = quaternion("attitude q_WB")
INERTIAL_LOST = boolean("the inertial samples are missing, frozen or clipped")
ATTITUDE_SIGMA = vector("rad", "standard deviation of the attitude in the body", min=0.0)
POSITION_SIGMA = vector("m", "standard deviation of the position in W", min=0.0)
VELOCITY_SIGMA = vector("m/s", "standard deviation of the velocity in W", min=0.0)
RATE_BIAS_SIGMA = vector("rad/s", "standard deviation of b in B", min=0.0)
INNOVATION_SQUARED = real(
    None, "normalised innovation squared of the corrections at this sample", min=0.0
)
INNOVATION_SIZE = real(None, "their degrees of freedom, 0 without one", min=0.0)


def gate(effect: str) -> Any:
    """Declare the gate of a measurement, by what happens to one that is beyond it."""
    text = f"normalised innovation squared for each degree of freedom, beyond which {effect}"
    return real(None, text, start=9.0, min=1.0, max=1e6)


def attitude_limit(start: float) -> Any:
    """Declare the standard deviation beyond which the attitude is not valid [rad]."""
    return real("rad", "largest standard deviation of a valid q", start=start, min=1e-6, max=4.0)


def patience(start: float) -> Any:
    """Declare the time after which a silent tracker is lost [s]."""
    text = "time without a measurement, after which the tracker counts as lost"
    return real("s", text, start=start, min=1e-3, max=100.0)


def astray(start: float) -> Any:
    """Declare the time after which a filter that disagrees with the tracker starts anew [s]."""
    text = "time for which all attitudes are beyond the gate, after which the filter starts anew"
    return real("s", text, start=start, min=0.01, max=1e3)


def tracked_attitude(frames: str) -> Any:
    """Declare an attitude as a tracker sends it, by its frames."""
    return quaternion(f"attitude of {frames}", within=2.0)


class PoseInputs(Inputs):
    """Samples of an inertial unit, and poses from an optical tracker."""

    rate = RATE
    force = FORCE
    inertial_valid = INERTIAL_VALID
    optical_position = vector("m", "tracked body in W", within=1e3)
    optical_attitude = tracked_attitude("the tracked body in W")
    optical_new = boolean("a pose arrives at this instant")
    optical_age = real(
        "s", "d, age of it on arrival; below 0 for a tracker that predicts", min=-0.1, max=10.0
    )
