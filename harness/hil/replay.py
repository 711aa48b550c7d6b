"""A log of raw frames run through the loop again.

The node of the loop is the one that ran on the bus; the frames, the time at which each tick began
and the state of the channel come from the log. What is sent is compared with what was sent.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Generator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmu_src.errors import SteadytipError
from harness.can.channel import Address, ChannelState
from harness.can.controller_node import ControllerNode
from harness.can.cycle import TICK, Tick
from harness.can.database import Database
from harness.can.frame_log import Entry, read_log
from harness.can.timing import Timing
from harness.can.transmission import SentMessage
from harness.hil.board import part_on_bus
from harness.hil.clock import Session, TickClock
from harness.loop.loop import LoopOutcome, Progress
from harness.parts.can.feed import FeedPart
from harness.recordings.run_record import PARQUET
from harness.results.result import Result
from harness.running import perform
from harness.scenario import load as scenarios
from harness.system.assembly import assemble

__all__ = ["Replay", "replay"]


@dataclass(frozen=True)
class Replay:
    """A log that was run again.

    Attributes:
        result: of the new run.
        commands: frames of the command that the log holds.
        differing: those among them that the new run sent otherwise, or not.
        signals: how many columns both records have; 0 without a record beside the log.
        changed: names of those among them whose values differ in any bit.
    """

    result: Result
    commands: int
    differing: int
    signals: int
    changed: tuple[str, ...]

    @property
    def is_identical(self) -> bool:
        """True if everything came out as before, bit for bit."""
        return not self.differing and not self.changed


class _LoggedNode(ControllerNode):
    """A node whose bus is a log."""

    def __init__(
        self, database: Database, name: str, timing: Timing, step: float, entries: Generator[Entry]
    ) -> None:
        super().__init__(database, name, Address(None, None), timing, step)
        self._entries = entries
        self._next = next(entries, None)
        self._state = ChannelState.OPEN
        self.commands = 0
        self.differing = 0

    def _pop(self) -> Entry | None:
        entry, self._next = self._next, next(self._entries, None)
        return entry

    def open(self) -> None:
        """There is nothing to open."""

    def steps(self, index: int) -> int:
        """Run the cycle with the frames until the next tick of the log; return its steps or 0."""
        unsent = 0
        while (entry := self._pop()) is not None:
            if entry.tick is not None:
                self.commands += unsent
                self.differing += unsent
                _, _, state, overran = TICK.unpack(entry.tick)
                self._state = ChannelState(state)
                tick = Tick(index, entry.time, self._state, bool(overran))
                self.input = self.cycle.cycle((), tick)
                return self.input.steps
            if not entry.was_sent:
                self.reception.receive(entry.message)
                continue
            # Sent then and not now: a heartbeat while the board was waited for, or a difference.
            command = self.cycle.command_message
            unsent += command is not None and self._has(entry, command)
            self.reception.sent(sum(h.seconds for h in self._heartbeats if self._has(entry, h)))
        return 0

    def _has(self, entry: Entry, sent: SentMessage) -> bool:
        return entry.was_sent and entry.message.arbitration_id == sent.message.id

    def _send(self, sent: SentMessage, data: bytes) -> int | None:
        """Compare with what was sent; the log tells when, too."""
        entry = self._next
        is_command = sent is self.cycle.command_message
        self.commands += is_command
        if entry is None or not self._has(entry, sent):
            self.differing += is_command and self._state is ChannelState.OPEN
            return None
        self._pop()
        self.differing += is_command and bytes(entry.message.data) != data
        self.reception.sent(sent.seconds)
        return entry.time

    def close(self) -> None:
        """Leave the log."""
        self._entries.close()


class _LogClock(TickClock):
    """Ticks of a log, as fast as they go."""

    def __init__(self, feed: str, node: _LoggedNode) -> None:
        super().__init__(nullcontext(), feed)
        self._node = node

    def _wait(self, tick: int) -> int:
        return self._node.steps(tick)


class _ReplaySession(Session):
    """See `harness.running.HilSession`."""

    def __init__(self, clock: TickClock, node: ControllerNode) -> None:
        super().__init__(clock)
        self._node = node

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        return {"hil": {"conditions": {}, "notes": [], **self._node.cycle.metadata()}}


def replay(
    log: Path,
    scenario: str | os.PathLike[str] | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    out: Path | None = None,
    report: bool = True,
    status: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _done, _seconds: None,
) -> Replay:
    """Run a log of raw frames through the loop again, as fast as it goes.

    Args:
        log: of a run on the wall clock, `frames.log` or `frames.blf`.
        scenario: that it was; by default what the record beside the log says.
        overrides: of the scenario; likewise.
        out: folder of the results; `replay` beside the log by default.
        report: write `report.html`.
        status: told in a few words what is being done.
        progress: told the time done and in all [s].

    Raises:
        RunError: the run ended early; its `result` holds what was recorded until then.
        SteadytipError: no such log, or nothing that says what scenario it is of.
    """
    before = Result(log.parent / PARQUET) if (log.parent / PARQUET).is_file() else None
    if scenario is None:
        if before is None:
            raise SteadytipError(
                f"there is no {PARQUET} beside {log} that tells the scenario: name it, as in "
                "steadytip replay LOG closed_loop_can"
            )
        scenario = before.metadata.scenario_file
        overrides = {**before.metadata.overrides, **(overrides or {})}
    checked = scenarios.load(scenario, overrides)
    name = part_on_bus(checked)
    system = assemble(checked, None, status)
    feed = system.parts[name]
    assert isinstance(feed, FeedPart)
    step = checked.step_size
    node = _LoggedNode(feed.database, feed.keys.node, checked.hil, step, read_log(log))
    system = dataclasses.replace(system, parts={**system.parts, **feed.on_bus(node)})
    result = perform(
        system,
        out or log.parent / "replay",
        session=_ReplaySession(_LogClock(name, node), node),
        report=report,
        status=status,
        progress=progress,
    )
    common, changed = _compared(before, result)
    return Replay(result, node.commands, node.differing, common, changed)


def _compared(before: Result | None, after: Result) -> tuple[int, tuple[str, ...]]:
    if before is None:
        return 0, ()
    common = [n for n in after.table.column_names if n in set(before.table.column_names)]
    same = {n: after.table.column(n).equals(before.table.column(n)) for n in common}
    return len(common), tuple(name for name in common if not same[name])
