"""How fast a sweep goes: runs in a second with one and with two workers.

Workers that start are not counted: time passes from when each has finished its first run.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from harness.reproduce.item import Figure
from harness.sweep.run import sweep

__all__ = ["figures", "throughput"]

SCENARIO = "closed_loop_sweep"
WORKERS = (1, 2)
_WANTED = 1000 / 60.0  # runs of 10 s in a second, on two cores
_RATIO = 1.8


def throughput(workers: int, runs: int, seconds: float, fuse: bool = True) -> tuple[float, float]:
    """Runs in a second, and processor time of a run in the median [s].

    Args:
        workers: processes.
        runs: that are timed, beside the first one of each worker.
        seconds: simulated time of each [s].
        fuse: whether parts are fused into one FMU.
    """
    seen: list[tuple[float, int]] = []

    def progress(done: int, _runs: int, failed: int) -> None:
        assert not failed
        if done >= workers:
            seen.append((time.perf_counter(), done))

    with tempfile.TemporaryDirectory(prefix="steadytip-") as folder:
        found = sweep(
            SCENARIO,
            runs=runs + workers,
            overrides={"seconds": seconds},
            out=Path(folder),
            workers=workers,
            fuse=fuse,
            page=False,
            progress=progress,
        )
        cpu = float(np.median(found.values("cpu")))
    (begun, first), (ended, last) = seen[0], seen[-1]
    return (last - first) / (ended - begun), cpu


def figures(runs: int = 60, seconds: float = 10.0, repeats: int = 2) -> Iterator[Figure]:
    """Throughput with one and with two workers, the best of some interleaved repeats, and ratios.

    Args:
        runs: that are timed each time.
        seconds: simulated time of each [s].
        repeats: of each.
    """
    best = dict.fromkeys(WORKERS, 0.0)
    ratios, cpu = [], []
    for _ in range(repeats):
        found = {n: throughput(n, runs, seconds) for n in WORKERS}
        rates = {n: rate for n, (rate, _) in found.items()}
        cpu.append(found[1][1])
        best = {n: max(best[n], rates[n]) for n in WORKERS}
        ratios.append(rates[2] / rates[1])
    setting = f"{SCENARIO}, runs of {seconds:g} s, figures of merit included"
    for n in WORKERS:
        wanted = f", wanted {_WANTED:.1f} for runs of 10 s" if n == 2 else ""
        name = f"sweep, {n} worker{'s' if n > 1 else ''}"
        yield Figure("bench", name, "1/s", None, best[n], f"{setting}{wanted}")
    text = f"{setting}, best of {repeats}, wanted {_RATIO}"
    yield Figure("bench", "sweep, two workers over one", "", None, max(ratios), text)
    text = f"{setting}, one worker, wanted 120 for runs of 10 s"
    yield Figure("bench", "sweep, processor time of a run", "ms", None, 1e3 * min(cpu), text)
    alone, _ = throughput(1, max(runs // 4, 4), seconds, fuse=False)
    name = "sweep, 1 worker, parts not fused"
    yield Figure("bench", name, "1/s", None, alone, f"{setting}, not fused")
