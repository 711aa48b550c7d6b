"""Draw recordings of hands from seeds, and put defects into them."""

import numpy as np
from scipy.interpolate import make_interp_spline

RATE = 250.0


def draw_hand(seed, seconds=12.0, rate=RATE, noise=0.15e-6):
    """Return time (n,) [s] and position (n, 3) [m] of a hand with tremor, as a tracker gives it."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, seconds, 1e-3)
    knots = np.linspace(0.0, seconds, max(6, int(seconds)))
    position = np.empty((len(fine), 3))
    for axis in range(3):
        slow = make_interp_spline(knots, np.cumsum(rng.normal(0, 1.5e-4, len(knots))), k=5)
        size = make_interp_spline(knots, rng.uniform(1e-5, 4e-5, len(knots)), k=3)
        frequency = rng.uniform(8.0, 11.0) + 0.3 * np.sin(0.7 * fine + rng.uniform(0, 6))
        phase = 2 * np.pi * np.cumsum(frequency) * 1e-3
        position[:, axis] = slow(fine) + size(fine) * np.sin(phase)
    time = np.arange(0.0, seconds - 1e-3, 1 / rate)
    sampled = make_interp_spline(fine, position, k=5)(time)
    return time, sampled + rng.normal(0, noise, sampled.shape)


def motion_at(time, position, when):
    """Return the motion at other times, (m, 3); times outside are clipped."""
    return make_interp_spline(time, position, k=5)(np.clip(when, time[0], time[-1]))


def noisy_stamps(time, position, size, rng):
    """Return even samples with stamps that are off by `size` [s] rms."""
    return time + rng.normal(0, size, len(time)), position


def uneven_samples(time, position, size, rng):
    """Return samples taken at uneven times, off by `size` [s] rms, with right stamps."""
    when = np.sort(np.clip(time + rng.uniform(-size, size, len(time)) * np.sqrt(3), 0, time[-1]))
    when += np.arange(len(when)) * 1e-9
    return when, motion_at(time, position, when)


def glitch(time, position, size, rng):
    """Return the motion with one sample of one axis off by `size` [m]."""
    position = position.copy()
    position[rng.integers(50, len(time) - 50), rng.integers(3)] += size
    return time, position


def jump(time, position, size, rng):
    """Return the motion with one axis off by `size` [m] from some sample on."""
    position = position.copy()
    position[rng.integers(50, len(time) - 50) :, rng.integers(3)] += size
    return time, position


def stuck_axis(time, position, size, rng):
    """Return the motion with one axis that keeps its value for `size` [s]."""
    position, axis = position.copy(), rng.integers(3)
    n = int(np.ceil(size * RATE))
    first = rng.integers(50, len(time) - n - 50)
    position[first : first + n + 1, axis] = position[first, axis]
    return time, position


def clipped(time, position, size, rng):
    """Return the motion with one axis cut off above and below, by `size` of its range."""
    position, axis = position.copy(), rng.integers(3)
    low, high = position[:, axis].min(), position[:, axis].max()
    margin = size * (high - low)
    position[:, axis] = np.clip(position[:, axis], low + margin, high - margin)
    return time, position


def held(time, position, size, rng):
    """Return a table with `size` rows for each sample."""
    fine = np.arange(0.0, time[-1], (time[1] - time[0]) / size)
    number = np.clip(np.floor(fine / (time[1] - time[0]) + 1e-9).astype(int), 0, len(time) - 1)
    return fine, position[number]


def lost(time, position, size, rng):
    """Return the motion without `size` samples, drawn at random."""
    keep = np.ones(len(time), bool)
    keep[rng.choice(np.arange(1, len(time) - 1), int(size), replace=False)] = False
    return time[keep], position[keep]


DEFECTS = {
    "noisy-clock": (noisy_stamps, 5e-5, ()),
    "uneven-clock": (uneven_samples, 5e-5, ()),
    "glitch": (glitch, 5e-6, ()),
    "jump": (jump, 2e-5, ()),
    "stuck-axis": (stuck_axis, 0.25, ()),
    "clipped": (clipped, 0.02, ()),
    "held-samples": (held, 2, ()),
    "lost-samples": (lost, 1, ()),
}
"""For each finding: the defect, the least size that is found, and what else it may look like."""
