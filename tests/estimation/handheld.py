"""A hand in motion with an optical tracker and an inertial unit, and what goes wrong with them.

A smooth motion given by sums of sines, its derivatives exact, in NumPy and SciPy; samples with
white noise. It shares nothing with the filters.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

T = 5e-3
GRAVITY = 9.80131
LEVER = np.array([0.02, -0.01, 0.05])
NOISE = {
    "inertial.rate_noise": 5e-4,
    "inertial.force_noise": 5e-3,
    "tracker.position_noise": 1e-4,
    "tracker.attitude_noise": 1e-3,
}
"""Densities of the inertial unit; of the tracker, each sample; parameters of the filters."""
LIMITS = {"limits.rate_range": 34.0, "limits.force_range": 156.0}
"""Of the inertial unit."""


@dataclass(frozen=True)
class World:
    """True pose of the inertial unit, and what is sensed of it; a row for each sample."""

    rotation: Rotation
    position: np.ndarray
    inputs: dict[str, np.ndarray]

    @property
    def body(self) -> np.ndarray:
        """Position of the tracked body."""
        return self.position + self.rotation.apply(LEVER)


def world(
    seconds: float,
    seed: int = 1,
    start: Rotation | None = None,
    every: int = 8,
    late: int = 0,
    noise: float = 1.0,
    lag: float = 0.0,
) -> World:
    """A hand's motion of some centimetres and some rad/s, sampled.

    Args:
        seconds: how long.
        seed: of the noise.
        start: attitude at the start.
        every: inertial samples to a pose.
        late: samples after which a pose arrives.
        noise: factor of all noise.
        lag: of the inertial samples behind the tracker [s].
    """
    fine = 5
    t = np.arange(round(seconds / T) * fine + 1) * (T / fine)
    rng = np.random.default_rng(7)
    waves = 2 * np.pi * np.array([[0.3, 0.7, 1.9], [0.4, 1.1, 1.6], [0.25, 0.9, 2.1]])
    phase = rng.uniform(0, 6, (3, 3))
    size = 0.03 / waves

    def motion(order: int, at: np.ndarray) -> np.ndarray:
        argument = waves[..., np.newaxis] * at + phase[..., np.newaxis] + order * np.pi / 2
        return ((size * waves**order)[..., np.newaxis] * np.sin(argument)).sum(axis=1).T

    # The attitude by a fine integration of a smooth rate: a millisecond is exact to 1e-9.
    turning = 25 * motion(1, t)
    middle = 25 * motion(1, t[:-1] + T / fine / 2)
    steps = Rotation.from_rotvec(middle * (T / fine)).as_quat()
    quaternion = np.empty((len(t), 4))
    quaternion[0] = (start or Rotation.identity()).as_quat()
    for k, step in enumerate(steps):
        x, y, z, w = quaternion[k]
        a, b, c, d = step
        quaternion[k + 1] = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
    rotation = Rotation.from_quat(quaternion)
    shift = round(lag / T * fine)
    at = np.arange(fine, len(t), fine)
    felt = at - shift
    position = motion(0, t)
    acceleration = motion(2, t) + np.array([0, 0, GRAVITY])

    rng = np.random.default_rng(seed)
    n = len(at)
    rate = turning[felt] + noise * NOISE["inertial.rate_noise"] / np.sqrt(2 * T) * rng.normal(
        size=(n, 3)
    )
    force = rotation[felt].inv().apply(acceleration[felt])
    force = force + noise * NOISE["inertial.force_noise"] / np.sqrt(2 * T) * rng.normal(size=(n, 3))
    seen = at[: n - late]
    body = position[seen] + rotation[seen].apply(LEVER)
    body = body + noise * NOISE["tracker.position_noise"] * rng.normal(size=body.shape)
    turned = rotation[seen] * Rotation.from_rotvec(
        noise * NOISE["tracker.attitude_noise"] * rng.normal(size=body.shape)
    )
    new = np.zeros(n)
    new[late::every] = 1.0
    inputs = {
        "rate": rate,
        "force": force,
        "inertial_valid": np.ones(n),
        "optical_position": np.vstack([np.zeros((late, 3)), body]),
        "optical_attitude": np.vstack([[[1, 0, 0, 0]] * late, np.roll(turned.as_quat(), 1, axis=1)])
        if late
        else np.roll(turned.as_quat(), 1, axis=1),
        "optical_new": new,
        "optical_age": np.full(n, late * T),
    }
    return World(rotation[at], position[at], inputs)


def errors(true: World, out: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of position [m] and attitude [rad] of the tracked body, each sample."""
    turned = Rotation.from_quat(out["attitude"], scalar_first=True).inv() * true.rotation
    return np.linalg.norm(out["position"] - true.body, axis=1), turned.magnitude()


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def lost_samples(inputs):
    """One in five."""
    valid = inputs["inertial_valid"].copy()
    valid[np.random.default_rng(4).random(len(valid)) < 0.2] = 0.0
    return {**inputs, "inertial_valid": valid}


def lost_for_half_a_second(inputs):
    valid = inputs["inertial_valid"].copy()
    valid[round(8 / T) : round(8.5 / T)] = 0.0
    return {**inputs, "inertial_valid": valid}


def frozen_unit(inputs):
    rate, force = inputs["rate"].copy(), inputs["force"].copy()
    held = slice(round(8 / T), round(8.5 / T))
    rate[held], force[held] = rate[held.start], force[held.start]
    return {**inputs, "rate": rate, "force": force}


def clipped_force(inputs):
    force = inputs["force"].copy()
    held = slice(round(8 / T), round(8.2 / T))
    force[held, 2] = 160.0
    return {**inputs, "force": force}


def frozen_tracker(inputs):
    """The same pose again and again, said to be new."""
    position, attitude = inputs["optical_position"].copy(), inputs["optical_attitude"].copy()
    held = slice(round(8 / T), round(8.5 / T))
    position[held], attitude[held] = position[held.start], attitude[held.start]
    return {**inputs, "optical_position": position, "optical_attitude": attitude}


def no_attitude(inputs):
    """A tracker that gives zeros where it has lost the attitude."""
    attitude = inputs["optical_attitude"].copy()
    attitude[round(8 / T) : round(8.5 / T)] = 0.0
    return {**inputs, "optical_attitude": attitude}


def check_fault(true: World, out, flag: str | None, bound: float, turn: float) -> None:
    """A fault from 8 to 8.5 s: errors within bounds [m, deg], told while it lasts, over by 10 s."""
    position, attitude = errors(true, out)
    assert position[round(4 / T) :].max() < bound
    assert attitude[round(4 / T) :].max() < np.radians(turn)
    if flag:
        assert out[flag][round(8.15 / T) : round(8.2 / T)].all()
        assert not out[flag][round(2 / T) : round(7.9 / T)].any()
        assert not out[flag][round(9 / T) :].any()
    assert position[round(10 / T) :].max() < 1.5e-3
    assert out["valid"][round(10 / T) :].all()
