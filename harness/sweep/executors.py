"""Who runs the cases: processes on this machine, each of which can be lost without the others."""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Protocol

from fmu_src.errors import SteadytipError
from harness.parts.isolated import end_with_parent, ending
from harness.sweep.worker import Base, CaseRow, Worker

if TYPE_CHECKING:
    from multiprocessing.context import BaseContext
    from multiprocessing.process import BaseProcess

    from harness.sweep.plan import SweepCase

__all__ = ["Executor", "InlineExecutor", "ProcessExecutor", "TooLong"]

_TRIES = 2
"""Processes that may end before they are there, when none ever was."""


class Executor(Protocol):
    """Workers that run one case at a time each."""

    def free(self) -> Sequence[str]:
        """Names of those that can take a case now."""

    def give(self, worker: str, case: SweepCase) -> None:
        """Have one of them run a case."""

    def take(self, seconds: float) -> Sequence[CaseRow]:
        """Return what has been finished, or lost; wait that long at most for the first [s]."""

    def close(self) -> None:
        """Send them home, whatever they are doing."""


class TooLong:
    """How long a case may take."""

    def __init__(self, seconds: float | None) -> None:
        """None: as long as it likes."""
        self.seconds = seconds

    def over(self, since: float) -> bool:
        """Return whether a case that began then has had its time."""
        return self.seconds is not None and time.monotonic() - since > self.seconds

    def row(self, number: int) -> CaseRow:
        """Return the row of a run that was lost."""
        return CaseRow(number, "lost", f"took longer than the 'timeout' of {self.seconds:g} s")


@dataclass
class _Worker:
    """A pool of one process: one that dies breaks its own pool only."""

    pool: ProcessPoolExecutor | None = None
    process: BaseProcess | None = None
    ready: Future[None] | None = None
    future: Future[CaseRow] | None = None
    number: int = -1
    since: float = 0.0


class ProcessExecutor:
    """Processes of this machine; see `Executor`."""

    def __init__(self, base: Base, workers: int, timeout: float | None = None) -> None:
        """Prepare; processes start when they get their first case.

        Args:
            base: what all cases have in common.
            workers: how many processes.
            timeout: wall-clock time that a case may take [s].
        """
        self._base = base
        self._limit = TooLong(timeout)
        self._born = False
        """Whether any process has ever started."""
        self._stillborn = 0
        self._workers = {f"process {k}": _Worker() for k in range(1, workers + 1)}

    def free(self) -> Sequence[str]:
        """See `Executor`."""
        return [name for name, worker in self._workers.items() if worker.future is None]

    def give(self, worker: str, case: SweepCase) -> None:
        """See `Executor`."""
        at = self._workers[worker]
        if at.pool is None:
            at.pool = ProcessPoolExecutor(1, _context(), _begin, (self._base,))
            before = multiprocessing.active_children()
            at.ready = at.pool.submit(_ready)
            at.future = at.pool.submit(_perform, case)
            started = [p for p in multiprocessing.active_children() if p not in before]
            at.process = started[0] if started else None
        else:
            try:
                at.future = at.pool.submit(_perform, case)
            except BrokenProcessPool:  # it died after its last case
                self._dismiss(at)
                self.give(worker, case)
                return
        at.number, at.since = case.number, time.monotonic()

    def take(self, seconds: float) -> Sequence[CaseRow]:
        """See `Executor`."""
        futures = [w.future for w in self._workers.values() if w.future is not None]
        if futures:
            concurrent.futures.wait(futures, seconds, concurrent.futures.FIRST_COMPLETED)
        rows = []
        for worker in self._workers.values():
            if worker.future is None:
                continue
            if worker.future.done():
                rows.append(self._result(worker))
            elif worker.ready is not None and not worker.ready.done():
                worker.since = time.monotonic()  # its process is still starting
            elif self._limit.over(worker.since):
                rows.append(self._limit.row(worker.number))
                self._dismiss(worker)
        return rows

    def _result(self, worker: _Worker) -> CaseRow:
        assert worker.future is not None
        assert worker.ready is not None
        try:
            row = worker.future.result()
            self._born = True
        except BrokenProcessPool:
            self._stillborn += worker.ready.exception() is not None
            if self._stillborn >= _TRIES and not self._born:
                raise SteadytipError(
                    "the processes of the sweep do not start. A script of your own calls "
                    "harness.sweep below: if __name__ == '__main__':"
                ) from None
            how = "ended"
            if worker.process is not None and worker.pool is not None:
                # The pool's thread reaps the process. An exit code can be read once only: if two
                # threads ask for it, one of them may leave 255 for the true one.
                worker.pool.shutdown(wait=True)
                if worker.process.exitcode is not None:
                    how = ending(worker.process.exitcode)
            row = CaseRow(worker.number, "lost", f"its worker's process {how}", worn=True)
        except Exception as error:  # a mistake in here: it is this run's, not the sweep's
            row = CaseRow(worker.number, "failed", f"{type(error).__name__}: {error}", worn=True)
        worker.future = None
        if row.worn:
            self._dismiss(worker)
        return replace(row, worn=False)

    def _dismiss(self, worker: _Worker) -> None:
        """End a worker's process; its next case gets a new one."""
        if worker.process is not None and worker.process.is_alive():
            worker.process.kill()
        if worker.pool is not None:
            worker.pool.shutdown(wait=False, cancel_futures=True)
        worker.pool = worker.process = worker.ready = worker.future = None

    def close(self) -> None:
        """See `Executor`."""
        for worker in self._workers.values():
            if worker.future is None and worker.pool is not None:
                worker.pool.shutdown(wait=True)
                worker.pool = None
            self._dismiss(worker)


@cache
def _context() -> BaseContext:
    """Return how processes start: as copies of one that has loaded everything, if possible."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


class InlineExecutor:
    """This process itself, one case after the other and without a time-out: for a debugger."""

    def __init__(self, base: Base) -> None:
        """Begin with nothing made.

        Args:
            base: what all cases have in common.
        """
        self._stand = Worker(base)
        self._rows: list[CaseRow] = []

    def free(self) -> Sequence[str]:
        """See `Executor`."""
        return [] if self._rows else ["this process"]

    def give(self, worker: str, case: SweepCase) -> None:
        """See `Executor`; runs it at once."""
        self._rows.append(self._stand.perform(case))

    def take(self, seconds: float) -> Sequence[CaseRow]:
        """See `Executor`."""
        rows, self._rows = self._rows, []
        return rows

    def close(self) -> None:
        """See `Executor`."""
        self._stand.close()


# ---- In the other process ----------------------------------------------------------------------

_stand: Worker | None = None


def _begin(base: Base) -> None:
    global _stand
    # Ctrl-C reaches all processes of a terminal; the sweep's own says what is to be done.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    _stand = Worker(base)


def _ready() -> None:
    """Done once the process is there."""


def _perform(case: SweepCase) -> CaseRow:
    assert _stand is not None
    return _stand.perform(case)
