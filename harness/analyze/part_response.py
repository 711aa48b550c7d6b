"""One part alone, fed what it is fed in the loop, with a probe on one input after the other.

    H[q, p] = Y_q / P_p        Y: outputs with the probe less outputs without, lines

A probe is a multisine with the input's spectrum in the loop, a tenth as large, and phases of its
own: it leaves the operating point where it is, and noise cancels. A part that can save its state
is brought there once and put back for each probe. Directional derivatives are not used: they are
those of the next sample alone, without the part's memory, and a converter's steps have derivatives
of zero.

A response found so is that of a part that is nearly linear. Beside a large signal that a part with
hysteresis or one that learns is fed, a small one meets a response that changes with the large one;
`harness.analyze.linear` sees that in the loop, and what it does about it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.analyze.multisine import (
    OMEGA,
    TRANSIENT,
    WINDOW,
    ComplexArray,
    lines_of,
    multisine,
    random_phases,
)
from harness.analyze.operating_point import AXES, OperatingPoint
from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.protocols import Part, Restorable, RunContext
from harness.parts.replay import PORTS as MOTION_PORTS
from harness.system.assembly import System

__all__ = ["TINY", "Direction", "PartResponse", "measure_part"]

TINY = 1e-30
"""In place of zero where one divides."""
FLOOR = 1e-3
"""Least amplitude of a probe's line, of its largest."""
SMALL = 0.1
"""Size of a small probe, of what moves the input in the loop."""


@dataclass(frozen=True)
class Direction:
    """Motion of a part's inputs by one probe.

    Attributes:
        label: `part.port` of the input, or the axis of a hand's motion.
        gains: for each input that moves its lines over those of the probe, (f,).
        amplitudes: of the probe's lines, (f,).
    """

    label: str
    gains: dict[str, ComplexArray]
    amplitudes: FloatArray


@dataclass(frozen=True)
class PartResponse:
    """Frequency response of one part about its operating signals.

    Attributes:
        part: its name.
        inputs: labels of the directions, (p).
        outputs: `part.port`, (q).
        response: (f, q, p).
        restored: whether its state was saved and restored.
        departure: of its outputs alone, without a probe, from those in the loop; largest, in
            multiples of an output's standard deviation.
    """

    part: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    response: ComplexArray
    restored: bool
    departure: float


@dataclass(frozen=True)
class _PartInputs:
    """Inputs of a part: names of the connected ones, whether initialised, values (n, connected)."""

    connected: list[str]
    initialised: list[bool]
    values: FloatArray


def measure_part(
    make: Callable[[], Part],
    system: System,
    operation: OperatingPoint,
    workspace: Path,
    progress: Callable[[float], None],
) -> PartResponse:
    """Measure one part.

    Args:
        make: gives the part anew.
        system: the loop that it is part of, the hand moved by a recording.
        operation: signals of the loop.
        workspace: folder for unpacked FMUs.
        progress: called with the share that is done.

    Raises:
        SteadytipError: the part does not take a probe.
    """
    part = make()
    feed = _feed(part, system, operation)
    directions = list(_directions(part, system, operation, feed))
    outputs = tuple(f"{part.name}.{port.name}" for port in part.outputs)
    step = system.scenario.step_size
    first = max(len(operation.time) - round((WINDOW + TRANSIENT) / step), 0)
    time, usual = operation.time[first:], feed.values[first:]
    response = np.zeros((len(OMEGA), len(outputs), len(directions)), dtype=complex)
    with _player(part, make, feed, first, system, operation, workspace) as (play, restored):
        base = play(usual)
        recorded = operation.signals[first:, [operation.names.index(name) for name in outputs]]
        difference = np.abs(base - recorded).max(axis=0, initial=0.0)
        departure = float(np.max(difference / np.maximum(recorded.std(axis=0), TINY), initial=0.0))
        for number, direction in enumerate(directions):
            phases = random_phases(system.scenario.seed, number, *part.name.encode())
            probe = SMALL * direction.amplitudes * np.exp(1j * phases)
            values = usual.copy()
            for name, gain in direction.gains.items():
                values[:, feed.connected.index(name)] += multisine(time, time[0], probe * gain)
            response[:, :, number] = lines_of(time, play(values) - base) / probe[:, None]
            progress((number + 1) / len(directions))
    labels = tuple(direction.label for direction in directions)
    return PartResponse(part.name, labels, outputs, response, restored, departure)


