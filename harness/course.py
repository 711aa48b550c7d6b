"""The course of a run through all that happens in it: a loop until then, and another from there."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from harness.errors import FaultError, PartError
from harness.loop import Loop, Moment, Outcome, Progress
from harness.parts import Adjustable, FloatArray, Reusable, Run

if TYPE_CHECKING:
    from harness.events import Event
    from harness.record import Recorder
    from harness.system import System

__all__ = ["keeping", "play", "proceed"]


def adjust(system: System, events: Sequence[Event]) -> None:
    """Set what changes now.

    Raises:
        PartError: a part refuses.
    """
    for event in events:
        part = system.parts[event.part]
        assert isinstance(part, Adjustable)
        try:
            part.adjust(event.values)
        except FaultError as error:
            t = event.tick * system.scenario.step
            text = f"part '{part.name}' ended the run at t = {t:.6g} s: {error}"
            raise PartError(part.name, t, text) from None


def proceed(
    system: System,
    run: Run,
    recorder: Recorder,
    events: Sequence[Event] = (),
    since: Moment | None = None,
    progress: Progress = lambda _done, _seconds: None,
    observe: Callable[[FloatArray], None] | None = None,
) -> Outcome:
    """Go on to the end of a run through all that happens.

    Args:
        system: its parts are in the states of `since`, and kept if anything happens.
        run: step, number of ticks, workspace.
        recorder: takes the signals of every tick.
        events: in their order; those before `since` have happened.
        since: the beginning if left out.
        progress: told simulated time done and in all [s].
        observe: takes the signals of every tick, too.
    """
    done = since.tick if since is not None else -1
    left = [event for event in events if done <= event.tick < run.steps]
    wall = 0.0
    outcome: Outcome | None = None
    try:
        for tick in sorted({event.tick for event in left if event.tick > done} | {run.steps}):
            if since is not None:
                adjust(system, [event for event in left if event.tick == since.tick])
            loop = Loop(system, run, recorder, observe=observe, since=since, until=tick)
            outcome = loop.go(progress)
            wall += outcome.wall
            since = loop.moment()
            if outcome.error is not None:
                break
        assert outcome is not None
        return replace(outcome, wall=wall)
    except PartError as error:
        return Outcome(since.tick if since is not None else 0, wall, error, ())


def play(
    system: System,
    run: Run,
    recorder: Recorder,
    progress: Progress = lambda _done, _seconds: None,
    observe: Callable[[FloatArray], None] | None = None,
) -> Outcome:
    """A whole run through all that happens; the parts are closed at its end."""
    if not system.events:
        return Loop(system, run, recorder, observe=observe).go(progress)
    with keeping(system):
        return proceed(system, run, recorder, system.events, None, progress, observe)


@contextlib.contextmanager
def keeping(system: System) -> Iterator[None]:
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
