"""The loop: parts run tick after tick in a thread of their own while the caller's thread watches.

One float64 vector holds the outputs of all parts. Behind it lie the vectors of the last ticks, as
many as the longest wire delay, so that gathering a part's inputs is one indexed copy whatever the
delays are. Tick k steps every part from `k * step` to `(k + 1) * step`; what is recorded at time
`k * step` are the outputs after that: the values of the sample instant in that interval.

Where every part can do without Python and nothing keeps to the wall clock, many ticks are one
native call (`harness.loop.native`), to the same bits. On the wall clock a `RealTimeClock` says when
a tick begins, and how many steps it spans.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeVar

import numpy as np

from harness.common.errors import FaultError, PartError, RunError, StoppedError
from harness.common.types import FloatArray
from harness.loop.native import NativeLoop, NativeStatus, native_steps
from harness.parts.protocols import Killable, Part, RunContext
from harness.system.assembly import System
from harness.system.tick_plan import TickBuffers, plan_ticks

__all__ = ["Checkpoint", "Loop", "LoopOutcome", "Progress", "RealTimeClock", "SignalSink"]

_T = TypeVar("_T")

_POLL = 0.05  # s between two looks of the watching thread
_CLOSING = 2.0  # s that parts get to free themselves once a run has ended

Progress = Callable[[float, float], None]
"""Told the simulated time done, and that of the whole run [s]."""


class RealTimeClock(Protocol):
    """Makes ticks keep to the wall clock.

    Attributes:
        name: part that is waited for; empty: the clock.
        watchdog: wall-clock time that the step of any part may take [s].
    """

    name: str
    watchdog: float

    def begin(self, idle: Callable[[], None]) -> None:
        """Prepare for the first tick; called in the loop's own thread.

        Args:
            idle: to be called when there is time, some times a second at least.

        Raises:
            FaultError: it cannot come.
        """

    def wait(self, tick: int) -> int:
        """Wait until a tick is to begin.

        Returns:
            Steps that it spans; 0: the run is over.

        Raises:
            FaultError: no tick will come any more.
        """

    def stop(self) -> None:
        """End the run and any waiting, as the user wants; called from another thread."""

    def end(self) -> None:
        """There is no further tick; in the loop's own thread, also after a failure."""


class SignalSink(Protocol):
    """Takes the signals of every tick, (signals,), in the order of the system's columns.

    A loop uses either `append`, or `buffer` and `commit`: many ticks are then written to where they
    stay. `results.recorder.Recorder` puts them on the disk; an array of all ticks whose rest is
    `buffer` keeps them in memory.
    """

    def append(self, signals: FloatArray) -> None:
        """Record one tick; the array is used again.

        Raises:
            RecordError: it cannot be.
        """

    def buffer(self) -> FloatArray:
        """Return memory for the next ticks, (n, signals) in C order, n > 0, for the loop alone."""

    def commit(self, rows: int) -> None:
        """Record that many rows of `buffer`.

        Raises:
            RecordError: they cannot be recorded.
        """

    def flush_idle(self) -> None:
        """There is time now; only on the wall clock.

        Raises:
            RecordError: what is held back cannot be recorded.
        """


@dataclass(frozen=True)
class Checkpoint:
    """Where a run stands between two ticks, beside the states of its parts.

    Attributes:
        tick: number of ticks done.
        history: outputs of the last ticks, as the loop keeps them.
    """

    tick: int
    history: FloatArray


@dataclass(frozen=True)
class LoopOutcome:
    """How a run ended.

    Attributes:
        ticks: recorded.
        wall: time that the ticks took [s].
        error: why it ended early; None if it did not.
        warnings: of the parts, each with the part's name.
    """

    ticks: int
    wall: float
    error: RunError | None
    warnings: tuple[str, ...]


