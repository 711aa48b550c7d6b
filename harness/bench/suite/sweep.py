"""Runs of a sweep, with their figures of merit, on one worker and on two.

The scenario is `closed_loop_sweep`, whose runs are 10 s long. Time passes from when each worker has
finished its first run. `1000 runs` is what so many would take at that rate. Processor time of a run
is the worker's own, and lets off what other processes took. Arithmetic in two processes that share
nothing is the most that two workers could reach on this machine at that time.
"""

import os

import pytest

from harness.bench import probes
from harness.bench.session import Bench
from harness.bench.timing import counting
from harness.sweep.speed import SCENARIO, throughput

_ONE, _TWO, _APART = "one worker", "two workers", "one worker, FMUs not fused"
_ROWS = {_ONE: (1, True), _TWO: (2, True), _APART: (1, False)}
_RUN = "a run"
_SECONDS = 10.0


@pytest.fixture(scope="module")
def built() -> None:
    """Build the container."""
    throughput(1, 1, 1.0)


@pytest.mark.parametrize("row", _ROWS)
def bench_sweep(bench: Bench, turn: int, row: str, built: None) -> None:
    """Measure some ten runs for each worker."""
    workers, fuse = _ROWS[row]
    cores = os.cpu_count() or 1
    if workers > cores:
        pytest.skip(f"{workers} workers want as many cores, there is {cores}")
    seconds = 1.0 if bench.quick else _SECONDS
    runs = workers * (6 if bench.quick else 20)
    setting = f"{SCENARIO}, {seconds:g} s"
    shares: list[float] = []

    def each() -> float:
        rate, share = throughput(workers, runs, seconds, fuse)
        shares.append(share)
        return 1.0 / rate

    spent = bench.time(row, _RUN, counting(each), unit="ms", rounds=1, setting=setting, best=True)
    bench.add(row, "processor time of a run", [1e3 * share for share in shares], "ms")
    bench.add(row, "runs a second", [1e3 / run for run in spent], "")
    wanted = "at most 60 s" if row == _TWO and not bench.quick else ""
    bench.add(row, "1000 runs", spent, "s", wanted=wanted)
    if row == _TWO:
        bench.ratio(_ONE, "over two workers'", (_ONE, _RUN), (_TWO, _RUN), "at least 1.8")


def bench_machine(bench: Bench, turn: int) -> None:
    """Measure what two processes that share nothing reach over one."""
    seconds = 0.2 if bench.quick else 1.0
    one, two = (probes.arithmetic_rate(seconds, processes) for processes in (1, 2))
    bench.add("arithmetic alone", "over two workers'", two / one, "")
