"""CAN transports and the monitor, beside the loop on the wall clock.

Frames go between two processes that do nothing else, three a sample at 1 kHz; a time on the way is
from before `send` to after `recv`. `virtual`, of python-can, joins two threads. The monitor's page
is asked four times a second while rows of 150 columns are written.
"""

from pathlib import Path

import pytest

from harness.bench import monitor, transports
from harness.bench.session import Bench

_SHORTEST = 4.0  # s


@pytest.mark.parametrize("name", transports.NAMES)
def bench_transport(bench: Bench, name: str, tmp_path: Path) -> None:
    """Send frames between two processes that do nothing else."""
    for figure in transports.figures(name, tmp_path, bench.seconds / 4):
        bench.add_figure("transport", name, figure.quantity, figure)


def bench_monitor(bench: Bench, tmp_path: Path) -> None:
    """Look at a page beside a writer of rows."""
    for figure in monitor.figures(tmp_path, max(bench.seconds / 2, _SHORTEST)):
        bench.add_figure("monitor", "", figure.quantity, figure)
