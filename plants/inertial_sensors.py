"""Three dual-axis accelerometers and a three-axis magnetometer, from quantity to converted volts.

    v     = V_0 + c (clip(S u) + b + w)                            what the sensing element gives
    w'    = white noise of density K                               random walk
    tau y' = v + white noise of density c N - y                    output filter
    V     = round(clip(y, 0, V_s) / D) D,  D = V_s / 2^bits        converter

| symbol | meaning |
| --- | --- |
| u | specific force of the site [m/s2] or magnetic field [T], B |
| S | sensitivity of the channels: rows of scale (1 + e), cross axis and misalignment |
| b | bias [m/s2], [T] (of the magnetometer: hard iron, too) |
| w, K | random walk, its density [m/s2.5], [T/s0.5] |
| N | one-sided density of the white noise [m/s2/Hz0.5], [T/Hz0.5] |
| c | nominal scale [V.s2/m], [V/T] |
| tau | time constant of the output filter [s] |
| V_0, V_s, D | zero, span and step of the converter [V] |

The filter is solved exactly between samples, for an input that runs straight from one sample to the
next, and for continuous white noise (an Ornstein-Uhlenbeck process):

    y[k] = a y[k-1] + (1 - h) v[k] + (h - a) v[k-1] + c N / sqrt(4 tau) sqrt(1 - a^2) z[k]
    a = exp(-T / tau),  h = tau / T (1 - a)

Sources. ADXL203 data sheet: +-1.7 g, 1 V/g, 110 ug/sqrt(Hz), axes aligned to 0.1 deg, 32 kohm at
the output (A04 3.2.1.7 adds 0.33 uF). HMC2003 data sheet: +-2 gauss, 1 V/gauss, 40 ugauss
resolution, 1 kHz; that resolution is read here as the rms noise in 10 Hz, as the maker does for the
bare sensor. No data sheet has a random walk; A04 3.3 finds it in 12 h of recording but not in
30 min, and K is chosen so that the root Allan variance has its minimum at one hour. A04 Table 2.3
rates the same accelerometer at 2.25 mg rms in 15 Hz, four times its data sheet: scenario
`closed_loop_a04_noise`.

Bias, scale, cross axis and misalignment are what is left of them in a calibrated instrument after
warm-up (A04 chapter 3): fixed numbers in no order, of the size of 1 mg, 0.1 % and 0.1 deg; the
last is the data sheet's own axis alignment. Raw sensors fit into the ranges as well: +-100 mg of
bias, +-6 % of scale, +-3 % across.
"""

from typing import Any

import casadi as ca
import numpy as np

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

ACCELEROMETERS = ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y")
MAGNETOMETERS = ("mx", "my", "mz")
CHANNELS = ACCELEROMETERS + MAGNETOMETERS
"""Site and axis of each channel (A04 2.3.1)."""
MICRO_G = 1e-6 * design.STANDARD_GRAVITY
GAUSS = 1.0 / design.MAGNETOMETER_SCALE
"""One gauss [T]: the scale of 1 V/gauss, the other way round."""
WALK_TURN = 3600.0
"""Averaging time of the smallest root Allan variance [s] (chosen between A04's 30 min and 12 h)."""

_MAGNETOMETER_NOISE = design.MAGNETOMETER_RESOLUTION / np.sqrt(10.0)


def walk_density(noise: float) -> float:
    """Density K whose Allan variance K^2 t / 3 meets the N^2 / (2 t) of white noise at the turn."""
    return float(noise * np.sqrt(1.5) / WALK_TURN)


