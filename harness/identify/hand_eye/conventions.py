"""Tell from a recording whether rates and attitudes follow the conventions that they are read by.

Relative rotations of the body by the gyro, a_k, and of the coils by the tracker, b_k, over the same
half second are one rotation seen in two frames: a_k = h b_k for the rotation vectors (RK III.B).
What is left of the a_k after the best h, as a share of them, is small if both follow the
conventions, and large if one of them does not: then the other conventions that people have are
tried, and the one that fits is named. Quaternions with their scalar last, read as if it were the
first, turn as the inverse rotations do: those two cannot be told apart.

| symbol | meaning |
| --- | --- |
| a_k, b_k | rotation vectors of body and coils over `APART` [rad] |
| h | rotation that fits them best (Kabsch) |
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.errors import SteadytipError
from harness.common.types import FloatArray
from harness.identify.hand_eye.read import LARGEST_LAG, TrackedMotion
from harness.identify.hand_eye.rotation import GyroRotation, relative_rotations

__all__ = ["check_conventions"]

SUSPECT = 0.25
"""Share of the rotations that may be left without suspicion."""
BETTER = 0.5
"""What another convention leaves, over what the right one would, to be named."""
_LAGS = 9  # tried between both ends of the range of lags
_DEGREE = np.pi / 180


@dataclass(frozen=True)
class _Convention:
    """What somebody may have recorded instead, and what to do about it."""

    name: str
    cure: str
    change: Callable[[TrackedMotion], TrackedMotion]


def _rates(factor: float) -> Callable[[TrackedMotion], TrackedMotion]:
    return lambda recorded: replace(recorded, rate=factor * recorded.rate)


def _inverted(recorded: TrackedMotion) -> TrackedMotion:
    return replace(recorded, attitude=recorded.attitude.inv())


_CONVENTIONS = (
    _Convention(
        "the rates are in deg/s",
        "write rate_x [deg/s] into the headings",
        _rates(_DEGREE),
    ),
    _Convention(
        "the rates are in rad/s",
        "write rate_x [rad/s] into the headings",
        _rates(1 / _DEGREE),
    ),
    _Convention(
        "the axes of the rates are left-handed, or the rates have the opposite sign",
        "reverse the sign of one axis of the rates, or of all three",
        _rates(-1.0),
    ),
    _Convention(
        "the attitudes are those of the tracker seen from the coils, or their scalar is the last",
        "reverse the signs of em_attitude_x, y and z, or name the columns in the order x, y, z, w",
        _inverted,
    ),
)


def check_conventions(recorded: TrackedMotion) -> None:
    """Check that rates and attitudes are of one motion, by the conventions that they are read by.

    Raises:
        SteadytipError: they are not; with the convention that would fit, if one does.
    """
    given = _share_left(recorded)
    if given <= SUSPECT:
        return
    others = [(_share_left(each.change(recorded)), each) for each in _CONVENTIONS]
    left, best = min(others, key=lambda pair: pair[0])
    fault = (
        f"recording {recorded.path}: rates and attitudes are not of one motion as they are read: "
        f"{100 * given:.0f} % of the turns of half a second are left after the best rotation "
        f"between them, and {100 * SUSPECT:.0f} % at most is what noise and distortion leave"
    )
    if left < BETTER * given and left <= SUSPECT:
        share = f"{100 * left:.1f} % are left by another convention"
        raise SteadytipError(f"{fault}. {share}: {best.name}; {best.cure}")
    raise SteadytipError(
        f"{fault}. No other unit, order, sign or handedness fits either: check that both columns "
        "belong to the same instrument, and that their clocks are the same"
    )


def _share_left(recorded: TrackedMotion) -> float:
    """Return what is left of the body's turns after the best rotation to those of the coils."""
    return min(_shares(recorded))


def _shares(recorded: TrackedMotion) -> Iterator[float]:
    turns = GyroRotation(recorded, np.zeros(3))
    for lag in np.linspace(-LARGEST_LAG, LARGEST_LAG, _LAGS):
        moved = turns.at(recorded.measured + lag, np.zeros(3))
        body, coils = relative_rotations(moved, recorded.attitude, recorded.measured)
        yield _left(body, coils)


def _left(body: FloatArray, coils: FloatArray) -> float:
    _, distance = Rotation.align_vectors(body, coils)
    return float(distance / np.sqrt(np.sum(body**2)))
