"""The loop on the wall clock.

Wanted on a quiet machine with SCHED_FIFO: a latency of 300 us at the median and 1 ms at 99 %, and
3 us to decode or encode.
"""

import pytest

from harness.bench.session import Bench
from harness.hil import speed

_PACING = 2.0  # s, longest


def words(priority: int) -> str:
    """Return how a thread is scheduled."""
    return f"priority {priority}" if priority else "ordinary thread"


@pytest.mark.parametrize("priority", speed.PRIORITIES, ids=words)
@pytest.mark.parametrize("link", speed.LINKS, ids=str)
def bench_loop(bench: Bench, link: speed.BusLink, priority: int) -> None:
    """Measure latency and wake-up on each transport."""
    for figure in speed.loop_figures(link, priority, bench.seconds):
        bench.add_figure("loop", f"{link}, {words(priority)}", figure.quantity, figure)


@pytest.mark.parametrize("priority", speed.PRIORITIES, ids=words)
def bench_pacing(bench: Bench, priority: int) -> None:
    """Measure how late a loop comes back from waiting."""
    for figure in speed.pacing_figures(priority, min(bench.seconds, _PACING)):
        what, _, statistic = figure.quantity.rpartition(", ")
        bench.add_figure("pacing", f"{what}, {words(priority)}", statistic, figure)


@pytest.mark.parametrize("dbc", speed.DBCS)
def bench_codec(bench: Bench, dbc: str) -> None:
    """Measure each message of a DBC file."""
    for figure in speed.codec_figures(dbc):
        verb, _, message = figure.quantity.partition(" ")
        bench.add_figure("codec", message, verb, figure)
