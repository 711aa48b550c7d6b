"""The two-axis turntable of A04 3.2.1.4 to 3.2.1.7: its angles, and the experiment simulated.

    R_TB = R_y(-alpha) R_z(beta),    up in B = (sin a cos b, -sin a sin b, cos a)

| symbol | meaning |
| --- | --- |
| T | frame of the turntable: z up, alpha turns about -y |
| alpha | tilt of the body's z from the vertical; at 90 deg x and y lie in the plane of gravity |
| beta | turn about the body's z; at alpha = 90 deg, beta = 0 the x axis points up |
| delta, lambda, nu | alpha's zero, tilt of its axis, difference of the axes from 90 deg [rad] |
| psi | heading of the turntable's x from magnetic north [rad] |

With its errors the turntable makes R_z(psi) R_x(lambda) R_y(-alpha - delta) R_x(nu) R_z(beta) R_M,
where R_M is how the unit sits on it. The plane alpha = 90 deg and its beta from 0 to 360 deg are
A04's first experiment, the other planes the second; planes are run forth and back in turn.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.types import FloatArray
from harness.parts.fmu import FmuPart
from harness.parts.protocols import RunContext
from harness.parts.settings import FmuSettings
from harness.recordings.turntable import CHANNELS
from harness.scenario.load import load

__all__ = [
    "DWELL",
    "GRID",
    "ROOM",
    "Turntable",
    "TurntableRun",
    "attitude",
    "grid",
    "sensors",
    "simulate",
    "up",
]

GRID = 30.0
"""Step of both angles [deg]; A04 shows the planes of +-30, +-90 and +-150 deg."""
DWELL = 5.0
"""Time over which the mean is taken (A04 3.2.1.7) [s]."""
SETTLE = 0.1
"""Time before the mean, for the output filters of 10 ms to settle [s]."""
ROWS = 5
"""Means at each simulated position, so that they show whether it was at rest."""
ROOM = 22.0
"""Temperature of the room (A04 3.2.1.5) [degC]."""
STEP = 1e-3
"""Sample period of the simulated converter [s]."""


_FELT = (*(f"force{i}_{a}" for i in (1, 2, 3) for a in "xyz"), *(f"field_{a}" for a in "xyz"))
_VOLTS = tuple(f"volts_{channel}" for channel in CHANNELS)


@dataclass(frozen=True)
class Turntable:
    """A turntable and its errors. Its stages are good to 0.1 deg, its level to 0.01 (A04).

    Attributes:
        scatter: rms error of each stage at each angle [rad].
        zero: delta [rad].
        level: lambda [rad].
        square: nu [rad].
        mount: rotation vector of the unit on it, (3,) [rad].
        heading: psi [rad].
        seed: seed of the scatter.
    """

    scatter: float = np.radians(0.03)
    zero: float = np.radians(0.05)
    level: float = np.radians(-0.03)
    square: float = np.radians(0.04)
    mount: tuple[float, float, float] = (2e-4, -3e-4, 2e-4)
    heading: float = np.radians(25.0)
    seed: int = 1

    def attitudes(self, alpha: FloatArray, beta: FloatArray) -> Rotation:
        """Return R_WB at each pair of angles [rad], with the same scatter at each call."""
        noise = np.random.default_rng(self.seed).normal(0.0, self.scatter, (2, len(alpha)))
        turned = attitude(alpha + noise[0], beta + noise[1], self.zero, self.level, self.square)
        return Rotation.from_euler("z", self.heading) * turned * Rotation.from_rotvec(self.mount)


@dataclass(frozen=True)
class TurntableRun:
    """Rows that a simulated turntable records.

    Attributes:
        alpha, beta: (rows,) [rad], as commanded.
        volts: (rows, 9) [V].
        temperature: (rows,) [degC].
        attitudes: R_WB as they really were, one for each row.
    """

    alpha: FloatArray
    beta: FloatArray
    volts: FloatArray
    temperature: FloatArray
    attitudes: Rotation


def attitude(
    alpha: FloatArray,
    beta: FloatArray,
    zero: float = 0.0,
    level: float = 0.0,
    square: float = 0.0,
) -> Rotation:
    """Return R_TB at each pair of angles [rad], with delta, lambda and nu [rad]."""
    return (
        Rotation.from_euler("x", level)
        * Rotation.from_euler("y", -(alpha + zero)[:, None])
        * Rotation.from_euler("x", square)
        * Rotation.from_euler("z", beta[:, None])
    )


def up(alpha: FloatArray, beta: FloatArray) -> FloatArray:
    """Return the vertical in B by the ideal turntable, (n, 3)."""
    return attitude(alpha, beta).inv().apply([0.0, 0.0, 1.0])


def grid(step: float = GRID) -> tuple[FloatArray, FloatArray]:
    """Return the angles of the procedure in the order in which they are visited [rad].

    Args:
        step: step of both angles, a whole part of 90 [deg].

    Raises:
        SteadytipError: the step has another value.
    """
    if not (10.0 <= step <= 45.0 and abs(90.0 / step - round(90.0 / step)) < 1e-9):
        raise SteadytipError(
            f"--grid {step:g}: must be a whole part of 90 deg in [10, 45], as 30; coarser ones do "
            "not tell the parameters apart"
        )
    planes = np.arange(-180.0 + step, 180.0 + step / 2, step)
    around = np.arange(0.0, 360.0 - step / 2, step)
    alpha = np.repeat(planes, len(around))
    beta = np.concatenate([around[:: 1 - 2 * (i % 2)] for i in range(len(planes))])
    return np.radians(alpha), np.radians(beta)


def sensors(scenario: str, part: str) -> Mapping[str, Any]:
    """Return the settings of a scenario's sensors.

    Raises:
        SteadytipError: no such scenario or part, or not an FMU.
    """
    parts = load(scenario).parts
    if part not in parts:
        raise SteadytipError(f"scenario '{scenario}' has no part '{part}'; {nearest(part, parts)}")
    table = parts[part]
    if not isinstance(table.settings, FmuSettings):
        raise SteadytipError(f"part '{part}' of '{scenario}' is no FMU, and only one can be turned")
    return table.settings.table


def _build_sensors(settings: Mapping[str, Any], seed: int) -> FmuPart:
    """Build the sensors' FMU and check its ports."""
    (prepared,) = FmuPart.prepare({"sensors": settings}, lambda text: None).values()
    part = FmuPart("sensors", prepared, seed)
    ports = {port.name for port in (*part.inputs, *part.outputs)}
    lacking = [name for name in (*_FELT, *_VOLTS) if name not in ports]
    if lacking:
        raise SteadytipError(
            f"{part.description.path.name} has no {', '.join(lacking)}; the turntable needs the "
            "ports of InertialSensors"
        )
    return part


