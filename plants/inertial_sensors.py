"""Three dual-axis accelerometers and a three-axis magnetometer, from quantity to converted volts.

    v     = V_0 + c (clip(F(S u)) + b + w)                         what the sensing element gives
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

An accelerometer's mass that is pulled across its axis changes what the channel gives, and friction
makes that depend on the way (forces x along the channel, y and z across it, in and out of the
chip's plane, all by the standard gravity):

    F = S u G(z) (1 + k x^2) + n_y B(y) + n_z B(z) - l (x - r) / X
    B(y) = (sqrt(1 + (y / Y)^2) - 1) / (sqrt(1 + 1 / Y^2) - 1)     skewed springs: a bow
    G(z) = 1 / (1 + d ((z + Z)^2 - Z^2))                           fingers overlap less when it sags
    r    = min(max(r, x - X), x + X)                               what sticks

Of a magnetometer's element the field y across it takes from the sensitivity: F = S (1 + J) u / (1 +
q y), where J is what soft iron adds to the field.

Electronics warm up, each sensor in its own time, and stress in its package follows behind:

    theta' = (t_a + H - theta) / tau_h                             temperature of a sensor
    sigma  = min(max(sigma, theta - W), theta + W)                 the one that its stress is of
    b -> b + b_t (sigma - sigma_0),   S -> S (1 + e_t (theta - theta_0))

with theta_0, sigma_0 those of a unit that has been warmed up in a room of 22 degC. So warming and
cooling differ, by 2 W b_t. The thermometer tells the board's temperature, not that of any sensor.

| symbol | meaning |
| --- | --- |
| n_y, n_z, d, k | bow, droop and hardening of a channel, at 1 g |
| l | half of the loop's height [m/s2] |
| X, Y, Z | widths, by the standard gravity: `STUCK`, `KNEE`, `LIFT` |
| J, q | soft iron, cross-field sensitivity [1/T] |
| t_a, H, tau_h | room [degC], rise by the unit's own power [K], time of warming up [s] |
| W | half width of the stress's path [K] |
| b_t, e_t | changes with temperature [m/s2/K] or [T/K], [1/K] |

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
bias, +-6 % of scale, +-3 % across. Bow, droop, loop and iron are zero at first, the unit is warm;
scenario `raw_unit` has one as it comes from the bench. Times of warming up give A04's 2 to 12 h to
the steady state (four of them); changes with temperature are typical ones of the data sheets.
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, integer, real, vector
from fmu_src.math import rotations

ACCELEROMETERS = ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y")
MAGNETOMETERS = ("mx", "my", "mz")
CHANNELS = ACCELEROMETERS + MAGNETOMETERS
"""Site and axis of each channel (A04 2.3.1)."""
PLACES = [(int(channel[1]) - 1, "xyz".index(channel[2])) for channel in ACCELEROMETERS]
"""The same of the accelerometers as numbers, both from 0."""
MICRO_G = 1e-6 * design.STANDARD_GRAVITY
GAUSS = 1.0 / design.MAGNETOMETER_SCALE
"""One gauss [T]: the scale of 1 V/gauss, the other way round."""
WALK_TURN = 3600.0
"""Averaging time of the smallest root Allan variance [s] (chosen between A04's 30 min and 12 h)."""

SENSORS = ("1", "2", "3", "m")
"""Chips in the order of what has one value for each: three accelerometers and the magnetometer."""
ROOM = 22.0
"""Temperature of A04's experiments (3.2.1.5) [degC]."""
KNEE, LIFT, STUCK = 0.6, 0.25, 0.3
"""Y, Z, X: widths of bow, droop and loop, by the standard gravity."""
RESOLUTION = 1 / 16
"""Resolution of a digital thermometer [K]."""
_HOUR = 3600.0
_MAGNETOMETER_NOISE = design.MAGNETOMETER_RESOLUTION / np.sqrt(10.0)


def walk_density(noise: float) -> float:
    """Return K whose Allan variance K^2 t / 3 meets white noise's N^2 / (2 t) at the turn."""
    return float(noise * np.sqrt(1.5) / WALK_TURN)


class Params(Parameters):
    """Errors of the channels in the order a1x, a1z, a2y, a2z, a3x, a3y and mx, my, mz."""

    seed = integer("seed of the noise", start=1, min=0, max=2**31 - 1)
    accelerometer_bias = real(
        "m/s2",
        "bias b of the accelerometers",
        shape=6,
        start=np.array([900, -1300, -700, 600, 1100, -800]) * MICRO_G,
        within=1.0,
    )
    accelerometer_scale_error = real(
        None,
        "relative error e of the accelerometers' scale",
        shape=6,
        start=(1.2e-3, -0.7e-3, 0.4e-3, -1.1e-3, 0.8e-3, -0.3e-3),
        within=0.1,
    )
    accelerometer_misalignment = real(
        "rad",
        "rotation of each accelerometer from the axes of B, one site a row",
        shape=(3, 3),
        start=[[1.1e-3, -0.9e-3, 1.6e-3], [-1.4e-3, 0.6e-3, -1.0e-3], [0.7e-3, 1.5e-3, -1.2e-3]],
        within=0.2,
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
        within=0.05,
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
        within=1e-4,
    )
    magnetometer_scale_error = real(
        None,
        "relative error e of the magnetometer's scale",
        shape=3,
        start=(1.3e-3, -0.9e-3, 0.5e-3),
        within=0.1,
    )
    magnetometer_misalignment = real(
        "rad",
        "rotation of the magnetometer from the axes of B",
        shape=3,
        start=(-0.8e-3, 1.3e-3, 1.0e-3),
        within=0.2,
    )
    magnetometer_cross_axis = real(
        None,
        "sensitivity of each magnetometer channel to the two other axes, in the order x, y, z",
        shape=(3, 2),
        start=[[0.6e-3, -1.0e-3], [0.8e-3, 0.4e-3], [-0.7e-3, 1.1e-3]],
        within=0.05,
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
    accelerometer_bow = real(
        "m/s2",
        "n, bow of each channel at 1 g across it, in the chip's plane and out of it",
        shape=(6, 2),
        within=1.0,
    )
    accelerometer_droop = real(
        None, "d, share of the scale that goes at 1 g out of the plane", shape=6, min=0.0, max=0.2
    )
    accelerometer_hardening = real(
        None, "k, share of the scale that 1 g along the channel adds", shape=6, within=0.05
    )
    accelerometer_hysteresis = real(
        "m/s2", "l, half the height of the loop over the force", shape=6, min=0.0, max=0.5
    )
    soft_iron = real(None, "J, field in B that iron adds to a field of 1", shape=(3, 3), within=0.3)
    cross_field = real(
        "1/T",
        "q, sensitivity of each channel that the field along the next axis takes",
        shape=3,
        within=1e3,
    )
    heating = real(
        "K",
        "H, rise of each sensor by the unit's own power",
        shape=4,
        start=(8.0, 7.0, 9.0, 11.0),
        min=0.0,
        max=60.0,
    )
    warming = real(
        "s",
        "tau_h, time constant of each sensor's warming up",
        shape=4,
        start=(0.5 * _HOUR, 1.75 * _HOUR, 3.0 * _HOUR, 1.0 * _HOUR),
        min=1.0,
        max=1e5,
    )
    powered = real(
        "s",
        "time that the unit has been on at the first sample; 0 is a cold start",
        start=1e7,
        min=0.0,
        max=1e9,
    )
    stress_width = real(
        "K", "W, half width of the path of each sensor's stress", shape=4, start=1.0, min=0, max=20
    )
    accelerometer_bias_drift = real(
        "m/s2/K",
        "b_t of the accelerometers",
        shape=6,
        start=np.array([120, -90, 150, 60, -130, 100]) * MICRO_G,
        within=0.05,
    )
    accelerometer_scale_drift = real(
        "1/K",
        "e_t of the accelerometers",
        shape=6,
        start=(5e-5, -3e-5, 4e-5, 6e-5, -5e-5, 3e-5),
        within=2e-3,
    )
    magnetometer_bias_drift = real(
        "T/K",
        "b_t of the magnetometer",
        shape=3,
        start=np.array([40e-6, -25e-6, 30e-6]) * GAUSS,
        within=1e-6,
    )
    magnetometer_scale_drift = real(
        "1/K", "e_t of the magnetometer", shape=3, start=(-6e-4, -6e-4, -6e-4), within=5e-3
    )
    thermometer_offset = real("K", "error of the thermometer", start=0.3, within=10.0)
    thermometer_lag = real(
        "s", "time constant of the board's warming up", start=0.75 * _HOUR, min=1.0, max=1e5
    )
    adc_bits = integer("resolution of the converter", start=16, min=8, max=24)


class In(Inputs):
    """Ideal quantities at the sensors' places."""

    force1 = vector("m/s2", "specific force at site 1 in B", within=1e4)
    force2 = vector("m/s2", "specific force at site 2 in B", within=1e4)
    force3 = vector("m/s2", "specific force at site 3 in B", within=1e4)
    field = vector("T", "magnetic field in B", within=0.1)
    ambient = real("degC", "t_a, temperature of the room", start=ROOM, min=-40.0, max=85.0)


class Precomputed(Derived):
    """Sensitivity and filter coefficients."""

    accelerometer_rows = real(None, "rows of S, one accelerometer channel each", shape=(6, 3))
    magnetometer_rows = real(None, "rows of S, one magnetometer channel each", shape=(3, 3))
    decay = real(None, "a, what is left of the filter's state after a sample", shape=9)
    hold = real(None, "h, weight split between the ends of a sample", shape=9)
    noise = real("V", "rms noise behind the filter", shape=9)
    walk = real("V", "rms increment of the random walk in a sample", shape=9)
    turn_1 = real(None, "from B to the axes of accelerometer 1", shape=(3, 3))
    turn_2 = real(None, "from B to the axes of accelerometer 2", shape=(3, 3))
    turn_3 = real(None, "from B to the axes of accelerometer 3", shape=(3, 3))
    cooled = real(None, "share of a temperature's way that is left after a sample", shape=4)
    board_cooled = real(None, "the same of the board")
    cold = real(None, "share of the way to warm that is left at the first sample", shape=4)
    board_cold = real(None, "the same of the board")
    jitter = real("V", "rms noise that a sample adds behind the filter", shape=9)
    bow = real("m/s2", "n, scaled so that the bow is 1 at 1 g", shape=(6, 2))
    loop = real(None, "l by the width of the loop", shape=6)
    codes = real("1/V", "codes of the converter by its span")
    step = real("V", "step of the converter")
    warm = real("degC", "theta_0, temperature of each sensor when warmed up", shape=4)
    warm_stress = real("degC", "sigma_0, the same of its stress", shape=4)


class X(State):
    """Each channel in volts about the zero."""

    started = boolean("whether there was a sample before")
    source = real("V", "sensing element at the last sample", shape=9)
    filtered = real("V", "output filter", shape=9)
    walk = real("V", "random walk", shape=9)
    stuck = real("m/s2", "r, where each accelerometer channel sticks", shape=6)
    temperature = real("degC", "theta of each sensor", shape=4)
    stress = real("degC", "sigma of each sensor", shape=4)
    board = real("degC", "temperature of the board")


class Out(Outputs):
    """Converted volts."""

    volts = real("V", "converted output", shape=9, axes=CHANNELS, min=0.0, max=design.ADC_SPAN)
    clipped = boolean("whether a sensor or the converter is at its limit")
    temperature = real("degC", "temperature of the board by its thermometer", start=ROOM)
    valid = boolean(
        "whether there is a sample at this instant: always, no bus lies between", start=True
    )


def sensitivity_row(axis: int, misalignment: Any, scale_error: Any, cross_axis: Any) -> Any:
    """Return the row of S of a channel, (3,): A04 3.2.1.6 with an exact rotation.

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
    """Return one value for each channel, (9,)."""
    return ca.vertcat(ca.repmat(accelerometer, 6, 1), ca.repmat(magnetometer, 3, 1))


SCALES = _of_each(design.ACCELEROMETER_SCALE, design.MAGNETOMETER_SCALE)
"""Nominal scales c of the channels [V.s2/m], [V/T]."""


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    accelerometer_rows = [
        sensitivity_row(
            axis,
            p.accelerometer_misalignment[site, :].T,
            p.accelerometer_scale_error[i],
            p.accelerometer_cross_axis[i, :],
        ).T
        for i, (site, axis) in enumerate(PLACES)
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
    turns = [
        rotations.matrix(rotations.from_rotation_vector(p.accelerometer_misalignment[i, :].T)).T
        for i in range(3)
    ]
    warm = ROOM + p.heating
    lag = _of_each(p.accelerometer_lag, p.magnetometer_lag)
    decay = ca.exp(-T / lag)
    noise = SCALES * _of_each(p.accelerometer_noise, p.magnetometer_noise) / ca.sqrt(4 * lag)
    return Precomputed(
        accelerometer_rows=ca.vertcat(*accelerometer_rows),
        magnetometer_rows=ca.vertcat(*magnetometer_rows),
        decay=decay,
        hold=lag / T * (1 - decay),
        noise=noise,
        walk=SCALES * _of_each(p.accelerometer_walk, p.magnetometer_walk) * np.sqrt(T),
        turn_1=turns[0],
        turn_2=turns[1],
        turn_3=turns[2],
        cooled=ca.exp(-T / p.warming),
        board_cooled=ca.exp(-T / p.thermometer_lag),
        cold=ca.exp(-p.powered / p.warming),
        board_cold=ca.exp(-p.powered / p.thermometer_lag),
        jitter=noise * ca.sqrt(1 - decay * decay),
        bow=p.accelerometer_bow / (np.sqrt(1 + 1 / KNEE**2) - 1),
        loop=p.accelerometer_hysteresis / (STUCK * design.STANDARD_GRAVITY),
        codes=2.0**p.adc_bits / design.ADC_SPAN,
        step=design.ADC_SPAN / 2.0**p.adc_bits,
        warm=warm,
        warm_stress=_stress(ROOM, warm, p.stress_width),
    )


def _clip(x: Any, low: Any, high: Any) -> Any:
    return ca.fmin(ca.fmax(x, low), high)


def _stress(before: Any, temperature: Any, width: Any) -> Any:
    """Return sigma, which follows theta within W."""
    return _clip(before, temperature - width, temperature + width)


def bow(y: Any) -> Any:
    """Return B(y) before it is scaled to 1 at 1 g, of a force by the standard gravity."""
    return ca.sqrt(1 + (y * (1 / KNEE)) ** 2) - 1


def accelerometers(
    p: Params, derived: Precomputed, linear: Any, own: Any, stuck: Any
) -> tuple[Any, Any]:
    """Return F of the six channels [m/s2], and where they stick afterwards [m/s2].

    Args:
        p: parameters.
        derived: what follows from them.
        linear: S u of each channel, (6,) [m/s2].
        own: specific force at each site in the axes of its sensor, three columns (3,) [m/s2].
        stuck: r before, (6,) [m/s2].
    """
    width = STUCK * design.STANDARD_GRAVITY
    felt, sticks = [], []
    for i, (site, axis) in enumerate(PLACES):
        force = own[site]
        (other,) = (j for at, j in PLACES if at == site and j != axis)
        x, y, z = (
            force[j] * (1 / design.STANDARD_GRAVITY) for j in (axis, other, 3 - axis - other)
        )
        droop = 1 + p.accelerometer_droop[i] * ((z + LIFT) ** 2 - LIFT**2)
        gain = (1 + p.accelerometer_hardening[i] * x**2) / droop
        across = derived.bow[i, 0] * bow(y) + derived.bow[i, 1] * bow(z)
        place = _clip(stuck[i], force[axis] - width, force[axis] + width)
        loop = derived.loop[i] * (force[axis] - place)
        felt.append(linear[i] * gain + across - loop)
        sticks.append(place)
    return ca.vertcat(*felt), ca.vertcat(*sticks)


def step(p: Params, u: In, x: X, T: float, derived: Precomputed, normal: Any) -> tuple[X, Out]:
    """Compute one sample. In the first one, filters are settled and noise is stationary."""
    forces, rows = (u.force1, u.force2, u.force3), derived.accelerometer_rows
    linear = ca.vertcat(*(rows[i, :] @ forces[site] for i, (site, _) in enumerate(PLACES)))
    own = [derived.turn_1 @ u.force1, derived.turn_2 @ u.force2, derived.turn_3 @ u.force3]
    rest = ca.vertcat(*(own[site][axis] for site, axis in PLACES))
    felt, stuck = accelerometers(p, derived, linear, own, ca.if_else(x.started, x.stuck, rest))

    field = derived.magnetometer_rows @ (u.field + p.soft_iron @ u.field)
    across = _clip(field[[1, 2, 0]], -p.magnetometer_range, p.magnetometer_range)
    sensed = ca.vertcat(felt, field / (1 + p.cross_field * across))

    # Temperatures, of each sensor and then of each channel
    steady = u.ambient + p.heating
    risen = u.ambient + p.heating * (1 - derived.cold)
    temperature = ca.if_else(x.started, steady + (x.temperature - steady) * derived.cooled, risen)
    # A unit that was off has the stress of the room.
    stress = _stress(ca.if_else(x.started, x.stress, u.ambient), temperature, p.stress_width)
    board_steady = u.ambient + ca.sum1(p.heating) / 4
    board_risen = ca.sum1(p.heating) / 4 * (1 - derived.board_cold)
    board = ca.if_else(
        x.started,
        board_steady + (x.board - board_steady) * derived.board_cooled,
        u.ambient + board_risen,
    )
    sensor = [SENSORS.index(c[1] if c in ACCELEROMETERS else "m") for c in CHANNELS]
    warmer, stressed = temperature - derived.warm, stress - derived.warm_stress
    scale_drift = ca.vertcat(p.accelerometer_scale_drift, p.magnetometer_scale_drift)
    bias_drift = ca.vertcat(p.accelerometer_bias_drift, p.magnetometer_bias_drift)
    sensed = sensed * (1 + scale_drift * warmer[sensor])

    limit = _of_each(p.accelerometer_range, p.magnetometer_range)
    bias = ca.vertcat(p.accelerometer_bias, p.magnetometer_bias) + bias_drift * stressed[sensor]
    walk = x.walk + derived.walk * normal[9:]
    source = SCALES * (_clip(sensed, -limit, limit) + bias) + walk

    a, h = derived.decay, derived.hold
    settled = source + derived.noise * normal[:9]
    moved = a * x.filtered + (1 - h) * source + (h - a) * x.source + derived.jitter * normal[:9]
    filtered = ca.if_else(x.started, moved, settled)

    code = ca.floor((design.ZERO_VOLTS + filtered) * derived.codes + 0.5)
    converted = ca.fmin(ca.fmax(code, 0), derived.codes * design.ADC_SPAN - 1)
    clipped = ca.logic_or(ca.mmax(ca.fabs(sensed) > limit), ca.mmax(converted != code))
    shown = ca.floor((board + p.thermometer_offset) * (1 / RESOLUTION) + 0.5) * RESOLUTION
    return (
        X(
            started=1,
            source=source,
            filtered=filtered,
            walk=walk,
            stuck=stuck,
            temperature=temperature,
            stress=stress,
            board=board,
        ),
        Out(
            volts=converted * derived.step,
            clipped=clipped,
            temperature=shown,
            valid=1,
        ),
    )


MODEL = Model.of_step("InertialSensors", step, sample_period=1e-3, draws=18, derive=derive)
