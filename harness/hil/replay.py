"""A log of raw frames run through the loop again.

The node of the loop is the one that ran on the bus; the frames, the time at which each tick began
and the state of the medium come from the log. What is sent is compared with what was sent.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.errors import SteadytipError
from harness.can.channel import Address, ChannelState
from harness.can.controller_node import TURN, ControllerNode, Outgoing, Turn
from harness.can.database import Database
from harness.can.frame_log import Entry, read_log
from harness.can.timing import Timing
from harness.hil.board import part_on_bus
from harness.loop.loop import LoopOutcome, Progress, RealTimeClock
from harness.parts.can.feed import FeedPart
from harness.recordings.run_record import PARQUET
from harness.results.result import Result
from harness.running import perform
from harness.scenario import load as scenarios
from harness.system.assembly import assemble

if TYPE_CHECKING:
    import pyarrow as pa

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
        self, database: Database, name: str, policy: Timing, step: float, entries: Generator[Entry]
    ) -> None:
        super().__init__(database, name, Address(None, None), policy, step)
        self._entries = entries
        self._next = next(entries, None)
        self.commands = 0
        self.differing = 0

    def _pop(self) -> Entry | None:
        entry, self._next = self._next, next(self._entries, None)
        return entry

    def open(self) -> None:
        """There is nothing to open."""

    def meet(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Return at once: a log needs no board."""

    def wait(self, index: int) -> Turn:
        """Hear what was heard until the tick began; a turn of no steps at the end of the log."""
        unsent = 0
        while (entry := self._pop()) is not None:
            if entry.tick is not None:
                self.commands += unsent
                self.differing += unsent
                _, _, state, overran = TURN.unpack(entry.tick)
                return self.turn(index, entry.time, ChannelState(state), bool(overran))
            if not entry.was_sent:
                self.hear(entry.message)
                continue
            # Sent then and not now: a heartbeat while the board was waited for, or worse.
            unsent += self._command is not None and self._has(entry, self._command)
            self.reception.sent(sum(b.seconds for b in self._beats if self._has(entry, b)))
        return Turn(index, 0, 0, ChannelState.OPEN, False)

    def _has(self, entry: Entry, outgoing: Outgoing) -> bool:
        return entry.was_sent and entry.message.arbitration_id == outgoing.message.id

    def _send(self, outgoing: Outgoing, data: bytes) -> int | None:
        """Compare with what was sent; the log tells when, too."""
        entry = self._next
        is_command = outgoing is self._command
        self.commands += is_command
        if entry is None or not self._has(entry, outgoing):
            self.differing += is_command and self._state is ChannelState.OPEN
            return None
        self._pop()
        self.differing += is_command and bytes(entry.message.data) != data
        self.reception.sent(outgoing.seconds)
        return entry.time

    def close(self) -> None:
        """Leave the log."""
        self._entries.close()


class _LogClock:
    def __init__(self, feed: FeedPart) -> None:
        self.name = feed.name
        self.watchdog = math.inf
        self._feed = feed
        self._over = False

    def begin(self, idle: Callable[[], None]) -> None:
        pass

    def wait(self, tick: int) -> int:
        assert self._feed.node is not None
        return 0 if self._over else self._feed.node.wait(tick).steps

    def stop(self) -> None:
        self._over = True

    def end(self) -> None:
        pass


class _ReplaySession:
    """See `harness.running.HilSession`."""

    def __init__(self, clock: RealTimeClock, feed: FeedPart) -> None:
        self.clock: RealTimeClock = clock
        self.observe = None
        self._feed = feed

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        node = self._feed.node
        return {"hil": {"conditions": {}, "notes": [], **({} if node is None else node.metadata())}}

    def extra_columns(self) -> tuple[pa.Table | None, dict[str, Any]]:
        return None, {}


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
    feed.policy = checked.hil
    entries = read_log(log)
    feed.make_node = lambda feed, step: _LoggedNode(
        feed.database, feed.keys.node, feed.policy, step, entries
    )
    result = perform(
        system,
        out or log.parent / "replay",
        session=_ReplaySession(_LogClock(feed), feed),
        report=report,
        status=status,
        progress=progress,
    )
    node = feed.node
    assert isinstance(node, _LoggedNode)
    common, changed = _compared(before, result)
    return Replay(result, node.commands, node.differing, common, changed)


def _compared(before: Result | None, after: Result) -> tuple[int, tuple[str, ...]]:
    if before is None:
        return 0, ()
    common = [n for n in after.table.column_names if n in set(before.table.column_names)]
    same = {n: after.table.column(n).equals(before.table.column(n)) for n in common}
    return len(common), tuple(name for name in common if not same[name])
