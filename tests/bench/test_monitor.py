"""What the monitor costs, and what it costs the loop. `make bench`."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from harness.hil.monitor import start_monitor
from tests.harness.hil.test_monitor import ROLES, refresh

pytestmark = pytest.mark.bench

SECONDS = 10.0
WIDTH = 150
WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from harness.hil.ring import Ring
from harness.record import Column
from tests.harness.hil.test_monitor import BOARD, LOOP, board_rows, columns, loop_rows

folder, seconds, width = Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
count = round(1e3 * seconds)
more = [Column(f"more.port_{i}", "Real", "", "") for i in range(width - len(LOOP))]
loop = Ring.create(folder / "loop.ring", columns(LOOP) + more, 1e-3)
board = Ring.create(folder / "board.ring", columns(BOARD), 1e-3)
table = np.hstack([loop_rows(count), np.zeros((count, len(more)))])
truth = board_rows(count)
spent = np.empty(count)
clock = time.perf_counter
begun = clock()
for k in range(count):
    due = begun + 1e-3 * k
    time.sleep(max(0.0, due - clock() - 1.5e-4))
    while clock() < due:
        pass
    board.append(truth[k])
    row = table[k]
    before = clock()
    loop.append(row)
    spent[k] = clock() - before
loop.close()
np.save(folder / "spent.npy", spent)
"""


def cpu(pid: int) -> float:
    """CPU time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="CPU time is read from /proc")
def test_the_monitor_beside_a_writer(tmp_path) -> None:
    """Rows of 150 columns at 1 kHz, alone and with a page that asks four times a second."""
    print()
    for watched in (False, True, False, True):
        folder = tmp_path / f"{time.monotonic_ns()}"
        folder.mkdir()
        command = [sys.executable, "-c", WRITER, str(folder), f"{SECONDS}", f"{WIDTH}"]
        names = [folder / "loop.ring", folder / "board.ring"]
        share = 0.0
        if not watched:
            subprocess.run(command, check=True)
        else:
            with start_monitor(names, ROLES) as monitor:
                writer = subprocess.Popen(command)
                drawn = None
                time.sleep(3.0)
                before, begun = cpu(monitor.pid), time.perf_counter()
                while time.perf_counter() - begun < SECONDS - 4.0:
                    drawn = refresh(monitor.url, drawn)["drawn"]["data"]
                    time.sleep(0.25)
                share = (cpu(monitor.pid) - before) / (time.perf_counter() - begun)
                assert writer.wait(60) == 0
        spent = 1e6 * np.load(folder / "spent.npy")
        half, most = np.quantile(spent, [0.5, 0.99])
        words = f"monitor shows, {100 * share:.1f} % of a core" if watched else "alone"
        print(f"append of {WIDTH} columns, {words}: p50 {half:.2f} us, p99 {most:.2f} us")
