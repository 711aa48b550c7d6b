"""The other end of the bus: a scenario's world with the electronics that are in it, emulated.

A scenario that has a board in the place of FMUs says with that what the world is: the part as it
was before, the parts that it replaces, and whatever these need within a sample. The emulated board
is a loop of its own over just those parts, on the wall clock, with the board's end of the bus in
the place of estimator and controller. It shares no clock, no memory and no state with the loop.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.errors import SteadytipError
from harness.can.device_node import DeviceNode
from harness.can.fault_injection import InjectedFault
from harness.common.errors import StoppedError
from harness.hil.realtime import realtime
from harness.hil.ring import Ring, RingWriter
from harness.loop.loop import LoopOutcome, RealTimeClock
from harness.parts.can.board import BoardPart
from harness.parts.settings import CanSettings, RecordedSettings
from harness.results.result import Result
from harness.running import perform
from harness.scenario.replaced import can_settings, is_on_bus, replaced_parts
from harness.scenario.schema import PartTable, Scenario, SignalRoles, Wire
from harness.system.assembly import assemble

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["BUS", "board_scenario", "part_on_bus", "play"]

BUS = "bus"
"""Name of the board's end of the bus among the parts of the world."""
_FOREVER = 1e6  # s


def part_on_bus(scenario: Scenario) -> str:
    """Name of the part that is on a bus.

    Raises:
        SteadytipError: there is none, or more than one.
    """
    names = [name for name, table in scenario.parts.items() if is_on_bus(table)]
    if len(names) != 1:
        raise SteadytipError(
            f"{scenario.name} has {len(names)} parts on a CAN bus"
            f"{': ' if names else ''}{', '.join(names)}; it can be one, with 'replaces' for more"
        )
    return names[0]


def _world(scenario: Scenario) -> tuple[str, set[str]]:
    """Return the part on the bus, and all parts at the other end of it, that part among them."""
    name = part_on_bus(scenario)
    if scenario.parts[name].stands_for is None:
        raise SteadytipError(
            f"{scenario.name} does not say what '{name}' is when it is not on a bus: make it "
            f"extend a scenario in which it is an FMU, or write part.{name}.stands_for"
        )
    world = {name, *replaced_parts(scenario)}
    grown = True
    while grown:
        more = {
            wire.source.partition(".")[0]
            for wire in scenario.wires
            if wire.delay == 0 and wire.target.partition(".")[0] in world
        } - world
        grown = bool(more)
        world |= more
    return name, world


def _put_back(scenario: Scenario, name: str, entry: PartTable | None) -> dict[str, PartTable]:
    """Parts with what the one on the bus was before, or with another one in its place."""
    table = entry or scenario.parts[name].stands_for
    assert table is not None
    return {part: table if part == name else old for part, old in scenario.parts.items()}


def world_scenario(scenario: Scenario, command: Path | None = None) -> Scenario:
    """Return the world of a scenario that has one part on a bus, without the bus.

    Args:
        scenario: of the loop.
        command: record of what drives the world in the loop's place, as of a part `BUS`; without
            it nothing does.

    Raises:
        SteadytipError: it does not say what the part on the bus was before.
    """
    name, world = _world(scenario)
    wires = []
    for wire in scenario.wires:
        (start, _, output), end = wire.source.partition("."), wire.target.partition(".")[0]
        if end in world and start in world:
            wires.append(wire)
        elif end in world and command is not None:
            wires.append(Wire(f"{BUS}.{output}", wire.target, max(0, wire.delay - 1)))
    parts = {n: t for n, t in _put_back(scenario, name, None).items() if n in world}
    if command is not None:
        settings = RecordedSettings(recorded=str(command))
        parts = {BUS: PartTable("recorded", settings), **parts}
    roles = {
        role: patterns
        for role, patterns in scenario.signals
        if patterns is not None
        and all(
            any(fnmatchcase(part, text.partition(".")[0]) for part in world)
            for text in ([patterns] if isinstance(patterns, str) else patterns)
        )
    }
    return dataclasses.replace(
        scenario, parts=parts, wires=tuple(wires), signals=SignalRoles(**roles), warm_up=0.0
    )


