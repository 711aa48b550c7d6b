"""A tick of the closed loop in this harness and in others.

The scenario `closed_loop`: eight FMUs, one tick each millisecond, the same FMU files, parameters,
wiring and step for all, each in a process of its own; blocks of ticks are taken in turns.

- The harness runs one FMU after the other and gathers inputs by wires with their delays, checks
  that outputs are finite and steps in time, and writes all of them to its record while it runs. Its
  blocks are whole runs, of which the ticks count.
- The plain loop does the same in the same order with `setReal`, `doStep`, `getReal` of fmpy, checks
  nothing and keeps all outputs in lists.
- libcosim (fixed-step algorithm, worker threads as it chooses, no observer) and Ecos (fixed-step
  algorithm, no listener) step all FMUs at once and then pass all values, so that every signal is a
  tick late. They read only outputs that are wired, and keep nothing; where libcosim keeps, its
  time-series observer has all Real and Integer outputs in memory.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from fmu_src.errors import SteadytipError
from harness.bench.other_hosts import OPENERS, HostProcess
from harness.bench.session import Bench
from harness.bench.timing import counting
from harness.scenario.load import load
from harness.ssp.export import export

_SCENARIO = "closed_loop"
_OWN, *_OTHERS = OPENERS
_TICK, _FACTOR, _RATIO = "a tick", "real-time factor", "over the harness's"
_LONGER = 10


@pytest.fixture(scope="module")
def host_processes(folder: Path) -> Iterator[dict[str, HostProcess | str]]:
    """Open all loops; for those that cannot be opened, say why."""
    ssp = export(_SCENARIO, folder / f"{_SCENARIO}.ssp")
    found: dict[str, HostProcess | str] = {}
    for index, name in enumerate(OPENERS):
        place = folder / f"contender{index}"
        place.mkdir()
        try:
            found[name] = HostProcess(name, _SCENARIO, ssp, place)
        except SteadytipError as error:
            found[name] = str(error)
    yield found
    for each in found.values():
        if isinstance(each, HostProcess):
            each.close()


@pytest.mark.parametrize("name", OPENERS)
def bench_tick(
    bench: Bench, turn: int, name: str, host_processes: dict[str, HostProcess | str]
) -> None:
    """Measure some thousand ticks."""
    process = host_processes[name]
    if isinstance(process, str):
        pytest.skip(process)
    ticks = 500 if bench.quick else 2000
    step = load(_SCENARIO).step_size
    spent = bench.time(
        name,
        _TICK,
        counting(lambda: process.block(ticks)),
        per=ticks,
        rounds=1,
        warmup=int(turn == 0),
        best=True,
    )
    own = name == _OWN
    bench.add(name, _FACTOR, [1e6 * step / each for each in spent], "", wanted="at least 20" * own)
    if not own:
        wanted = "above 1" if name.startswith(("fmpy", "libcosim")) else ""
        bench.ratio(name, _RATIO, (name, _TICK), (_OWN, _TICK), wanted)


def bench_longer(bench: Bench, turn: int, host_processes: dict[str, HostProcess | str]) -> None:
    """Test whether the cost is linear in steps."""
    process = host_processes[_OWN]
    assert isinstance(process, HostProcess)
    ticks = (500 if bench.quick else 2000) * _LONGER
    row = f"{_OWN}, {_LONGER} times as long"
    bench.time(row, _TICK, counting(lambda: process.block(ticks)), per=ticks, rounds=1, best=True)
    bench.ratio(row, _RATIO, (row, _TICK), (_OWN, _TICK), "1: linear in steps")
