"""The two-axis turntable of A04 3.2.1.4 to 3.2.1.7: its angles, and the experiment simulated.

    R_TB = R_y(-alpha) R_z(beta),    up in B = (sin a cos b, -sin a sin b, cos a)

| symbol | meaning |
| --- | --- |
| T | frame of the turntable: z up, alpha turns about -y |
| alpha | tilt of the body's z from the vertical; at 90 deg x and y lie in the plane of gravity |
| beta | turn about the body's z; at alpha = 90 deg, beta = 0 the x axis points up |
| delta, lambda, nu | alpha's zero, tilt of its axis, what the axes lack of 90 deg [rad] |
| psi | heading of the turntable's x from magnetic north [rad] |

With its errors the turntable makes R_z(psi) R_x(lambda) R_y(-alpha - delta) R_x(nu) R_z(beta) R_M,
where R_M is how the unit sits on it. The plane alpha = 90 deg and its beta from 0 to 360 deg are
A04's first experiment, the other planes the second; planes are run forth and back in turn.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from harness.common.errors import SteadytipError, nearest
from harness.common.types import FloatArray
from harness.parts.fmu import FmuPart
from harness.parts.protocols import RunContext
from harness.scenario.load import load

__all__ = [
    "ACCELEROMETERS",
    "CHANNELS",
    "GRID",
    "ROOM",
    "Rests",
    "Table",
    "attitude",
    "grid",
    "joined",
    "simulate",
    "up",
]

ACCELEROMETERS = ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y")
CHANNELS = (*ACCELEROMETERS, "mx", "my", "mz")
GRID = 30.0
"""Step of both angles [deg]; A04 shows the planes of +-30, +-90 and +-150 deg."""
DWELL = 5.0
"""Time of which the mean is taken (A04 3.2.1.7) [s]."""
SETTLE = 0.1
"""Before it, for the output filters, of 10 ms [s]."""
ROWS = 5
"""Means that a simulated rest is told by, so that it shows whether it was one."""
ROOM = 22.0
"""Temperature of the room (A04 3.2.1.5) [degC]."""
STEP = 1e-3
"""Of the simulated converter [s]."""


@dataclass(frozen=True)
class Table:
    """A turntable with its own errors; its stages are good to 0.1 deg, its level to 0.01 (A04).

    Attributes:
        scatter: rms error of each stage at each angle [rad].
        zero: delta [rad].
        level: lambda [rad].
        square: nu [rad].
        mount: rotation vector of the unit on it, (3,) [rad].
        heading: psi [rad].
        seed: of the scatter.
    """

    scatter: float = np.radians(0.03)
    zero: float = np.radians(0.05)
    level: float = np.radians(-0.03)
    square: float = np.radians(0.04)
    mount: tuple[float, float, float] = (2e-4, -3e-4, 2e-4)
    heading: float = np.radians(25.0)
    seed: int = 1

    def attitudes(self, alpha: FloatArray, beta: FloatArray) -> Rotation:
        """R_WB at each pair of angles [rad]; the same scatter at each call."""
        noise = np.random.default_rng(self.seed).normal(0.0, self.scatter, (2, len(alpha)))
        turned = attitude(alpha + noise[0], beta + noise[1], self.zero, self.level, self.square)
        return Rotation.from_euler("z", self.heading) * turned * Rotation.from_rotvec(self.mount)


@dataclass(frozen=True)
class Rests:
    """What a unit told while it rested.

    Attributes:
        alpha, beta: of the turntable, (n,) [rad].
        volts: means, (n, channels) [V].
        temperature: of the thermometer, (n,) [degC]; None without one.
        counts: rows that each mean is of, (n,).
        channels: names of the columns of `volts`.
        notes: what is odd without being wrong; sentences.
    """

    alpha: FloatArray
    beta: FloatArray
    volts: FloatArray
    temperature: FloatArray | None
    counts: FloatArray
    channels: tuple[str, ...] = CHANNELS
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.alpha)

    def only(self, kept: np.ndarray) -> Rests:
        """Some of them, by index or mask."""
        temperature = None if self.temperature is None else self.temperature[kept]
        return replace(
            self,
            alpha=self.alpha[kept],
            beta=self.beta[kept],
            volts=self.volts[kept],
            counts=self.counts[kept],
            temperature=temperature,
        )


@dataclass(frozen=True)
class Experiment:
    """Rows that a simulated experiment gives.

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
    attitudes: Rotation = field(default_factory=Rotation.identity)


