"""FMUs in processes of their own: the same signals, and a run that survives what they do."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import steadytip as st
from fmu_src import pack
from harness.common.errors import PartError
from harness.parts.fmu import FmuPart
from harness.parts.isolated import ending
from harness.parts.protocols import RunContext
from tests.harness.conftest import MODES, PackProbe, WriteScenario
from tests.waiting import wait_until

PAIR = """
[part.good]
fmu = PROBE
isolate = {isolate}
gain = 3.0
[part.bad]
fmu = PROBE
isolate = {isolate}
gain = 0.7
mode = {mode}
at = 0.5
{extra}
[[wire]]
from = "good.count"
to = "bad.add"
[[wire]]
from = "bad.y"
to = "good.u"
delay = 1
[[wire]]
from = "good.off"
to = "bad.on"
"""


def pair(mode: str = "gain", isolate: bool = True, extra: str = "") -> str:
    return PAIR.format(mode=MODES[mode], isolate=str(isolate).lower(), extra=extra)


def run(path: Path, tmp_path: Path, **more) -> st.Result:
    return st.run(path, out=tmp_path / "out", report=False, **more)


def test_signals_are_the_same_bit_for_bit(write_scenario: WriteScenario, tmp_path):
    alone = run(write_scenario(pair(isolate=False)), tmp_path)
    apart = run(write_scenario(pair(isolate=True)), tmp_path)
    assert alone.table.equals(apart.table)
    assert apart.metadata.parts["bad"]["isolated"]
    assert not alone.metadata.parts["bad"]["isolated"]


@pytest.mark.parametrize("flavour", ["native", "python"])
def test_a_model_of_ours_gives_the_same_isolated(flavour, tmp_path):
    if flavour == "python":
        pytest.importorskip("pythonfmu")
    path = pack.build(["Wflc"], flavour)["Wflc"]
    signals = []
    for isolate in (False, True):
        part = FmuPart("wflc", {"fmu": str(path), "isolate": isolate}, seed=3)
        connected = [port.name for port in part.inputs]
        u, y = np.zeros(len(connected)), np.zeros(len(part.outputs))
        seen = []
        try:
            part.start(RunContext(1e-3, 300, tmp_path), connected, [True] * len(connected), u, y)
            for k in range(300):
                u[:] = 1e-4 * np.sin(2 * np.pi * 10.0 * k * 1e-3 + np.arange(len(u)))
                part.advance(k * 1e-3, 1e-3)
                seen.append(y.copy())
        finally:
            part.close()
        signals.append(np.array(seen))
    assert np.any(signals[0] != 0.0)
    assert np.array_equal(*signals)


@pytest.mark.parametrize(
    ("mode", "text"),
    [
        ("fails", r"fmi2DoStep returned Error\. The FMU says: no more after 0.5 s"),
        ("is_fatal", "fmi2DoStep returned Fatal"),
        ("gives_nan", "its output 'y' is nan"),
        pytest.param(
            "segfaults",
            r"the process of probe\.fmu was ended by SIG(SEGV|BUS|ILL) during its step",
            marks=pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals"),
        ),
        ("exits", r"the process of probe\.fmu ended with exit code 3 during its step"),
    ],
)
def test_what_an_fmu_does_ends_its_part_and_keeps_the_record(mode, text, write_scenario, tmp_path):
    with pytest.raises(PartError, match=text) as caught:
        run(write_scenario(pair(mode)), tmp_path)
    error = caught.value
    assert str(error).startswith("part 'bad' ended the run at t = 0.5 s: ")
    assert (error.part, error.time) == ("bad", 0.5)
    assert np.array_equal(error.result.signals("good.count"), np.arange(1, 501))
    assert st.read(tmp_path / "out").time[-1] == pytest.approx(0.499)


def test_a_hang_is_ended_with_its_process(write_scenario, tmp_path):
    begun = time.perf_counter()
    with pytest.raises(
        PartError,
        match=r"'bad' did not come back from its step at t = 0.5 s .*step_limit of 3 s\. "
        "Its process was ended",
    ) as caught:
        run(write_scenario(pair("hangs", extra="step_limit = 3.0")), tmp_path)
    assert time.perf_counter() - begun < 15.0
    assert len(caught.value.result.time) == 500
    assert children_of(os.getpid()) == []


def test_a_crash_while_it_initialises_is_named(write_scenario, tmp_path):
    with pytest.raises(PartError, match=r"part 'bad' does not start: .* during its initialis"):
        run(write_scenario(pair("crashes_to_start")), tmp_path)


def test_an_fmu_that_is_refused_says_why(pack_probe: PackProbe, write_scenario, tmp_path):
    path = pack_probe(('guid="probe-1"', 'guid="other"'))
    text = f'[part.p]\nfmu = "{path.as_posix()}"\nisolate = true\n'
    with pytest.raises(
        PartError, match=r"part 'p' does not start.*the GUID is 'other', not 'probe-1'"
    ):
        run(write_scenario(text), tmp_path)


def test_isolate_is_yes_or_no(write_scenario, tmp_path):
    with pytest.raises(st.SteadytipError, match="'isolate' = 'yes'"):
        run(write_scenario('[part.p]\nfmu = PROBE\nisolate = "yes"\n'), tmp_path)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (-9, "was ended by SIGKILL"),
        (-99, "was ended by signal 99"),
        (7, "ended with exit code 7"),
        (0xC0000005, "ended with exit code 0xc0000005"),
    ],
)
def test_endings_in_words(code, text):
    assert ending(code) == text


def children_of(pid: int) -> list[int]:
    """Processes below one, but for multiprocessing's own tracker."""
    if not Path("/proc").is_dir():
        pytest.skip("no /proc here to look for processes in")
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            command = (folder / "cmdline").read_text()
            if parent == pid and "spawn_main" in command:
                found.append(int(folder.name))
    return found


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.fixture
def long_run(write_scenario, tmp_path):
    """A run of two isolated parts in a process of its own, under way."""
    path = write_scenario(pair(), head="seconds = 3600.0\nstep_size = 1e-3\n")
    code = "from harness.cli.main import main; main()"
    process = subprocess.Popen(
        [
            *(sys.executable, "-c", code, "run", str(path)),
            *("--out", str(tmp_path / "out"), "--no-report"),
        ],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    stream = tmp_path / "out" / "results.arrows"
    wait_until(lambda: stream.exists() and stream.stat().st_size > 100_000, what="the record")
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups as on POSIX")
def test_ctrl_c_in_the_terminal_ends_the_run_in_order(long_run, tmp_path):
    """Every process of the terminal's group hears it, the children among them."""
    children = children_of(long_run.pid)
    assert len(children) == 2
    os.killpg(long_run.pid, signal.SIGINT)
    _, errors = long_run.communicate(timeout=60)
    assert long_run.returncode == 1
    assert "stopped by the user at t =" in errors
    assert "Traceback" not in errors
    assert "leaked" not in errors
    assert not any(running(child) for child in children)
    result = st.read(tmp_path / "out")
    assert np.array_equal(result.signals("good.count"), np.arange(1, len(result.time) + 1))


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_children_end_with_a_run_that_is_killed(long_run):
    children = children_of(long_run.pid)
    assert len(children) == 2
    long_run.kill()
    long_run.wait()
    wait_until(lambda: not any(map(running, children)), what="the children's end")
