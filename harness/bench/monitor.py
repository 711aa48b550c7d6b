"""Cost of the monitor, for itself and for the loop that it looks at."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from harness.bench.monitor_load import (
    BOARD,
    LOOP,
    ROLES,
    STEP,
    board_rows,
    columns,
    loop_rows,
    refresh,
)
from harness.can.precise_sleep import sleep_until
from harness.common.figures import Figure
from harness.hil.monitor import start_monitor
from harness.hil.ring import Ring
from harness.parts.ports import Column

__all__ = ["figures"]

_WIDTH = 150
_EACH = 0.25  # s between two looks of a page
_BEFORE = 1.0  # s until it is open


def figures(folder: Path, seconds: float) -> Iterator[Figure]:
    """Write rows of 150 columns at 1 kHz, alone and with a page that asks four times a second.

    Args:
        folder: for the rings.
        seconds: how long rows are written [s].
    """
    import psutil

    for watched in (False, True):
        here = folder / f"{watched}"
        here.mkdir()
        mine, theirs = multiprocessing.Pipe()
        writer = multiprocessing.get_context("spawn").Process(
            target=_write, args=(here, seconds, theirs), daemon=True
        )
        setting = f"{_WIDTH} columns at 1 kHz, {'with the monitor' if watched else 'alone'}"
        if watched:
            with start_monitor([here / "loop.ring", here / "board.ring"], ROLES) as monitor:
                writer.start()
                process = psutil.Process(monitor.pid)
                time.sleep(_BEFORE)
                used, begun, drawn = sum(process.cpu_times()[:2]), time.perf_counter(), None
                while not mine.poll(_EACH):
                    drawn = refresh(monitor.url, drawn)["drawn"]["data"]
                spent = time.perf_counter() - begun
                share = 100 * (sum(process.cpu_times()[:2]) - used) / spent
                yield Figure(
                    "steadytip bench bus", "monitor's share of a core", "%", None, share, setting
                )
        else:
            writer.start()
        costs = mine.recv()
        writer.join()
        for words, cost in zip(("median", "99 %"), np.quantile(costs, [0.5, 0.99]), strict=True):
            quantity = f"append to the ring, {words}"
            yield Figure("steadytip bench bus", quantity, "us", None, 1e6 * cost, setting)


def _write(folder: Path, seconds: float, out: Connection) -> None:
    """Write rows on time, for so long; return what each has cost [s]."""
    count = round(seconds / STEP)
    more = [Column(f"more.port_{i}", "Real", "", "") for i in range(_WIDTH - len(LOOP))]
    loop = Ring.create(folder / "loop.ring", [*columns(LOOP), *more], STEP)
    board = Ring.create(folder / "board.ring", columns(BOARD), STEP)
    table = np.hstack([loop_rows(count), np.zeros((count, len(more)))])
    truth = board_rows(count)
    spent = np.empty(count)
    begun = time.monotonic_ns()
    for k in range(count):
        sleep_until(begun + round(1e9 * STEP * k))
        board.append(truth[k])
        row = table[k]
        before = time.perf_counter()
        loop.append(row)
        spent[k] = time.perf_counter() - before
    loop.close()
    board.close()
    out.send(spent)
