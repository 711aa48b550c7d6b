"""The closed loop as one native FMU against its eight separate ones.

`steadytip run closed_loop` with and without `--fuse`, both recorded: the ticks of a run, and a
whole run from the scenario to its metrics, without a report. From C, the container is stepped by a
host that keeps nothing. One core does all of it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.bench.samples import StepCase
from harness.bench.session import Bench
from harness.bench.stepper import SteppedFmu
from harness.bench.timing import counting
from harness.parts.fmu import FmuPart
from harness.running import run as run_scenario
from harness.scenario.load import load
from harness.system.assembly import assemble
from harness.system.container import fuse

_SCENARIO = "closed_loop"
_APART, _FUSED, _FROM_C = "separate FMUs", "container", "container, from C"
_TICK, _FACTOR = "a tick", "real-time factor"
_SECONDS = 10.0
_WANTED = "at least 300"


@pytest.fixture(scope="module")
def run(folder: Path, quick: bool) -> Callable[[str], Any]:
    """Return a function that runs one of the two and returns its result."""

    def run(row: str) -> Any:
        overrides = {"seconds": 1.0 if quick else _SECONDS, "warm_up": 0.0}
        place = folder / "container"
        fused = row == _FUSED
        return run_scenario(_SCENARIO, overrides=overrides, fuse=fused, out=place, report=False)

    run(_FUSED)  # it is built now
    return run


@pytest.fixture(scope="module")
def case(run: Callable[[str], Any], quick: bool) -> StepCase:
    """Return the container, which has no inputs."""
    system = fuse(assemble(load(_SCENARIO)))
    (part,) = system.parts.values()
    assert isinstance(part, FmuPart)
    count = 500 if quick else 5000
    table = np.empty((count, 0))
    step = system.scenario.step_size
    return StepCase(_FUSED, part.description, part.start_values, (), table, step, _SCENARIO)


def factor(bench: Bench, row: str, spent: list[float], step: float) -> None:
    """Add the real-time factor of ticks that took so long [us]."""
    wanted = "" if row == _APART else _WANTED
    bench.add(row, _FACTOR, [1e6 * step / each for each in spent], "", wanted=wanted)


@pytest.mark.parametrize("row", [_APART, _FUSED])
def bench_tick(bench: Bench, turn: int, row: str, run: Callable[[str], Any]) -> None:
    """Measure the ticks of a run."""
    metadata = run(row).metadata
    whole = counting(lambda: float(run(row).metadata.wall or 0.0))
    spent = bench.time(row, _TICK, whole, per=metadata.ticks, rounds=1, best=True)
    factor(bench, row, spent, metadata.step_size)
    if row == _FUSED:
        bench.ratio(_APART, "over the container's", (_APART, _TICK), (_FUSED, _TICK))


def bench_from_c(bench: Bench, turn: int, case: StepCase, tmp_path: Path) -> None:
    """Measure samples of the container."""
    count = len(case.table)
    with SteppedFmu(case, tmp_path) as fmu:
        spent = bench.time(
            _FROM_C, _TICK, lambda: fmu.samples(0, count), per=count, rounds=1, best=True
        )
    factor(bench, _FROM_C, spent, case.period)


@pytest.mark.parametrize("row", [_APART, _FUSED])
def bench_run(bench: Bench, turn: int, row: str, run: Callable[[str], Any]) -> None:
    """Measure a run from scenario to metrics."""
    length = f"a whole run of {1.0 if bench.quick else _SECONDS:g} s"
    bench.time(row, length, lambda: run(row), unit="s", rounds=1)