def simulate(
    settings: Mapping[str, Any],
    alpha: FloatArray,
    beta: FloatArray,
    table: Turntable,
    seed: int,
    ambient: float = ROOM,
    dwell: float = DWELL,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> TurntableRun:
    """Turn sensors through angles and record their outputs at rest.

    The FMU is loaded once and runs on from one angle to the next; between two there is no motion,
    only the time in which its filters settle.

    Args:
        settings: settings of the part (`fmu`, and values of parameters). Inputs are `force1_x` ..
            `force3_z` and `field_x` .., outputs `volts_a1x` .. `volts_mz`.
        alpha: commanded, (n,) [rad].
        beta: commanded, (n,) [rad].
        table: the turntable.
        seed: seed of the sensors' noise.
        ambient: temperature of the room [degC].
        dwell: time at each angle of which means are taken [s].
        progress: takes the number of angles done and of all angles.

    Returns:
        `ROWS` rows for each pair of angles.

    Raises:
        SteadytipError: the FMU does not build, has other ports, or fails.
    """
    attitudes = table.attitudes(alpha, beta)
    dip = design.MAGNETIC_INCLINATION
    north = design.MAGNETIC_FIELD * np.array([np.cos(dip), 0.0, -np.sin(dip)])
    force = attitudes.inv().apply([0.0, 0.0, design.SITE_GRAVITY])
    felt = np.column_stack((force, force, force, attitudes.inv().apply(north)))
    count, settle, n = max(round(dwell / ROWS / STEP), 1), round(SETTLE / STEP), len(alpha)
    volts, temperature = np.empty((n, ROWS, len(CHANNELS))), np.full((n, ROWS), ambient)
    part = _build_sensors(settings, seed)
    driven = [port.name for port in part.inputs if port.name in (*_FELT, "ambient")]
    outputs = [port.name for port in part.outputs]
    places = [driven.index(name) for name in _FELT]
    columns = [outputs.index(name) for name in _VOLTS]
    u, y = np.full(len(driven), ambient), np.zeros(len(outputs))
    u[places] = felt[0]
    samples, tick = np.empty((ROWS * count, len(outputs))), 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, closing(part):
        run = RunContext(STEP, round(n * (SETTLE + dwell) / STEP), Path(folder))
        part.start(run, driven, [True] * len(driven), u, y)
        for k in range(n):
            u[places] = felt[k]
            part.advance(tick * STEP, settle * STEP)
            tick += settle
            for row in samples:
                part.advance(tick * STEP, STEP)
                tick += 1
                row[:] = y
            volts[k] = samples[:, columns].reshape(ROWS, count, -1).mean(axis=1)
            if "temperature" in outputs:
                warm = samples[:, outputs.index("temperature")]
                temperature[k] = warm.reshape(ROWS, count).mean(axis=1)
            progress(k + 1, n)
    return TurntableRun(
        np.repeat(alpha, ROWS),
        np.repeat(beta, ROWS),
        volts.reshape(n * ROWS, -1),
        temperature.ravel(),
        attitudes[np.repeat(np.arange(n), ROWS)],
    )