class Params(Parameters):
    """Errors of the channels in the order a1x, a1z, a2y, a2z, a3x, a3y and mx, my, mz."""

    seed = integer("seed of the noise", start=1, min=0, max=2**31 - 1)
    accelerometer_bias = real(
        "m/s2",
        "bias b of the accelerometers",
        shape=6,
        start=np.array([900, -1300, -700, 600, 1100, -800]) * MICRO_G,
        min=-1.0,
        max=1.0,
    )
    accelerometer_scale_error = real(
        None,
        "relative error e of the accelerometers' scale",
        shape=6,
        start=(1.2e-3, -0.7e-3, 0.4e-3, -1.1e-3, 0.8e-3, -0.3e-3),
        min=-0.1,
        max=0.1,
    )
    accelerometer_misalignment = real(
        "rad",
        "rotation of each accelerometer from the axes of B, one site a row",
        shape=(3, 3),
        start=[[1.1e-3, -0.9e-3, 1.6e-3], [-1.4e-3, 0.6e-3, -1.0e-3], [0.7e-3, 1.5e-3, -1.2e-3]],
        min=-0.2,
        max=0.2,
    )
    accelerometer_cross_axis = real(
        None,
        "sensitivity of each accelerometer channel to the two other axes, in the order x, y, z",
        shape=(6, 2),
        start=[
            [0.9e-3, -0.4e-3],
            [-1.1e-3, 0.5e-3],
            [0.3e-3, 1.2e-3],
            [-0.6e-3, -0.8e-3],
            [1.0e-3, 0.2e-3],
            [-0.5e-3, 0.7e-3],
        ],
        min=-0.05,
        max=0.05,
    )
    accelerometer_noise = real(
        "m/s2/Hz0.5",
        "density N of the accelerometers' white noise",
        start=design.ACCELEROMETER_NOISE,
        min=0.0,
        max=0.1,
    )
    accelerometer_walk = real(
        "m/s2.5",
        "density K of the accelerometers' random walk",
        start=walk_density(design.ACCELEROMETER_NOISE),
        min=0.0,
        max=0.1,
    )
    accelerometer_range = real(
        "m/s2",
        "largest specific force that an accelerometer tells from more",
        start=1.7 * design.STANDARD_GRAVITY,
        min=1.0,
        max=1e3,
    )
    accelerometer_lag = real(
        "s",
        "time constant tau of the accelerometers' output filter",
        start=design.SENSOR_LAG,
        min=1e-5,
        max=1.0,
    )
    magnetometer_bias = real(
        "T",
        "bias b of the magnetometer",
        shape=3,
        start=np.array([600e-6, -400e-6, 900e-6]) * GAUSS,
        min=-1e-4,
        max=1e-4,
    )
    magnetometer_scale_error = real(
        None,
        "relative error e of the magnetometer's scale",
        shape=3,
        start=(1.3e-3, -0.9e-3, 0.5e-3),
        min=-0.1,
        max=0.1,
    )
    magnetometer_misalignment = real(
        "rad",
        "rotation of the magnetometer from the axes of B",
        shape=3,
        start=(-0.8e-3, 1.3e-3, 1.0e-3),
        min=-0.2,
        max=0.2,
    )
    magnetometer_cross_axis = real(
        None,
        "sensitivity of each magnetometer channel to the two other axes, in the order x, y, z",
        shape=(3, 2),
        start=[[0.6e-3, -1.0e-3], [0.8e-3, 0.4e-3], [-0.7e-3, 1.1e-3]],
        min=-0.05,
        max=0.05,
    )
    magnetometer_noise = real(
        "T/Hz0.5",
        "density N of the magnetometer's white noise",
        start=_MAGNETOMETER_NOISE,
        min=0.0,
        max=1e-6,
    )
    magnetometer_walk = real(
        "T/s0.5",
        "density K of the magnetometer's random walk",
        start=walk_density(_MAGNETOMETER_NOISE),
        min=0.0,
        max=1e-6,
    )
    magnetometer_range = real(
        "T",
        "largest field that the magnetometer tells from more",
        start=2 * GAUSS,
        min=1e-5,
        max=1e-2,
    )
    magnetometer_lag = real(
        "s",
        "time constant tau of the magnetometer's output (1 kHz)",
        start=1 / (2 * np.pi * 1e3),
        min=1e-5,
        max=1.0,
    )
    adc_bits = integer("resolution of the converter", start=16, min=8, max=24)


class In(Inputs):
    """Ideal quantities at the sensors' places."""

    force1 = real("m/s2", "specific force at site 1 in B", shape=3, axes="xyz", min=-1e4, max=1e4)
    force2 = real("m/s2", "specific force at site 2 in B", shape=3, axes="xyz", min=-1e4, max=1e4)
    force3 = real("m/s2", "specific force at site 3 in B", shape=3, axes="xyz", min=-1e4, max=1e4)
    field = real("T", "magnetic field in B", shape=3, axes="xyz", min=-0.1, max=0.1)


class Rows(Derived):
    """Sensitivity and filter coefficients."""

    accelerometer_rows = real(None, "rows of S, one accelerometer channel each", shape=(6, 3))
    magnetometer_rows = real(None, "rows of S, one magnetometer channel each", shape=(3, 3))
    decay = real(None, "a, what is left of the filter's state after a sample", shape=9)
    hold = real(None, "h, weight split between the ends of a sample", shape=9)
    noise = real("V", "rms noise behind the filter", shape=9)
    walk = real("V", "rms increment of the random walk in a sample", shape=9)


class X(State):
    """Each channel in volts about the zero."""

    started = boolean("whether there was a sample before")
    source = real("V", "sensing element at the last sample", shape=9)
    filtered = real("V", "output filter", shape=9)
    walk = real("V", "random walk", shape=9)


