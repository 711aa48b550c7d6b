"""Interrupts work whoever started the suite: also under a parent that ignores SIGINT."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGINT of a terminal")
def test_ctrl_c_ends_a_run_under_a_parent_that_ignores_it() -> None:
    test = "tests/harness/loop/test_loop.py::test_ctrl_c_ends_the_run_in_order"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", test],
        cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout
