"""Compensation of the sensors: from volts to specific forces and the field (A04 3.2, 4.2).

First each channel by itself, at the temperature t of the instrument (A04 3.2.1.3, 3.2.1.5):

    s_i = (V_i - V_0i - v_i dt) / (c_i (1 + e_i dt)),        dt = t - t_0

then what the other axes do to it (A04 3.4 to 3.14), j being the other axis of the same chip and k
the one out of its plane:

    a_i = (s_i - p_1i s_j - p_2i s_j^2 - q_1i s_k - q_2i s_k^2) / (1 + r_1i s_k + r_2i s_k^2)

then the directions in which the channels really feel (A04 3.15 to 3.17, 3.20):

    f = Theta^-1 a        for the trios (a1x, a3y, a1z), (a3x, a2y, a2z) and (mx, my, mz)

| symbol | meaning |
| --- | --- |
| V, V_0 | volts, and at zero input: the bias [V] |
| c | output for 1 m/s2 or 1 T, the scale factor [V.s2/m], [V/T] |
| v, e | their change with temperature [V/K], [1/K] |
| s | what the linear model (A04 3.3) makes of it [m/s2], [T] |
| p, q | shift of the bias by the in-plane and the out-of-plane axis, A04's g and h |
| r | change of the scale factor by the out-of-plane axis |
| Theta | rows: sensing axes of the channels in B, unit vectors |

A04's polynomials are of volts; here they are of s, so that coefficients do not depend on a bias,
and their constants p_0, q_0, r_0 are in V_0 and c. s_k is the mean of both channels of its axis.
There is no root to take: the shift is a polynomial of what is measured, and the only divisor, the
scale factor, is kept above `LEAST_SCALE`; parameters for which it would go below within the
converter's span are a warning of the FMU. Theta's rows stay diagonally dominant within the range of
the parameters, so that it has an inverse. With all parameters at their starts these are the data
sheet's sensors, exactly.

p_1 and q_1 do what the components of Theta do, to the first order: whoever identifies one leaves
the other at zero. For drift over the hours after switching on, A04 waits; a thermometer helps as
far as the drift is the temperature's.
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.kit import Parameters
from fmu_src.kit.records import Derived, condition, real

LEAST_SCALE = 0.1
"""Least share of the scale factor that the out-of-plane axis leaves."""
LEAST_TEMPERATURE, MOST_TEMPERATURE = -40.0, 125.0
"""Range of the sensors by their data sheet [degC]."""
REFERENCE_TEMPERATURE = 22.0
"""Temperature of the room in A04 3.2.1.5 [degC]."""
_TRIOS = ((0, 5, 1), (4, 2, 3))
"""Channels that sense x, y, z: (3.17a), (3.17b)."""
_THERMAL = 4e-3  # 1/K, keeps 1 + e dt above 0.3 over the sensors' range


def _axis(channel: int) -> int:
    return kinematics.PLACES[channel][1]


def neighbours(channel: int) -> tuple[int, tuple[int, int]]:
    """Return the other channel of the same chip, and both channels of the axis out of its plane."""
    site, axis = kinematics.PLACES[channel]
    (other,) = (i for i, (at, _) in enumerate(kinematics.PLACES) if at == site and i != channel)
    out = 3 - axis - _axis(other)
    first, second = (i for i in range(len(kinematics.PLACES)) if _axis(i) == out)
    return other, (first, second)


def _drift(unit: str, what: str, shape: int, most: float) -> Any:
    return real(unit, what, shape=shape, within=most)


class Accelerometer(Parameters):
    """Compensation and noise of the six channels a1x, a1z, a2y, a2z, a3x, a3y."""

    scale = real(
        "V.s2/m",
        "c, output for 1 m/s2",
        start=design.ACCELEROMETER_SCALE,
        shape=6,
        min=1e-3,
        max=10.0,
    )
    zero = real(
        "V",
        "V_0, output at rest across gravity",
        start=design.ZERO_VOLTS,
        shape=6,
        min=0,
        max=5,
    )
    density: Any = kinematics.DENSITY
    lag: Any = kinematics.LAG
    zero_drift = _drift("V/K", "v, change of the zero with temperature", 6, 0.1)
    scale_drift = _drift("1/K", "e, relative change of the scale with temperature", 6, _THERMAL)
    in_plane = real(None, "p_1, share of the chip's other axis in the output", shape=6, within=0.3)
    in_plane_squared = real("s2/m", "p_2, the same of its square", shape=6, within=0.05)
    out_of_plane = real(None, "q_1, share of the axis out of the chip's plane", shape=6, within=0.3)
    out_of_plane_squared = real("s2/m", "q_2, the same of its square", shape=6, within=0.05)
    scale_slope = real(
        "s2/m",
        "r_1, relative change of the scale with the axis out of the chip's plane",
        shape=6,
        within=0.05,
    )
    scale_curvature = real("s4/m2", "r_2, the same with its square", shape=6, within=5e-3)
    misalignment = real(
        None,
        "components of the sensing axis along the two other axes of B, in the order x, y, z",
        shape=(6, 2),
        within=0.3,
    )


class Magnetometer(Parameters):
    """Compensation and noise of the channels mx, my, mz."""

    scale = real(
        "V/T", "c, output for 1 T", start=design.MAGNETOMETER_SCALE, shape=3, min=1.0, max=1e6
    )
    zero = real("V", "V_0, output without a field", start=design.ZERO_VOLTS, shape=3, min=0, max=5)
    sigma = real(
        "T", "noise of one sample", start=design.MAGNETOMETER_RESOLUTION, min=1e-12, max=1e-3
    )
    residue = real(
        "T",
        "what calibration leaves and iron nearby adds; 0.1 deg of the earth's field",
        start=design.MAGNETIC_FIELD * np.radians(0.1),
        min=0.0,
        max=1e-3,
    )
    zero_drift = _drift("V/K", "v, change of the zero with temperature", 3, 0.1)
    scale_drift = _drift("1/K", "e, relative change of the scale with temperature", 3, _THERMAL)
    misalignment = real(
        None,
        "components of the sensing axis along the two other axes of B, in the order x, y, z;"
        " soft iron is in it",
        shape=(3, 2),
        within=0.3,
    )


class Thermometer(Parameters):
    """Temperature at which the parameters hold."""

    reference = real(
        "degC",
        "t_0, temperature at which zero and scale are what they are",
        start=REFERENCE_TEMPERATURE,
        min=LEAST_TEMPERATURE,
        max=MOST_TEMPERATURE,
    )


TEMPERATURE = real(
    "degC",
    "t, of the instrument's inside; without a thermometer leave it at its start",
    start=REFERENCE_TEMPERATURE,
    min=LEAST_TEMPERATURE,
    max=MOST_TEMPERATURE,
)
"""Input of estimators."""


class Alignment(Derived):
    """Inverses of the sensing axes, computed from the parameters."""

    trio_1 = real(None, "Theta^-1 of a1x, a3y, a1z", shape=(3, 3))
    trio_2 = real(None, "Theta^-1 of a3x, a2y, a2z", shape=(3, 3))
    trio_m = real(None, "Theta^-1 of mx, my, mz", shape=(3, 3))
    scale_is_positive = condition(
        "scale factors stay above a tenth whatever the axis out of the plane senses",
        "the scale factor of an accelerometer falls below a tenth within the converter's span; make"
        " scale_slope and scale_curvature smaller",
    )


def sensing_axis(axis: int, components: Any) -> ca.SX:
    """Return the unit vector along which a channel senses, in B, (3,) (A04 3.15).

    Args:
        axis: nominal axis of the channel, 0 to 2.
        components: along the two other axes, (2,).
    """
    others = [components[0], components[1]]
    others.insert(axis, ca.sqrt(1 - components[0] ** 2 - components[1] ** 2))
    return ca.vertcat(*others)


def align(accelerometer: Any, magnetometer: Any) -> Alignment:
    """Inverses of the sensing axes, and whether the scale factors are sound."""

    def inverse(misalignment: Any, channels: tuple[int, int, int]) -> Any:
        rows = [sensing_axis(axis, misalignment[i, :]).T for axis, i in enumerate(channels)]
        return ca.inv_minor(ca.vertcat(*rows))

    largest = design.ADC_SPAN / ca.mmin(accelerometer.scale)
    sound = 1
    for i in range(len(kinematics.PLACES)):
        slope, curvature = accelerometer.scale_slope[i], accelerometer.scale_curvature[i]
        vertex = -slope / (2 * ca.if_else(ca.fabs(curvature) < 1e-12, 1e-12, curvature))
        for s in (-largest, largest, ca.fmin(ca.fmax(vertex, -largest), largest)):
            sound = ca.logic_and(sound, _scale(slope, curvature, s) >= LEAST_SCALE)
    return Alignment(
        trio_1=inverse(accelerometer.misalignment, _TRIOS[0]),
        trio_2=inverse(accelerometer.misalignment, _TRIOS[1]),
        trio_m=inverse(magnetometer.misalignment, (0, 1, 2)),
        scale_is_positive=sound,
    )


def _scale(slope: Any, curvature: Any, s: Any) -> Any:
    return 1 + (slope + curvature * s) * s


def linear(sensor: Any, volts: Any, change: Any) -> ca.SX:
    """s: each channel by its own bias and scale factor (A04 3.3).

    Args:
        sensor: `Accelerometer` or `Magnetometer`.
        volts: of its channels.
        change: dt, of the temperature [K].
    """
    zero = sensor.zero + sensor.zero_drift * change
    return (volts - zero) / (sensor.scale * (1 + sensor.scale_drift * change))


def uncross(p: Any, s: Any) -> ca.SX:
    """Return specific forces along the sensing axes, (6,), from linear ones (A04 3.11, 3.13)."""
    found = []
    for i in range(len(kinematics.PLACES)):
        other, (first, second) = neighbours(i)
        j, k = s[other], (s[first] + s[second]) / 2
        shift = (p.in_plane[i] + p.in_plane_squared[i] * j) * j
        shift += (p.out_of_plane[i] + p.out_of_plane_squared[i] * k) * k
        scale = _scale(p.scale_slope[i], p.scale_curvature[i], k)
        found.append((s[i] - shift) / ca.fmax(scale, LEAST_SCALE))
    return ca.vertcat(*found)


def specific_forces(
    p: Any, volts: Any, temperature: Any, reference: Any, alignment: Alignment
) -> ca.SX:
    """Specific forces of the six channels along the axes of B, (6,) [m/s2].

    Args:
        p: `Accelerometer`.
        volts: of the channels, (6,) [V].
        temperature: t [degC].
        reference: t_0 [degC].
        alignment: of `align`.
    """
    a = uncross(p, linear(p, volts, temperature - reference))
    f = ca.SX(6, 1)
    for trio, inverse in zip(_TRIOS, (alignment.trio_1, alignment.trio_2), strict=True):
        along = inverse @ ca.vertcat(*(a[i] for i in trio))
        for axis, i in enumerate(trio):
            f[i] = along[axis]
    return f


def magnetic_field(
    p: Any, volts: Any, temperature: Any, reference: Any, alignment: Alignment
) -> ca.SX:
    """Magnetic field in B, (3,) [T]; estimators use its direction (A04 3.23 to 3.25).

    Args:
        p: `Magnetometer`.
        volts: of the channels, (3,) [V].
        temperature: t [degC].
        reference: t_0 [degC].
        alignment: of `align`.
    """
    return alignment.trio_m @ linear(p, volts, temperature - reference)
