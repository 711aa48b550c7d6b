"""What a tick does: one plan, which the Python loop and the native loop both execute.

All outputs of a tick stand in one vector, in the order of the scenario's parts. Behind it stand the
vectors of the last ticks, as many as the longest wire delay, so that the inputs of a part are one
indexed copy whatever the delays are.

| symbol | meaning |
| --- | --- |
| width | number of outputs of all parts |
| depth | 1 + the longest delay of a wire [ticks] |
| history | (depth * width,) outputs of this tick, of the one before, ... |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.common.endpoint import Endpoint
from harness.common.types import FloatArray
from harness.parts.protocols import Part
from harness.system.assembly import System

__all__ = ["PartStep", "TickBuffers", "TickPlan", "plan_ticks"]


@dataclass(frozen=True)
class PartStep:
    """Step of one part within a tick.

    Attributes:
        part: that takes it.
        connected: names of the inputs that wires drive, in the order of the part's inputs.
        initialised: for each of them whether its value is known before the first step.
        sources: places of their values in the history, (len(connected),).
        outputs: place of the part's outputs in the history.
        limit: wall-clock time that the step may take [s].
    """

    part: Part
    connected: tuple[str, ...]
    initialised: tuple[bool, ...]
    sources: NDArray[np.intp]
    outputs: slice
    limit: float


@dataclass(frozen=True)
class TickPlan:
    """Steps of a tick in run order.

    Attributes:
        steps: of the parts.
        width: number of outputs of all parts.
        depth: ticks that the history holds.
    """

    steps: tuple[PartStep, ...]
    width: int
    depth: int


class TickBuffers:
    """Memory that a plan is executed on; all arrays are views that stay where they are.

    Attributes:
        history: (depth * width,), see the module.
        inputs: of each step, (len(connected),).
        outputs: of each step, within the history.
    """

    def __init__(self, plan: TickPlan) -> None:
        """Allocate, all zero."""
        self.history: FloatArray = np.zeros(plan.depth * plan.width)
        self.inputs = [np.zeros(len(step.connected)) for step in plan.steps]
        self.outputs = [self.history[step.outputs] for step in plan.steps]


def plan_ticks(system: System) -> TickPlan:
    """Plan the ticks of a system."""
    places: dict[tuple[str, str], int] = {}
    first: dict[str, int] = {}
    for name, part in system.parts.items():
        first[name] = len(places)
        for port in part.outputs:
            places[name, port.name] = len(places)
    width = len(places)
    links = {link.target: link for link in system.wiring.links}
    steps = []
    for name in system.wiring.order:
        part = system.parts[name]
        into = [link for port in part.inputs if (link := links.get(Endpoint(name, port.name)))]
        sources = [link.delay * width + places[link.source] for link in into]
        steps.append(
            PartStep(
                part=part,
                connected=tuple(link.target.port for link in into),
                initialised=tuple(link.delay == 0 for link in into),
                sources=np.array(sources, dtype=np.intp),
                outputs=slice(first[name], first[name] + len(part.outputs)),
                limit=system.step_limits[name],
            )
        )
    depth = 1 + max((link.delay for link in links.values()), default=0)
    return TickPlan(tuple(steps), width, depth)
