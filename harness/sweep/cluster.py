"""Workers of a Dask cluster as a crew.

What all cases need, FMUs among it, goes to each worker once, by a plugin of the scheduler: those
that come later get it, too, and no disk has to be shared. A case whose worker is lost is given to
another one by the scheduler itself; one that has cost several of them (`allowed-failures`) is lost.
"""

from __future__ import annotations

import hashlib
import pickle
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import fmu_src
from fmu_src.errors import SteadytipError
from harness.sweep.executors import TooLong
from harness.sweep.worker import Base, CaseRow, Worker

try:
    from distributed import Client, Future, WorkerPlugin
except ImportError:
    raise SteadytipError(
        "--scheduler needs the package 'distributed': pip install 'steadytip[cluster]'"
    ) from None

if TYPE_CHECKING:
    from harness.sweep.plan import SweepCase

__all__ = ["ClusterExecutor", "Luggage"]

_PATIENCE = 10.0  # s that a scheduler, and its first worker, get to answer
_LOOK = 1.0  # s between two looks at which workers there are


class Luggage(WorkerPlugin):
    """What a worker needs for all cases of a sweep, files as bytes.

    Attributes:
        name: that it is registered by; the same content has the same name.
    """

    def __init__(self, base: Base) -> None:
        """Read the files, each content once."""
        paths = {*base.files.values(), *([base.container] if base.container else [])}
        kept = {path: path.read_bytes() for path in paths}
        digests = {path: hashlib.sha256(data).hexdigest() for path, data in kept.items()}
        self._data = {digests[path]: data for path, data in kept.items()}
        self._places = {path: (digests[path], path.name) for path in paths}
        self._base = base
        self.name = f"steadytip-{hashlib.sha256(pickle.dumps(vars(self))).hexdigest()[:16]}"

    def setup(self, worker: Any) -> None:
        """Unpack on a worker."""
        folder = Path(tempfile.mkdtemp(prefix="steadytip-"))
        here: dict[Path, Path] = {}
        for path, (digest, name) in self._places.items():
            here[path] = folder / digest[:16] / name
            here[path].parent.mkdir(exist_ok=True)
            here[path].write_bytes(self._data[digest])
        base = replace(
            self._base,
            files={key: here[path] for key, path in self._base.files.items()},
            container=here.get(self._base.container) if self._base.container else None,
        )
        _bases[self.name] = (base, folder)

    def teardown(self, worker: Any) -> None:
        """Clean up on a worker."""
        found = _bases.pop(self.name, None)
        if found is not None:
            shutil.rmtree(found[1], ignore_errors=True)


class ClusterExecutor:
    """Threads of the workers of a cluster; see `harness.sweep.executors.Executor`."""

    def __init__(self, address: str, base: Base, timeout: float | None = None) -> None:
        """Connect, and send what all cases need.

        Args:
            address: of the scheduler.
            base: what all cases have in common.
            timeout: wall-clock time that a case may take on a worker [s].

        Raises:
            SteadytipError: no scheduler answers there, it has no workers, or other versions.
        """
        try:
            self._client = Client(address, timeout=_PATIENCE, set_as_default=False)
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            text = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise SteadytipError(
                f"--scheduler {address}: no scheduler with a worker answers: {text}"
            ) from None
        self._check_versions(address)
        self._luggage = Luggage(base)
        self._client.register_plugin(self._luggage)
        self._limit = TooLong(timeout)
        self._rows: SimpleQueue[tuple[int, Future]] = SimpleQueue()
        self._at: dict[int, tuple[str, Future, float]] = {}
        self._slots: list[str] = []
        self._looked = -_LOOK

    def _check_versions(self, address: str) -> None:
        answers = self._client.run(_version, on_error="return")
        for worker, answer in answers.items():
            if isinstance(answer, Exception):
                raise SteadytipError(
                    f"--scheduler {address}: worker {worker} cannot run Steadytip: {answer}"
                )
            if answer != fmu_src.__version__:
                raise SteadytipError(
                    f"--scheduler {address}: worker {worker} has Steadytip {answer}, here it is "
                    f"{fmu_src.__version__}; install the same on all"
                )

    def free(self) -> Sequence[str]:
        """See `Crew`; one case more than a worker has threads, so that none waits for its next."""
        if time.monotonic() - self._looked > _LOOK:
            threads: Mapping[str, int] = self._client.nthreads()
            self._slots = [f"{w}#{k}" for w, count in threads.items() for k in range(count + 1)]
            self._looked = time.monotonic()
        busy = {slot for slot, _, _ in self._at.values()}
        return [slot for slot in self._slots if slot not in busy]

    def give(self, worker: str, case: SweepCase) -> None:
        """See `Crew`."""
        future = self._client.submit(
            _perform,
            self._luggage.name,
            case,
            key=f"{self._luggage.name}-{case.number}-{time.monotonic_ns()}",
            workers=[worker.rpartition("#")[0]],
            allow_other_workers=True,
            pure=False,
        )
        self._at[case.number] = (worker, future, time.monotonic())
        future.add_done_callback(partial(_told, self._rows, case.number))

    def take(self, seconds: float) -> Sequence[CaseRow]:
        """See `Crew`."""
        rows = []
        wait = seconds
        while True:
            try:
                number, future = self._rows.get(timeout=wait) if wait else self._rows.get_nowait()
            except Empty:
                break
            wait = 0.0
            if number in self._at and self._at[number][1] is future:
                del self._at[number]
                rows.append(_row(number, future))
        for number, (_, future, since) in list(self._at.items()):
            # It may have waited for as long as another case takes.
            if self._limit.seconds is not None and self._limit.over(since + self._limit.seconds):
                del self._at[number]
                future.cancel(force=True)
                rows.append(self._limit.row(number))
        return rows

    def close(self) -> None:
        """See `Crew`."""
        for _, future, _ in self._at.values():
            future.cancel(force=True)
        self._client.unregister_worker_plugin(self._luggage.name)
        self._client.close()


def _told(rows: SimpleQueue[tuple[int, Future]], number: int, future: Future) -> None:
    rows.put((number, future))


def _row(number: int, future: Future) -> CaseRow:
    if future.status == "finished":
        row: CaseRow = future.result()
        return row
    if future.status == "error":
        error = future.exception()
        killed = type(error).__name__ == "KilledWorker"
        text = str(error).splitlines()[0] if str(error) else ""
        return CaseRow(number, "lost" if killed else "failed", f"{type(error).__name__}: {text}")
    return CaseRow(number, "lost", f"the cluster has lost it ({future.status})")


# ---- On a worker -------------------------------------------------------------------------------

_bases: dict[str, tuple[Base, Path]] = {}
_here = threading.local()


def _version() -> str:
    return fmu_src.__version__


def _perform(name: str, case: SweepCase) -> CaseRow:
    """Run a case; each thread of a worker has parts of its own."""
    if getattr(_here, "name", None) != name:
        if getattr(_here, "stand", None) is not None:
            _here.stand.close()
        _here.stand, _here.name = Worker(_bases[name][0]), name
    row: CaseRow = _here.stand.perform(case)
    return replace(row, worn=False)
