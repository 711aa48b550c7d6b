"""Measurements in a process of their own: memory, builds, speed."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import ParamSpec, TypeVar

__all__ = ["arithmetic_rate", "builds", "in_new_process", "instances", "runs"]

_P = ParamSpec("_P")
_T = TypeVar("_T")
_MEBI = 2.0**20


def in_new_process(action: Callable[_P, _T], *arguments: _P.args, **named: _P.kwargs) -> _T:
    """Run an action in a new process and return its result."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(action, *arguments, **named).result()


def _resident() -> float:
    """Return the memory of this process that is in RAM [MiB]."""
    import psutil

    gc.collect()
    return float(psutil.Process().memory_info().rss) / _MEBI


def instances(fmus: dict[str, Path], count: int) -> dict[str, tuple[float, float]]:
    """Measure the memory of instances that have begun.

    Args:
        fmus: by name.
        count: instances of each beside the first.

    Returns:
        Of the first with its library, and of a further one [MiB].
    """
    import numpy as np

    from harness.parts.description import describe
    from harness.parts.fmi import Instance

    found = {}
    none = np.empty(0)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for name, path in fmus.items():
            description = describe(path)
            sizes, alive = [_resident()], []
            for group in (1, count):
                for _ in range(group):
                    alive.append(Instance(description, name, Path(folder)))
                    alive[-1].begin(1.0, {}, (), none)
                    y = np.zeros(len(description.outputs))
                    alive[-1].stepper((), none, y)(0.0, description.step or 1e-3)
                sizes.append(_resident())
            found[name] = (sizes[1] - sizes[0], (sizes[2] - sizes[1]) / count)
            for instance in alive:
                instance.close()
    return found


def runs(scenario: str, seconds: float, count: int) -> tuple[list[float], float | None]:
    """Measure the memory of a process that runs a scenario again and again.

    Args:
        scenario: path of a scenario file, or the name of a shipped one.
        seconds: length of each run [s].
        count: number of runs.

    Returns:
        (count + 1,) after the imports and after each run; and what the last one adds while it
        ticks, beginning with its second second [MiB], None where it is too short to tell.
    """
    from harness.running import run

    sizes: list[float] = [_resident()]
    within: list[float] = []

    def look(done: float, _seconds: float) -> None:
        if done > 1.0:
            within.append(_resident())

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for _ in range(count):
            overrides = {"seconds": seconds, "warm_up": 0.0}
            within.clear()
            run(scenario, overrides=overrides, out=folder, report=False, progress=look)
            sizes.append(_resident())
    return sizes, within[-1] - within[0] if len(within) > 1 else None


def builds(folder: Path, names: Sequence[str]) -> dict[str, float]:
    """Time to build FMUs [s], one after the other, by name.

    Args:
        folder: that has or gets the `build` folder.
        names: of models.
    """
    from fmu_src import pack

    pack.model_names()  # the models' modules are loaded
    spent = {}
    with contextlib.chdir(folder):
        for name in names:
            begun = time.perf_counter()
            pack.build([name])
            spent[name] = time.perf_counter() - begun
    return spent


def arithmetic_rate(seconds: float, processes: int) -> float:
    """Return rounds of plain arithmetic in a second, of processes that share nothing.

    Args:
        seconds: how long each spins [s].
        processes: how many do so at once.
    """
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_spin, [0.05] * processes))  # they are there
        return sum(pool.map(_spin, [seconds] * processes))


def _spin(seconds: float) -> float:
    rounds, value = 0, 0.5
    begun = time.perf_counter()
    while (spent := time.perf_counter() - begun) < seconds:
        for _ in range(1000):
            value = 3.7 * value * (1.0 - value)
        rounds += 1
    return rounds / spent
