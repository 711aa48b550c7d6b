"""Inertial unit of one place: three gyros, three accelerometers, three magnetometers.

    f      = R^T (a_W - g_W) + alpha x l + w x (w x l)             specific force at the unit
    m      = R^T (F (cos I, 0, -sin I) + B(o + R l - c))           magnetic field, a magnet's in it
    y      = round(clip((I + M)(delayed u) + b + v + N sqrt(f_s / 2) z, -L, L) / D) D
    v'     = white noise of density K                              bias walk

| symbol | meaning |
| --- | --- |
| u, y | rate w [rad/s], specific force f [m/s2] or field m [T]; as given out |
| a_W, alpha, w | acceleration of the origin of B, angular acceleration and rate |
| R, o | R(q_WB), origin of B in W [m] |
| l | place of the unit in B [m]: the lever arm |
| B | field of a dipole at the place c in W [T] |
| M | scale errors on the diagonal, else misalignment and cross axis: rows are channels |
| b, v | bias and its walk |
| N, K | one-sided density of the white noise, density of the walk |
| L, D, f_s | range, step of the converter, samples in a second |

Delays are filters and converters of the unit: sums of neighbouring samples of a line of 32, so any
delay below 31 samples comes out, whole samples exactly, between them like a straight line.

Sources. MPU-9250 data sheet: gyro 0.01 deg/s/Hz0.5, accelerometer 300 ug/Hz0.5, 16 bit; ranges of
250 deg/s and 2 g; the magnetometer has no noise density there, 0.6 uT rms at 100 Hz is chosen.
Walk: chosen, 5 deg/h after 100 s for the gyro. Bias, scale and misalignment are raw ones of a cheap
unit after a factory calibration: some tenths of deg/s, some mg, some tenths of a per cent, some
tenths of a degree; fixed numbers in no order.
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, integer, real, vector
from plants import sampling

LINE = 32
"""Samples of the delay line."""
MILLI_G = 1e-3 * design.STANDARD_GRAVITY
SOFT = 0.01
"""Distance at which the field of a magnet stops growing [m]: its size."""
_PER_STERADIAN = 1e-7
"""Magnetic constant over 4 pi [T.m/A]."""


def _bias(unit: str, triad: str, start: Any, within: float) -> Any:
    return real(unit, f"bias b of the {triad}", shape=3, start=start, within=within)


def _matrix(triad: str, start: Any, within: float) -> Any:
    return real(None, f"M of the {triad}", shape=(3, 3), start=start, within=within)


class Params(Parameters):
    """Errors of each triad; lever arm; site."""

    seed = integer("seed of the noise", start=1, min=0, max=2**31 - 1)
    sample_rate = real(
        "Hz",
        "samples in a second, at most one a sample of the model; between them none is valid",
        start=1000.0,
        min=1.0,
        max=1000.0,
    )
    lever = real("m", "place l of the unit in B", shape=3, start=(0.0, 0.0, 0.03), within=1.0)
    gyro_bias = _bias("rad/s", "gyros", np.radians([0.4, -0.3, 0.2]), within=0.5)
    gyro_matrix = _matrix(
        "gyros", [[3e-3, 2e-3, -1e-3], [-2e-3, -4e-3, 1.5e-3], [1e-3, -2.5e-3, 2e-3]], within=0.2
    )
    gyro_noise = real("rad/s/Hz0.5", "N of the gyros", start=np.radians(0.01), min=0.0, max=0.1)
    gyro_walk = real(
        "rad/s1.5", "K of the gyros", start=np.radians(5 / 3600) / 10, min=0.0, max=0.1
    )
    gyro_range = real("rad/s", "L of the gyros", start=np.radians(250.0), min=0.1, max=100.0)
    gyro_delay = real("s", "delay of the gyros", start=0.0, min=0.0, max=0.03)
    accelerometer_bias = _bias(
        "m/s2", "accelerometers", np.array([2.0, -1.5, 2.5]) * MILLI_G, within=5.0
    )
    accelerometer_matrix = _matrix(
        "accelerometers",
        [[1e-3, 1e-3, -0.8e-3], [-0.6e-3, -1.5e-3, 0.9e-3], [1.2e-3, 0.5e-3, 2e-3]],
        within=0.2,
    )
    accelerometer_noise = real(
        "m/s2/Hz0.5", "N of the accelerometers", start=0.3 * MILLI_G, min=0.0, max=1.0
    )
    accelerometer_walk = real(
        "m/s2.5", "K of the accelerometers", start=1e-3 * MILLI_G, min=0.0, max=1.0
    )
    accelerometer_range = real(
        "m/s2", "L of the accelerometers", start=2 * design.STANDARD_GRAVITY, min=1.0, max=1e3
    )
    accelerometer_delay = real("s", "delay of the accelerometers", start=0.0, min=0.0, max=0.03)
    magnetometer_bias = _bias(
        "T", "magnetometers, hard iron in it", (2e-7, -3e-7, 1.5e-7), within=1e-3
    )
    magnetometer_matrix = _matrix(
        "magnetometers, soft iron in it",
        [[4e-3, 2e-3, -2e-3], [2e-3, -3e-3, 1e-3], [-2e-3, 1e-3, 1e-3]],
        within=0.5,
    )
    magnetometer_noise = real(
        "T/Hz0.5",
        "N of the magnetometers",
        start=0.6e-6 / np.sqrt(50.0),
        min=0.0,
        max=1e-4,
    )
    magnetometer_walk = real("T/s0.5", "K of the magnetometers", start=1e-9, min=0.0, max=1e-5)
    magnetometer_range = real("T", "L of the magnetometers", start=4.8e-3, min=1e-5, max=1.0)
    magnetometer_delay = real("s", "delay of the magnetometers", start=0.0, min=0.0, max=0.03)
    bits = integer("resolution of all converters", start=16, min=8, max=32)
    gravity = sampling.GRAVITY
    field_strength = sampling.FIELD_STRENGTH
    inclination = sampling.INCLINATION
    magnet_moment = real(
        "A.m2",
        "moment of the magnet, W; of a cube of neodymium of 1 cm",
        shape=3,
        start=(0.0, 1.0, 0.0),
        within=100.0,
    )


class In(Inputs):
    """Motion of the body, a magnet, and faults on demand."""

    body = sampling.BODY
    body_acceleration = sampling.BODY_ACCELERATION
    attitude = sampling.ATTITUDE
    body_rate = vector("rad/s", "body rate in B", within=100.0)
    angular_acceleration = sampling.ANGULAR_ACCELERATION
    magnet = vector("m", "place of the magnet in W", start=5.0, within=10.0)
    lost = boolean("whether the sample is lost: the outputs are held and not valid")
    frozen = boolean("whether the unit repeats its last sample, and calls it valid")


class Precomputed(Derived):
    """Precomputed of the delay line's samples, and what noise there is in a sample."""

    gyro = real(None, "of the gyros", shape=LINE)
    accelerometer = real(None, "of the accelerometers", shape=LINE)
    magnetometer = real(None, "of the magnetometers", shape=LINE)