def attitude(
    alpha: FloatArray,
    beta: FloatArray,
    zero: float = 0.0,
    level: float = 0.0,
    square: float = 0.0,
) -> Rotation:
    """R_TB at each pair of angles [rad], with delta, lambda and nu [rad]."""
    return (
        Rotation.from_euler("x", level)
        * Rotation.from_euler("y", -(alpha + zero)[:, None])
        * Rotation.from_euler("x", square)
        * Rotation.from_euler("z", beta[:, None])
    )


def up(alpha: FloatArray, beta: FloatArray) -> FloatArray:
    """The vertical in B by the ideal turntable, (n, 3)."""
    return attitude(alpha, beta).inv().apply([0.0, 0.0, 1.0])


def joined(parts: Sequence[Rests]) -> Rests:
    """Several recordings of one unit as one.

    Raises:
        SteadytipError: they do not have the same channels.
    """
    first = parts[0]
    if any(one.channels != first.channels for one in parts):
        raise SteadytipError("the recordings do not have the same channels; give those that do")
    warm = [one.temperature for one in parts if one.temperature is not None]
    return Rests(
        np.concatenate([one.alpha for one in parts]),
        np.concatenate([one.beta for one in parts]),
        np.concatenate([one.volts for one in parts]),
        np.concatenate(warm) if len(warm) == len(parts) else None,
        np.concatenate([one.counts for one in parts]),
        first.channels,
        tuple(dict.fromkeys(note for one in parts for note in one.notes)),
    )


def grid(step: float = GRID) -> tuple[FloatArray, FloatArray]:
    """Angles of the procedure in the order in which they are visited [rad].

    Args:
        step: of both angles, a whole part of 90 [deg].

    Raises:
        SteadytipError: it is not.
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
    """Settings of a scenario's sensors.

    Raises:
        SteadytipError: no such scenario or part, or not an FMU.
    """
    parts = load(scenario).parts
    if part not in parts:
        raise SteadytipError(f"scenario '{scenario}' has no part '{part}'; {nearest(part, parts)}")
    table = parts[part]
    if table.kind != "fmu":
        raise SteadytipError(f"part '{part}' of '{scenario}' is no FMU, and only one can be turned")
    return table.settings


class Mounted:
    """Sensors as an FMU that is held in place: what it feels is constant until it is told anew.

    A context manager, which ends the FMU.

    Args:
        settings: of the part (`fmu`, and values of parameters); what takes `force1_x` .. `force3_z`
            and `field_x` .. gives `volts_a1x` .. `volts_mz`.
        seed: of the sensors' noise.
        ambient: temperature of the room, for sensors with an input of that name [degC].
        seconds: that it will run at most.

    Raises:
        SteadytipError: the FMU does not build, or has other ports.
    """

    def __init__(
        self, settings: Mapping[str, Any], seed: int, ambient: float, seconds: float
    ) -> None:
        (prepared,) = FmuPart.prepare({"sensors": settings}, lambda text: None).values()
        self._part = FmuPart("sensors", prepared, seed)
        felt = [f"force{i}_{a}" for i in (1, 2, 3) for a in "xyz"] + [f"field_{a}" for a in "xyz"]
        names = [port.name for port in self._part.inputs]
        outputs = [port.name for port in self._part.outputs]
        told = [f"volts_{channel}" for channel in CHANNELS]
        lacking = [name for name in felt if name not in names]
        lacking += [name for name in told if name not in outputs]
        if lacking:
            raise SteadytipError(
                f"{self._part.description.path.name} has no {', '.join(lacking)}; the turntable "
                "needs the ports of InertialSensors"
            )
        self._driven = [name for name in names if name in felt or name == "ambient"]
        self._at = [outputs.index(name) for name in told]
        self._warm = outputs.index("temperature") if "temperature" in outputs else None
        self._ambient, self._steps = ambient, round(seconds / STEP)
        self._u, self._y = np.zeros(len(self._driven)), np.zeros(len(outputs))
        self._tick = -1  # not started

    def __enter__(self) -> Mounted:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        return self

    def __exit__(self, *error: object) -> None:
        self._part.close()
        self._folder.cleanup()

    def feel(self, force: FloatArray, field: FloatArray) -> None:
        """From now on: specific force of all sites, field; in B, (3,) [m/s2], [T]."""
        values = {f"force{i}_{a}": force[j] for i in (1, 2, 3) for j, a in enumerate("xyz")}
        values |= {f"field_{a}": field[j] for j, a in enumerate("xyz")}
        self._u[:] = [values.get(name, self._ambient) for name in self._driven]
        if self._tick < 0:
            run = RunContext(STEP, self._steps, Path(self._folder.name))
            initialised = [True] * len(self._driven)
            self._part.start(run, self._driven, initialised, self._u, self._y)
            self._tick = 0

    def wait(self, steps: int) -> None:
        """Let time pass."""
        self._part.advance(self._tick * STEP, steps * STEP)
        self._tick += steps

    def read(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Samples of the channels, (steps, 9) [V], and of the thermometer, (steps,) [degC]."""
        rows = np.empty((steps, len(self._y)))
        advance, tick, y = self._part.advance, self._tick, self._y
        for row in rows:
            advance(tick * STEP, STEP)
            tick += 1
            row[:] = y
        self._tick = tick
        warm = np.full(steps, self._ambient) if self._warm is None else rows[:, self._warm]
        return rows[:, self._at], warm