class Loop:
    """One run of a system."""

    def __init__(
        self,
        system: System,
        run: RunContext,
        recorder: SignalSink,
        clock: RealTimeClock | None = None,
        observe: Callable[[FloatArray], None] | None = None,
        since: Checkpoint | None = None,
        until: int | None = None,
    ) -> None:
        """Lay out signals and inputs.

        Args:
            system: parts and their wiring.
            run: step, number of ticks, workspace.
            recorder: takes the signals of every tick.
            clock: the wall clock; without one, ticks follow each other at once.
            observe: takes the signals of every tick, too.
            since: moment to go on from; the parts are in its states. The beginning if left out.
            until: tick to stop before; the end of the run if left out.
        """
        self._run = run if since is None else replace(run, first=since.tick)
        self._since = since
        self._last = run.steps if until is None else until
        self._clock = clock
        self._observe = observe
        self._recorder = recorder
        self._plan = plan_ticks(system)
        self._buffers = TickBuffers(self._plan)
        self._order = [step.part for step in self._plan.steps]
        self._limits = [step.limit for step in self._plan.steps]
        self._limit_name = "step_limit"
        self._native: NativeLoop | None = None
        self._ticks = self._run.first
        self._wall = 0.0
        self._stop = False
        self._now: tuple[int, str, float, float] | None = None
        """Part that is being called, what for, simulated and wall time at the call."""
        self._error: BaseException | None = None
        self._done = threading.Event()

    def go(self, progress: Progress = lambda _done, _seconds: None) -> LoopOutcome:
        """Run to the end, or to the first failure, or until the user presses Ctrl-C.

        Failures of parts, of the disk and the user's wish to stop are in the outcome; parts are
        closed in every case, but for one that hangs and cannot be ended.
        """
        threading.Thread(target=self._work, name="steadytip-loop", daemon=True).start()
        hung: Part | None = None
        # Not Thread.join: in Python 3.11, Ctrl-C during it makes a running thread look dead.
        while not self._done.is_set():
            try:
                self._done.wait(_POLL)
                done = self._native.tick if self._native is not None else self._ticks
                progress(done * self._run.step, self._run.steps * self._run.step)
                hung = self._hung()
                if hung is not None:
                    break
            except KeyboardInterrupt:
                self._halt()
                if self._clock is not None:
                    self._clock.stop()
        self._close(hung)
        error = self._error
        if error is not None and not isinstance(error, RunError):
            raise error
        warnings = tuple(
            f"part '{part.name}' warns: {text}"
            for part in self._order
            for text in getattr(part, "warnings", ())
        )
        return LoopOutcome(self._ticks, self._wall, error, warnings)

    def _halt(self) -> None:
        self._stop = True
        if self._native is not None:
            self._native.stop()

    def _called(self) -> tuple[int, str, float, float] | None:
        """See `_now`; for the watching thread."""
        if self._native is None:
            return self._now
        called = self._native.called()
        if called is None:
            return None
        index, tick, since = called
        return index, "its step", tick * self._run.step, since

    def _hung(self) -> Part | None:
        """Return the part whose call has not come back in time, and that cannot be made to."""
        now = self._called()
        if now is None:
            return None
        index, doing, t, since = now
        # Some time more: a call that comes back a little late reports itself, with its duration.
        late = time.perf_counter() - since > self._limits[index] + 2 * _POLL
        if not late or now != self._called():
            return None
        part = self._order[index]
        text = (
            f"part '{part.name}' did not come back from {doing} at t = {t:.6g} s within its "
            f"{self._limit_name} of {self._limits[index]:g} s. "
        )
        self._halt()  # if it comes back after all
        self._error = PartError(part.name, t, f"{text}It is left hanging; the run ends here.")
        if not (isinstance(part, Killable) and part.kill()):
            if self._native is not None:
                with contextlib.suppress(RunError):  # the part's failure came first
                    self._take(self._native)
            return part
        # The call comes back now, and with it the loop's own thread: nothing is left behind.
        self._error = PartError(part.name, t, f"{text}Its process was ended, and so is the run.")
        return None

    def _work(self) -> None:
        try:
            # Overflow in the finiteness test of _tick is what it looks for, no reason to warn.
            with np.errstate(all="ignore"):
                self._start()
                self._native = self._laid_out()
                begun = time.perf_counter()
                try:
                    self._paced(self._tick if self._native is None else self._run_native)
                finally:
                    self._wall = time.perf_counter() - begun
        except BaseException as error:  # handed to the watching thread, which raises it
            if self._error is None:
                self._error = error
        finally:
            self._now = None
            self._done.set()

    def _paced(self, tick: Callable[[], None]) -> None:
        if self._clock is None:
            tick()
            return
        self._limits[:] = [min(limit, self._clock.watchdog) for limit in self._limits]
        self._limit_name = "watchdog of the wall clock"
        try:
            self._waited(partial(self._clock.begin, self._recorder.flush_idle), 0.0)
            tick()
        finally:
            self._clock.end()

    def _waited(self, wait: Callable[[], _T], t: float) -> _T:
        """Return what a clock says; its failure is that of the part it waits for."""
        assert self._clock is not None
        self._now = None
        try:
            return wait()
        except FaultError as error:
            name = self._clock.name
            who = f"part '{name}'" if name else "the clock"
            raise PartError(name, t, f"{who} ended the run at t = {t:.6g} s: {error}") from None

    def _start(self) -> None:
        history, width = self._buffers.history, self._plan.width
        for index, step in enumerate(self._plan.steps):
            part, u, y = step.part, self._buffers.inputs[index], self._buffers.outputs[index]
            self._now = (index, "its initialisation", 0.0, time.perf_counter())
            history.take(step.sources, out=u, mode="clip")
            try:
                part.start(self._run, step.connected, step.initialised, u, y)
            except FaultError as error:
                raise PartError(
                    part.name, 0.0, f"part '{part.name}' does not start: {error}"
                ) from None
            self._check_finite(index, 0.0)
            self._check_time(index, 0.0)
        for at in range(width, len(history), width):
            history[at : at + width] = history[:width]
        if self._since is not None:
            history[:] = self._since.history

    def checkpoint(self) -> Checkpoint:
        """Return where the run stands, now that `go` has come back."""
        return Checkpoint(self._ticks, self._buffers.history.copy())

    def _laid_out(self) -> NativeLoop | None:
        """Return the run as native calls; None where it has to go tick by tick."""
        self._now = None
        if self._clock is not None or self._observe is not None:
            return None
        calls = native_steps(self._plan)
        if calls is None:
            return None
        run = self._run
        return NativeLoop(self._plan, self._buffers, calls, run.step, run.first, self._last)

    def _run_native(self) -> None:
        native = self._native
        assert native is not None
        how = NativeStatus.FULL
        while how is NativeStatus.FULL:
            if self._stop:
                native.stop()
            how = native.go(self._recorder.buffer())
            if self._error is not None:
                return  # given up: another thread has taken what there was
            self._take(native)
        t = native.tick * self._run.step
        if how is NativeStatus.FAILED:
            try:
                native.blame()
            except FaultError as error:
                raise self._failed(native.part, t, error) from None
        elif how is NativeStatus.NOT_FINITE:
            self._check_finite(native.part, t)
        elif how is NativeStatus.LATE:
            raise self._late(native.part, "its step", t, native.took)
        elif self._stop:
            raise StoppedError(f"stopped by the user at t = {t:.6g} s")

    def _take(self, native: NativeLoop) -> None:
        """Record what has been run since the last time."""
        rows = native.tick - self._ticks
        self._ticks = native.tick
        if rows:
            self._recorder.commit(rows)

    def _failed(self, index: int, t: float, error: FaultError) -> PartError:
        name = self._order[index].name
        return PartError(name, t, f"part '{name}' ended the run at t = {t:.6g} s: {error}")

    def _tick(self) -> None:
        history, width = self._buffers.history, self._plan.width
        signals, older, newer = history[:width], history[width:], history[:-width]
        delayed = len(older) > 0
        take, record, clock = history.take, self._recorder.append, time.perf_counter
        order = [
            (i, step.sources if len(u) else None, u, step.part.advance, y, y.dot, limit)
            for i, (step, u, y, limit) in enumerate(
                zip(
                    self._plan.steps,
                    self._buffers.inputs,
                    self._buffers.outputs,
                    self._limits,
                    strict=True,
                )
            )
        ]
        step, finite, real_time = self._run.step, math.isfinite, self._clock
        observe = self._observe
        k, last, spanned, h = self._run.first, self._last, 1, self._run.step
        while k < last:
            t = k * step
            if real_time is not None:
                spanned = self._waited(partial(real_time.wait, k), t)
                if not spanned:
                    break
                h = spanned * step
            since = clock()
            for index, sources, u, advance, y, dot, limit in order:
                self._now = (index, "its step", t, since)
                if sources is not None:
                    take(sources, out=u, mode="clip")
                try:
                    advance(t, h)
                except FaultError as error:
                    raise self._failed(index, t, error) from None
                # The square is finite if every output is, unless one is beyond 1e154.
                if not finite(dot(y)):
                    self._check_finite(index, t)
                now = clock()
                if now - since > limit:
                    self._check_time(index, t)
                since = now
            self._now = None
            for _ in range(spanned):
                record(signals)
                if observe is not None:
                    observe(signals)
                if delayed:
                    older[:] = newer
            k += spanned
            self._ticks = k
            if self._stop:
                break
        if self._stop:
            raise StoppedError(f"stopped by the user at t = {k * step:.6g} s")

    def _check_finite(self, index: int, t: float) -> None:
        part = self._order[index]
        for port, value in zip(part.outputs, self._buffers.outputs[index], strict=True):
            if not math.isfinite(value):
                raise PartError(
                    part.name,
                    t,
                    f"part '{part.name}' ended the run at t = {t:.6g} s: its output "
                    f"'{port.name}' is {value}",
                )

    def _check_time(self, index: int, t: float) -> None:
        assert self._now is not None
        _, doing, _, since = self._now
        took = time.perf_counter() - since
        if took > self._limits[index]:
            raise self._late(index, doing, t, took)

    def _late(self, index: int, doing: str, t: float, took: float) -> PartError:
        name = self._order[index].name
        return PartError(
            name,
            t,
            f"part '{name}' took {took:.3g} s for {doing} at t = {t:.6g} s, more than its "
            f"{self._limit_name} of {self._limits[index]:g} s",
        )

    def _close(self, hung: Part | None) -> None:
        """Free the parts, in a thread again: freeing can hang, too."""
        closed = threading.Event()

        def close() -> None:
            for part in self._order:
                if part is not hung:
                    with contextlib.suppress(FaultError):
                        part.close()
            closed.set()

        threading.Thread(target=close, name="steadytip-close", daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            closed.wait(_CLOSING)
