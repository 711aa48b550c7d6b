"""How fast a sweep goes; `steadytip bench sweep` compares one worker with two.

Workers that start are not counted: time passes from when each has finished its first run.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from harness.sweep.execution import sweep

__all__ = ["SCENARIO", "throughput"]

SCENARIO = "closed_loop_sweep"


def throughput(workers: int, runs: int, seconds: float, fuse: bool = True) -> tuple[float, float]:
    """Return runs in a second, and processor time of a run in the median [s].

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