def simulate(
    settings: Mapping[str, Any],
    alpha: FloatArray,
    beta: FloatArray,
    table: Table,
    seed: int,
    ambient: float = ROOM,
    dwell: float = DWELL,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> Experiment:
    """Turn sensors through angles and write down what they tell at rest.

    The FMU is loaded once and runs on from one angle to the next; between two there is no motion,
    only the time in which its filters settle.

    Args:
        settings: see `Mounted`.
        alpha: commanded, (n,) [rad].
        beta: commanded, (n,) [rad].
        table: the turntable.
        seed: of the sensors' noise.
        ambient: temperature of the room [degC].
        dwell: time at each angle of which means are taken [s].
        progress: told the angles done, and of all.

    Returns:
        `ROWS` rows for each pair of angles.

    Raises:
        SteadytipError: the FMU does not build, has other ports, or fails.
    """
    attitudes = table.attitudes(alpha, beta)
    dip = design.MAGNETIC_INCLINATION
    north = design.MAGNETIC_FIELD * np.array([np.cos(dip), 0.0, -np.sin(dip)])
    force = attitudes.inv().apply([0.0, 0.0, design.SITE_GRAVITY])
    field = attitudes.inv().apply(north)
    count, n = max(round(dwell / ROWS / STEP), 1), len(alpha)
    volts, temperature = np.empty((n, ROWS, len(CHANNELS))), np.empty((n, ROWS))
    with Mounted(settings, seed, ambient, n * (SETTLE + dwell)) as mounted:
        for k in range(n):
            mounted.feel(force[k], field[k])
            mounted.wait(round(SETTLE / STEP))
            rows, warm = mounted.read(ROWS * count)
            volts[k] = rows.reshape(ROWS, count, -1).mean(axis=1)
            temperature[k] = warm.reshape(ROWS, count).mean(axis=1)
            progress(k + 1, n)
    return Experiment(
        np.repeat(alpha, ROWS),
        np.repeat(beta, ROWS),
        volts.reshape(n * ROWS, -1),
        temperature.ravel(),
        attitudes[np.repeat(np.arange(n), ROWS)],
    )