def _feed(part: Part, system: System, operation: OperatingPoint) -> _PartInputs:
    links = system.wiring.into(part.name)
    into = [links[port.name] for port in part.inputs if port.name in links]
    values = np.empty((len(operation.time), len(into)))
    for column, link in enumerate(into):
        given = operation.signal(str(link.source))
        # Before the first tick a delayed wire holds the initial value: the first, very nearly.
        values[:, column] = np.concatenate(
            [np.full(link.delay, given[0]), given[: len(given) - link.delay]]
        )
    return _PartInputs(
        [link.target.port for link in into], [link.delay == 0 for link in into], values
    )


def _directions(
    part: Part, system: System, operation: OperatingPoint, feed: _PartInputs
) -> Iterator[Direction]:
    """Yield the inputs that respond to the hand; for the hand, the axes of its motion."""
    if part.name in system.motions:
        for i, axis in enumerate(AXES):
            names = [port.name for port in MOTION_PORTS[i::3] if port.type == "Real"]
            derivatives = [np.ones_like(OMEGA, dtype=complex), 1j * OMEGA, -(OMEGA**2) + 0j]
            gains = dict(zip(names, derivatives, strict=True))
            yield Direction(f"{part.name}.{axis}", gains, operation.motion[i])
    sources = {port: str(link.source) for port, link in system.wiring.into(part.name).items()}
    real = {port.name for port in part.inputs if port.type == "Real"}
    for name in feed.connected:
        if name not in real or sources[name].startswith(f"{part.name}.motion."):
            continue
        amplitudes = operation.amplitudes[:, operation.names.index(sources[name])]
        if amplitudes.max() > 0.0:
            floor = FLOOR * amplitudes.max()
            yield Direction(
                f"{part.name}.{name}",
                {name: np.ones_like(OMEGA, dtype=complex)},
                np.maximum(amplitudes, floor),
            )


_PlayPart = Callable[[FloatArray], FloatArray]
"""Inputs from the start of a probe on, (n, connected), to outputs, (n, outputs)."""


@contextmanager
def _player(
    part: Part,
    make: Callable[[], Part],
    feed: _PartInputs,
    first: int,
    system: System,
    operation: OperatingPoint,
    workspace: Path,
) -> Iterator[tuple[_PlayPart, bool]]:
    """Provide a function that plays the part from the start of a probe, always from one state."""
    step = system.scenario.step_size
    count = len(operation.time)
    run = RunContext(step, count, workspace)
    started: list[Part] = []

    def brought_there(part: Part) -> tuple[FloatArray, FloatArray]:
        u, y = feed.values[0].copy(), np.zeros(len(part.outputs))
        started.append(part)
        part.start(run, feed.connected, feed.initialised, u, y)
        advance = part.advance
        for k in range(first):
            u[:] = feed.values[k]
            advance(k * step, step)
        return u, y

    def on(part: Part, u: FloatArray, y: FloatArray, values: FloatArray) -> FloatArray:
        out = np.empty((count - first, len(y)))
        advance = part.advance
        for row, k in enumerate(range(first, count)):
            u[:] = values[row]
            advance(k * step, step)
            out[row] = y
        return out

    saved: Any = None
    try:
        can = isinstance(part, Restorable) and part.prepare_to_return()
        u, y = brought_there(part)
        if can:
            try:
                saved = part.save()  # type: ignore[attr-defined]
                part.restore(saved)  # type: ignore[attr-defined]
            except FaultError:  # it says that it can, and cannot
                saved = None

        def play(values: FloatArray) -> FloatArray:
            if saved is not None:
                part.restore(saved)  # type: ignore[attr-defined]
                return on(part, u, y, values)
            fresh = make()
            its_u, its_y = brought_there(fresh)
            answer = on(fresh, its_u, its_y, values)
            started.remove(fresh)
            fresh.close()
            return answer

        yield play, saved is not None
    except FaultError as error:
        raise SteadytipError(
            f"part '{part.name}' alone, fed as in the loop, does not take the probe: {error}"
        ) from None
    finally:
        if saved is not None:
            part.free(saved)  # type: ignore[attr-defined]
        for one in started:
            one.close()
