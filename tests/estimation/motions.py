"""Motions and noise that follow the attitude filters' models, in NumPy: witnesses of their own."""

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.estimation import attitude_sources as sources

T = 1e-3
GRAVITY = 9.80131
NORTH = 50e-6 * np.array([np.cos(np.radians(55)), 0, -np.sin(np.radians(55))])


def quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def rotation(quaternions):
    return Rotation.from_quat(quaternions, scalar_first=True)


def error(out, truth):
    """Rotation vectors from the true attitudes to those of a run, (n, 3) [rad]."""
    return (truth.inv() * rotation(out["attitude"])).as_rotvec()


def turning(rates, first=None, beside=0.0):
    """Attitudes of a body whose rate goes straight from one sample to the next.

    Args:
        rates: body rates, (n, 3) [rad/s].
        first: attitude at the first sample.
        beside: rotation vectors that each sample turns beside that, (n - 1, 3) [rad].

    Returns:
        Rotation of n attitudes.
    """
    turns = quaternion(Rotation.from_rotvec((rates[1:] + rates[:-1]) / 2 * T + beside))
    chain = [quaternion(first or Rotation.identity())]
    for w, x, y, z in turns:
        a, b, c, d = chain[-1]
        chain.append(
            (
                a * w - b * x - c * y - d * z,
                a * x + b * w + c * z - d * y,
                a * y - b * z + c * w + d * x,
                a * z + b * y - c * x + d * w,
            )
        )
    return rotation(np.array(chain))


def swaying(samples, size=0.5, seed=1):
    """Rates of a hand that turns an instrument about all axes, (n, 3) [rad/s]."""
    rng = np.random.default_rng(seed)
    t = T * np.arange(samples)
    rates = np.zeros((samples, 3))
    for frequency in (0.13, 0.29, 0.47):
        phase = rng.uniform(0, 2 * np.pi, 3)
        rates += size * rng.normal(size=3) * np.sin(2 * np.pi * frequency * t[:, None] + phase)
    return rates


def there_and_back(samples, size):
    """Rates of a hand that ends where it began, (n, 3) [rad/s]: to be repeated without a jump."""
    there = swaying(samples // 2, size)
    return np.vstack((there, -there[::-1]))


def white(rng, density, samples, columns=3):
    """Samples of white noise of a one-sided density."""
    return rng.normal(size=(samples, columns)) * density / np.sqrt(2 * T)


def interval(size):
    """95 % interval of the mean of `size` squared standard normals, over its mean of 1."""
    half = 1.96 * np.sqrt(2 / size)
    return 1 - half, 1 + half


def residual_function(space, residual, predict, size=4):
    """Residual of a measured attitude, as a function of state, turn since then, and measurement."""
    x, turn, z = (ca.SX.sym(letter, n) for letter, n in (("x", space.size), ("t", size), ("z", 4)))
    state = space.record.unpack(x)
    expected = predict(state, turn)
    known = ca.vertcat(sources.shown(expected, z), expected, turn)
    return ca.Function("residual", [x, turn, z], [residual(state, known)])


def slopes(space, residual, predict, size=4):
    """Residual at a state moved by an error, and the exact one: of state, error, turn since then.

    What is measured is what the state predicts, so both are zero without an error.
    """
    x, e, turn = (
        ca.SX.sym(letter, n)
        for letter, n in (("x", space.size), ("e", space.error_size), ("t", size))
    )
    moved = space.record.unpack(space.moved(x, e))
    expected = predict(space.record.unpack(x), turn)
    found = residual(moved, ca.vertcat(0, 0, 0, expected, turn))
    exact = sources.shown(predict(moved, turn), expected)
    return ca.Function("slopes", [x, e, turn], [found, exact])