class Out(Outputs):
    """Converted volts."""

    volts = real("V", "converted output", shape=9, axes=CHANNELS, min=0.0, max=design.ADC_SPAN)
    clipped = boolean("whether a sensor or the converter is at its limit")


def sensitivity_row(axis: int, misalignment: Any, scale_error: Any, cross_axis: Any) -> Any:
    """Row of S of a channel, (3,): A04 3.2.1.6 with an exact rotation.

    Args:
        axis: nominal axis of the channel in B, 0 to 2.
        misalignment: rotation vector of the sensor from the axes of B, (3,) [rad].
        scale_error: relative error of the scale.
        cross_axis: sensitivity to the two other axes of the sensor, (2,).
    """
    own = ca.SX(3, 1)
    own[axis] = 1 + scale_error
    for other, value in zip((i for i in range(3) if i != axis), (0, 1), strict=True):
        own[other] = cross_axis[value]
    return rotations.matrix(rotations.from_rotation_vector(misalignment)) @ own


def _of_each(accelerometer: Any, magnetometer: Any) -> Any:
    """One value for each channel, (9,)."""
    return ca.vertcat(ca.repmat(accelerometer, 6, 1), ca.repmat(magnetometer, 3, 1))


SCALES = _of_each(design.ACCELEROMETER_SCALE, design.MAGNETOMETER_SCALE)
"""Nominal scales c of the channels [V.s2/m], [V/T]."""


def derive(p: Params, T: float) -> Rows:
    """What follows from the parameters."""
    accelerometer_rows = [
        sensitivity_row(
            "xyz".index(channel[2]),
            p.accelerometer_misalignment[int(channel[1]) - 1, :].T,
            p.accelerometer_scale_error[i],
            p.accelerometer_cross_axis[i, :],
        ).T
        for i, channel in enumerate(ACCELEROMETERS)
    ]
    magnetometer_rows = [
        sensitivity_row(
            axis,
            p.magnetometer_misalignment,
            p.magnetometer_scale_error[axis],
            p.magnetometer_cross_axis[axis, :],
        ).T
        for axis in range(3)
    ]
    lag = _of_each(p.accelerometer_lag, p.magnetometer_lag)
    decay = ca.exp(-T / lag)
    return Rows(
        accelerometer_rows=ca.vertcat(*accelerometer_rows),
        magnetometer_rows=ca.vertcat(*magnetometer_rows),
        decay=decay,
        hold=lag / T * (1 - decay),
        noise=SCALES * _of_each(p.accelerometer_noise, p.magnetometer_noise) / ca.sqrt(4 * lag),
        walk=SCALES * _of_each(p.accelerometer_walk, p.magnetometer_walk) * np.sqrt(T),
    )


def step(p: Params, u: In, x: X, T: float, derived: Rows, normal: Any) -> tuple[X, Out]:
    """One sample. The first one finds the filters settled and their noise stationary."""
    forces = {"1": u.force1, "2": u.force2, "3": u.force3}
    sensed = ca.vertcat(
        *(
            derived.accelerometer_rows[i, :] @ forces[channel[1]]
            for i, channel in enumerate(ACCELEROMETERS)
        ),
        derived.magnetometer_rows @ u.field,
    )
    limit = _of_each(p.accelerometer_range, p.magnetometer_range)
    bias = ca.vertcat(p.accelerometer_bias, p.magnetometer_bias)
    walk = x.walk + derived.walk * normal[9:]
    source = SCALES * (ca.fmin(ca.fmax(sensed, -limit), limit) + bias) + walk

    a, h = derived.decay, derived.hold
    settled = source + derived.noise * normal[:9]
    moved = (
        a * x.filtered
        + (1 - h) * source
        + (h - a) * x.source
        + derived.noise * ca.sqrt(1 - a * a) * normal[:9]
    )
    filtered = ca.if_else(x.started, moved, settled)

    codes = 2.0**p.adc_bits
    code = ca.floor((design.ZERO_VOLTS + filtered) / design.ADC_SPAN * codes + 0.5)
    converted = ca.fmin(ca.fmax(code, 0), codes - 1)
    clipped = ca.logic_or(ca.mmax(ca.fabs(sensed) > limit), ca.mmax(converted != code))
    return (
        X(started=1, source=source, filtered=filtered, walk=walk),
        Out(volts=converted * (design.ADC_SPAN / codes), clipped=clipped),
    )


MODEL = Model(
    "InertialSensors",
    step,
    Params,
    In,
    X,
    Out,
    sample_period=1e-3,
    draws=18,
    derived=Rows,
    derive=derive,
)