def board_scenario(
    scenario: Scenario,
    interface: str | None,
    channel: str | None,
    recording: Path | None = None,
) -> Scenario:
    """Return the world of a scenario that has one part on a bus, seen from the other end.

    Args:
        scenario: of the loop.
        interface: of the board's end of the bus.
        channel: of that.
        recording: record of a run whose sensors are played in place of the world.

    Raises:
        SteadytipError: it does not say what the part on the bus was before.
    """
    from harness.can.database import load

    name, world = _world(scenario)
    table = scenario.parts[name]
    played = None
    if recording is not None:
        world = {name}
        played = PartTable("recorded", RecordedSettings(recorded=str(recording), of=name))
    given = can_settings(table)
    database = load(given.can)
    senders = {m.sender for m in database.messages if m.role == "sample"}
    if len(senders) != 1:
        raise SteadytipError(f"{database.path.name}: {len(senders)} nodes send samples, not one")
    interface = interface or given.interface
    channel = channel or given.channel
    settings: dict[str, Any] = {
        "can": given.can,
        "node": senders.pop(),
        "replaces": [part for part in scenario.parts if part not in world],
        **({"interface": interface} if interface else {}),
        **({"channel": channel} if channel else {}),
        # At its end of a serial line, the board is the adapter.
        **({"options": {"device": True}} if (channel or "").startswith("pty:") else {}),
    }
    bus = PartTable("can", CanSettings.model_validate(settings))
    parts = {BUS: bus, **_put_back(scenario, name, played)}
    return dataclasses.replace(scenario, parts=parts, seconds=_FOREVER)


class _BoardClock:
    """Ticks by the board's clock; see `harness.loop.loop.RealTimeClock`."""

    def __init__(self, board: BoardPart, priority: int, ready: Callable[[], None]) -> None:
        self.name = board.name
        self.watchdog = math.inf
        self._board = board
        self._ready = ready
        self._realtime = realtime(priority)
        self._over = False

    @property
    def _node(self) -> DeviceNode:
        assert self._board.node is not None
        return self._board.node

    def begin(self, idle: Callable[[], None]) -> None:
        self._idle = idle
        self._ready()
        self._realtime.__enter__()
        parent = os.getppid()
        self._over = not self._node.meet(lambda: self._over or os.getppid() != parent)

    def wait(self, tick: int) -> int:
        if self._over or self._node.ended:
            return 0
        self._idle()
        self._node.wait(tick)
        return 1

    def stop(self) -> None:
        self._over = True

    def end(self) -> None:
        self._realtime.__exit__(None, None, None)


class _BoardSession:
    """See `harness.running.HilSession`."""

    def __init__(self, pace: RealTimeClock, ring: RingWriter | None) -> None:
        self.pace: RealTimeClock = pace
        self.observe = ring.append if ring is not None else None
        self._ring = ring

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        if self._ring is not None:
            self._ring.close()
        return {}

    def extra_columns(self) -> tuple[pa.Table | None, dict[str, Any]]:
        return None, {}


def play(
    scenario: Scenario,
    folder: Path,
    *,
    interface: str | None,
    channel: str | None,
    motion: Path | None = None,
    recording: Path | None = None,
    faults: Sequence[InjectedFault] = (),
    seed: int = 0,
    drift: float = 0.0,
    priority: int = 0,
    status: Callable[[str], None] = lambda _: None,
    ready: Callable[[], None] = lambda: None,
    ring: Path | None = None,
) -> Result:
    """Be the board of a scenario until the loop stops, or Ctrl-C.

    Args:
        scenario: of the loop.
        folder: for the record of the world.
        interface: of the board's end of the bus.
        channel: of that.
        motion: recording that moves the hand.
        recording: record of a run whose sensors are played in place of the world.
        faults: what is to go wrong.
        seed: of chance in that.
        drift: by how much the board's clock is fast, relative.
        priority: of SCHED_FIFO; 0: an ordinary thread.
        status: told in a few words what is being done.
        ready: called once when the board is on the bus.
        ring: file that shows what it does while it does; see `harness.hil.ring`.

    Raises:
        RunError: it ended otherwise than that the loop stopped.
    """
    system = assemble(board_scenario(scenario, interface, channel, recording), motion, status)
    board = system.parts[BUS]
    assert isinstance(board, BoardPart)
    board.faults, board.seed, board.drift = faults, seed, drift
    pace = _BoardClock(board, priority, ready)
    writer = Ring.create(ring, system.columns, scenario.step_size) if ring is not None else None
    rig = _BoardSession(pace, writer)
    try:
        return perform(system, folder, rig=rig, report=False, status=status)
    except StoppedError as ended:
        if ended.result is None:
            raise
        return ended.result
