"""A run in segments, from event to event: a loop until then, and another from there."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from harness.common.errors import FaultError, PartError
from harness.loop.loop import Checkpoint, Loop, LoopOutcome, Progress, SignalSink
from harness.parts.protocols import Adjustable, Reusable, RunContext

if TYPE_CHECKING:
    from harness.system.assembly import System
    from harness.system.events import Event

__all__ = ["keep_instances", "run_segments", "run_until"]


def adjust(system: System, events: Sequence[Event]) -> None:
    """Set what changes now.

    Raises:
        PartError: a part refuses.
    """
    values: dict[str, dict[str, Any]] = {}
    for event in events:
        for name, value in event.values.items():
            place, variable = system.place(event.part, name)
            values.setdefault(place, {})[variable] = value
    for place, changes in values.items():
        part = system.parts[place]
        assert isinstance(part, Adjustable)
        try:
            part.adjust(changes)
        except FaultError as error:
            t = events[0].tick * system.scenario.step_size
            text = f"part '{part.name}' ended the run at t = {t:.6g} s: {error}"
            raise PartError(part.name, t, text) from None


def run_until(
    system: System,
    run: RunContext,
    recorder: SignalSink,
    events: Sequence[Event] = (),
    since: Checkpoint | None = None,
    until: int | None = None,
    progress: Progress = lambda _done, _seconds: None,
) -> tuple[LoopOutcome, Checkpoint | None]:
    """Go on with a run through all that happens.

    Args:
        system: its parts are in the states of `since`, and kept if anything happens.
        run: step, number of ticks, workspace.
        recorder: takes the signals of every tick.
        events: in their order; those before `since` have happened.
        since: the beginning if left out.
        until: tick to stop before, and before what happens then; the end if left out.
        progress: told simulated time done and in all [s].

    Returns:
        How it ended, and where it stands then; None if it did not even start.
    """
    done, last = (-1 if since is None else since.tick), (run.steps if until is None else until)
    left = [event for event in events if done <= event.tick < last]
    outcome, wall = LoopOutcome(max(done, 0), 0.0, None, ()), 0.0
    for tick in sorted({event.tick for event in left if event.tick > done} | {last}):
        if since is not None:
            try:
                adjust(system, [event for event in left if event.tick == since.tick])
            except PartError as error:
                return replace(outcome, wall=wall, error=error), since
        loop = Loop(system, run, recorder, since=since, until=tick)
        outcome = loop.go(progress)
        since, wall = loop.checkpoint(), wall + outcome.wall
        if outcome.error is not None:
            break
    return replace(outcome, wall=wall), since


def run_segments(
    system: System,
    run: RunContext,
    recorder: SignalSink,
    progress: Progress = lambda _done, _seconds: None,
) -> LoopOutcome:
    """Run through all events to the end, and close the parts."""
    if not system.events:
        return Loop(system, run, recorder).go(progress)
    with keep_instances(system):
        return run_until(system, run, recorder, system.events, progress=progress)[0]


@contextlib.contextmanager
def keep_instances(system: System) -> Iterator[None]:
    """Meanwhile the parts stay as they are from one loop to the next."""
    kept = [part for part in system.parts.values() if isinstance(part, Reusable)]
    for part in kept:
        part.kept = True
    try:
        yield
    finally:
        for part in kept:
            part.kept = False
            with contextlib.suppress(FaultError):
                part.release()
