"""Workspace of the manipulator's tip, by the forward kinematics, and its largest speed."""

import itertools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fmu_src.manipulator import parallel_3dof
from fmu_src.manipulator.parallel_3dof import Geometry

ACROSS = 24
"""Steps along each edge of the cube of strokes."""
DIRECTIONS = 2000
"""In which a sphere about the rest position is tried."""
HALVINGS = 40
"""Of its radius; the last of them is far below rounding."""
LARGEST_TRIED = 1e-3
"""Radius with which they begin [m]."""


@dataclass(frozen=True)
class Workspace:
    """Reachable places of the tip, about the one at half stroke, in frame 0.

    Attributes:
        points: of the boundary, (n, 3) [m].
        triangles: of the boundary, indices of points, (m, 3).
        edges: where one stroke moves and the others are at their ends, (12, k, 3) [m].
        sphere: radius of the largest sphere about the rest position that is all reachable [m].
    """

    points: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    sphere: float

    def extent(self, direction: np.ndarray) -> float:
        """Return the extent from end to end along a direction [m].

        Args:
            direction: unit vector, (3,).
        """
        return float(np.ptp(self.points @ direction))


def workspace() -> Workspace:
    """Compute the workspace of the shipped dimensions."""
    p = Geometry.unpack(Geometry.starts())
    longest = float(p.longest_stroke)
    strokes, triangles = _cube(ACROSS)
    edges = _edges(ACROSS)
    rest = _evaluated(parallel_3dof.forward, p, np.full((1, 3), longest / 2))[0]
    points, lines = (
        _evaluated(parallel_3dof.forward, p, longest * s.reshape(-1, 3)) - rest
        for s in (strokes, edges)
    )

    # A sphere fits when no point of it asks for a stroke out of range: the inverse tells.
    k = np.arange(DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - 2 * k / DIRECTIONS), np.pi * (1 + np.sqrt(5.0)) * k
    ball = np.column_stack(
        (np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar))
    )
    inside, outside = 0.0, LARGEST_TRIED
    for _ in range(HALVINGS):
        radius = (inside + outside) / 2
        asked = _evaluated(parallel_3dof.inverse, p, rest + radius * ball)
        fits = asked.min() >= 0 and asked.max() <= longest
        inside, outside = (radius, outside) if fits else (inside, radius)
    return Workspace(points, triangles, lines.reshape(edges.shape), inside)


def fastest(direction: np.ndarray, stroke_rate: float) -> float:
    """Return largest speed of the tip along a direction at half stroke [m/s].

    Args:
        direction: unit vector in frame 0, (3,).
        stroke_rate: fastest that each stack moves, either way [m/s].
    """
    p = Geometry.unpack(Geometry.starts())
    strokes = ca.SX.sym("strokes", 3)
    tip = ca.Function("tip", [strokes], [ca.jacobian(parallel_3dof.forward(p, strokes), strokes)])
    row = direction @ np.array(tip([float(p.longest_stroke) / 2] * 3))
    return float(stroke_rate * np.abs(row).sum())


def _evaluated(function: object, p: Geometry, places: np.ndarray) -> np.ndarray:
    """Evaluate a kinematic function at many places, (n, 3) to (n, 3)."""
    place = ca.SX.sym("place", 3)
    mapped = ca.Function("mapped", [place], [function(p, place)]).map(len(places))  # type: ignore
    return np.array(mapped(places.T)).T


def _cube(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return surface of the unit cube: points, (n, 3), and triangles, (m, 3)."""
    grid = np.linspace(0.0, 1.0, steps + 1)
    u, v = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
    corner = np.add.outer(np.arange(steps) * (steps + 1), np.arange(steps)).ravel()
    first = np.column_stack((corner, corner + 1, corner + steps + 1))
    second = np.column_stack((corner + 1, corner + steps + 2, corner + steps + 1))
    points: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for axis in range(3):
        for side in (0.0, 1.0):
            triangles.append(np.vstack((first, second)) + len(u) * len(points))
            points.append(np.insert(np.column_stack((u, v)), axis, side, axis=1))
    return np.vstack(points), np.vstack(triangles)


def _edges(steps: int) -> np.ndarray:
    """Return edges of the unit cube, (12, steps + 1, 3)."""
    grid = np.linspace(0.0, 1.0, steps + 1)
    return np.array(
        [
            np.insert(np.broadcast_to(end, (len(grid), 2)), axis, grid, axis=1)
            for axis in range(3)
            for end in itertools.product((0.0, 1.0), repeat=2)
        ]
    )