class X(State):
    """Delay line, walks, and the last sample."""

    started = boolean("whether there was a sample before")
    phase = real(None, "samples that are due", start=1.0)
    line = real(None, "past quantities, the latest first", shape=(9, LINE), listed=False)
    walk = real(None, "walk v of the biases", shape=9)
    held = real(None, "last sample given out", shape=9)


class Out(Outputs):
    """One sample of all three triads."""

    rate = vector("rad/s", "gyros, B")
    force = vector("m/s2", "accelerometers, B")
    field = vector("T", "magnetometers, B")
    inertial_valid = boolean(
        "whether a sample comes now: false between those of a slow unit and where one is lost",
        start=True,
    )
    clipped = boolean("whether a channel is at its limit")


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""

    def weights(delay: Any) -> Any:
        return ca.vertcat(*(ca.fmax(0, 1 - ca.fabs(delay / T - i)) for i in range(LINE)))

    return Precomputed(
        gyro=weights(p.gyro_delay),
        accelerometer=weights(p.accelerometer_delay),
        magnetometer=weights(p.magnetometer_delay),
    )


def magnet_field(moment: Any, r: Any) -> Any:
    """Return the field of a magnet at a place r from it, (3,) [T], W."""
    squared = ca.sumsqr(r) + SOFT**2
    return (
        _PER_STERADIAN
        * (3 * r * ca.dot(r, moment) / squared - moment)
        / (squared * ca.sqrt(squared))
    )


def step(p: Params, u: In, x: X, T: float, derived: Precomputed, normal: Any) -> tuple[X, Out]:
    """Compute one sample."""
    R = sampling.attitude_matrix(u.attitude)
    force = sampling.specific_force(
        R, u.body_acceleration, p.gravity, u.body_rate, u.angular_acceleration, p.lever
    )
    earth = sampling.earth_field(p.field_strength, p.inclination)
    field = R.T @ (earth + magnet_field(p.magnet_moment, u.body + R @ p.lever - u.magnet))
    now = ca.vertcat(u.body_rate, force, field)
    past = ca.if_else(x.started, x.line[:, :-1], ca.repmat(now, 1, LINE - 1))
    line = ca.horzcat(now, past)

    samples, walks, limits = [], [], []
    for at, triad in ((0, "gyro"), (3, "accelerometer"), (6, "magnetometer")):
        matrix, bias, noise, walk, limit = (
            getattr(p, f"{triad}_{error}") for error in ("matrix", "bias", "noise", "walk", "range")
        )
        place = slice(at, at + 3)
        sensed = (ca.SX.eye(3) + matrix) @ (line[place, :] @ getattr(derived, triad))
        walked = x.walk[place] + walk * np.sqrt(T) * normal[9 + at : 12 + at]
        total = sensed + bias + walked + noise * ca.sqrt(p.sample_rate / 2) * normal[place]
        quantum = 2 * limit / 2.0**p.bits
        cut = ca.fmin(ca.fmax(total, -limit), limit)
        samples.append(ca.floor(cut / quantum + 0.5) * quantum)
        walks.append(walked)
        limits.append(ca.mmax(ca.fabs(total) >= limit))
    due, phase = sampling.exposed(x.phase, p.sample_rate, T)
    came = ca.logic_and(due, ca.logic_not(u.lost))
    stays = ca.logic_and(x.started, ca.logic_or(ca.logic_not(came), u.frozen))
    given = ca.if_else(stays, x.held, ca.vertcat(*samples))
    return (
        X(started=1, phase=phase, line=line, walk=ca.vertcat(*walks), held=given),
        Out(
            rate=given[:3],
            force=given[3:6],
            field=given[6:],
            inertial_valid=came,
            clipped=ca.logic_or(limits[0], ca.logic_or(limits[1], limits[2])),
        ),
    )


MODEL = Model.of_step("GyroImu", step, sample_period=1e-3, draws=18, derive=derive)
