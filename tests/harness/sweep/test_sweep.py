"""A sweep from the command to its table, and what becomes of it when something goes wrong."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pyarrow import parquet
from rich.console import Console
from typer.testing import CliRunner

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.cli import sweep as cli
from harness.cli.main import app
from harness.common.errors import ProblemsError, StoppedError
from harness.sweep import executors as crews
from harness.sweep.outcome import SweepResult, read
from harness.sweep.store import JOURNAL, PARQUET
from tests.waiting import wait_until

from .conftest import NOISE, alone, figures

ROOT = Path(__file__).parents[3]
CHANCE = f"""
[sweep]
runs = 12
seed = 5
[sweep.vary]
"{NOISE}" = {{ min = 1e-7, max = 1e-5, scale = "log" }}
"part.sensor.stroke" = {{ mean = 0.0, sigma = 1e-6, from = 1.0 }}
[[sweep.fault]]
wire = "sensor.measured"
kind = "offset"
value = 2e-6
at = 0.7
"""
GRID = f'[sweep]\n[sweep.vary]\n"{NOISE}" = [1e-6, 2e-6, -1.0, 3e-6]\n'
posix = pytest.mark.skipif(sys.platform == "win32", reason="needs signals of POSIX")


def swept(path: Path, folder: Path, **more) -> SweepResult:
    return st.sweep(path, **{"out": folder, "workers": 0, "page": False, **more})


def rows(outcome: SweepResult) -> list[dict]:
    """Without what a clock says."""
    return outcome.table.drop(["wall", "cpu"]).to_pylist()


def start(path: Path, folder: Path, *more: str, code: str = "") -> subprocess.Popen:
    main = "from harness.cli.main import main"
    script = f"import sys\n{main}\n{code}\nif __name__ == '__main__': main()\n"
    (folder.parent / "go.py").write_text(script)
    command = [sys.executable, str(folder.parent / "go.py"), "sweep", str(path)]
    return subprocess.Popen(
        [*command, "--out", str(folder), *more],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
    )


def journal_lines(folder: Path) -> int:
    path = folder / JOURNAL
    return path.read_bytes().count(b'\n{"run"') if path.exists() else 0


def wait_for(folder: Path, lines: int, process: subprocess.Popen) -> None:
    def has_written() -> bool:
        assert process.poll() is None, process.communicate()[0]
        return journal_lines(folder) >= lines

    wait_until(has_written, what=f"line {lines} of the journal")


def test_each_row_is_the_run_alone_that_its_command_gives(small, tmp_path):
    path = small(CHANCE)
    found = swept(path, tmp_path / "out")
    assert not found.failed
    assert found.axes == [NOISE, "part.sensor.stroke", "fault"]
    assert found.table.num_rows == 12
    for run in (0, 1, 7):
        assert figures(found, run) == alone(found, run, path, tmp_path)
    assert {row["fault"] for row in rows(found)} == {
        "none",
        "offset 2e-06 on sensor.measured from 0.7 s",
    }


def test_the_table_says_units_and_what_figures_are(small, tmp_path):
    found = swept(small(CHANCE), tmp_path / "out", runs=2)
    schema = parquet.read_schema(tmp_path / "out" / PARQUET)
    assert found.units[NOISE] == "m"
    assert found.units["drive_rate"] == "V/s"
    assert schema.field("drive_rms").metadata[b"description"].startswith(b"rms of the voltages")
    assert found.metadata["seed"] == 5
    assert found.metadata["runs"] == 2
    assert read(tmp_path / "out" / PARQUET).table.equals(found.table)


def test_a_sweep_goes_on_where_it_stopped_and_takes_more_runs(small, tmp_path):
    path, folder = small(CHANCE), tmp_path / "out"
    whole = rows(swept(path, tmp_path / "whole"))
    first = swept(path, folder, runs=5).table.to_pylist()
    told = []
    found = swept(path, folder, status=told.append)
    assert found.table.to_pylist()[:5] == first  # the clock among it: they were not run again
    assert rows(found) == whole
    assert "5 of 12 runs are there already" in told


@pytest.mark.parametrize("share", [0.02, 0.35, 0.7, 0.999])
def test_a_journal_that_was_cut_off_is_read_and_completed(small, tmp_path, share):
    path, folder = small(CHANCE), tmp_path / "out"
    whole = rows(swept(path, folder))
    journal = folder / JOURNAL
    data = journal.read_bytes()
    journal.write_bytes(data[: int(share * len(data))])
    (folder / PARQUET).unlink()
    if share > 0.3:
        cut = rows(read(folder))
        assert cut == whole[: len(cut)]
        assert 0 < len(cut) < 12
    assert rows(swept(path, folder)) == whole


def test_another_sweep_in_the_same_folder_is_refused_by_what_changed(small, tmp_path):
    folder = tmp_path / "out"
    swept(small(CHANCE), folder, runs=2)
    for changed, told in (
        ({"overrides": {"part.again.noise": 1e-7}}, "scenario part again noise"),
        ({"seed": 6}, "sweep seed"),
        ({"vary": {NOISE: [1e-6]}}, f"sweep vary {NOISE}"),
    ):
        with pytest.raises(SteadytipError, match=f"another sweep; changed since: {told}") as caught:
            swept(small(CHANCE), folder, **changed)
        assert "--fresh" in str(caught.value)
    found = swept(small(CHANCE), folder, seed=6, runs=3, fresh=True)
    assert found.table.num_rows == 3


def test_a_changed_fmu_is_refused_too(write_scenario, probe, tmp_path):
    import shutil

    own = tmp_path / "own.fmu"
    shutil.copy(probe, own)
    path = write_scenario(
        '[part.a]\nfmu = "own.fmu"\n[sweep]\n[sweep.vary]\n"part.a.gain" = [1, 2]\n'
    )
    swept(path, tmp_path / "out")
    with own.open("ab") as file:
        file.write(b"!")
    with pytest.raises(SteadytipError, match=r"changed since: file .*own\.fmu"):
        swept(path, tmp_path / "out")


def test_what_is_misspelt_is_told_before_anything_runs(small, tmp_path):
    more = (
        '[sweep]\n[sweep.vary]\n"part.sensr.noise" = [1]\n"part.sensor.nois" = [1]\n'
        '"secnods" = [1]\nseed = [1]\n"part.again.noise" = { values = [0.0], from = 0.5 }\n'
    )
    with pytest.raises(ProblemsError) as caught:
        swept(small(more), tmp_path / "out")
    told = str(caught.value)
    assert len(caught.value.problems) == 5
    for text in (
        "no part 'sensr'; did you mean 'sensor'?",
        "no variable 'nois'; did you mean 'noise'?",
        "did you mean 'seconds'?",
        "seeds of the scenario are 'seeds'",
        "'noise' cannot change in a run",
    ):
        assert text in told
    assert not (tmp_path / "out").exists()


def test_a_bad_value_in_a_grid_is_named_and_all_other_runs_are_done(small, tmp_path):
    arguments = ["sweep", str(small(GRID)), "--out", str(tmp_path / "out"), "--workers", "0"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    found = read(tmp_path / "out")
    assert [row["status"] for row in rows(found)] == ["ok", "ok", "failed", "ok"]
    assert "1 of 4 runs failed" in result.output
    assert "run 2, failed: small.toml" in result.output.replace("small:", "small.toml:")
    assert "'noise' = -1 m" in result.output
    page = (tmp_path / "out" / "sweep.html").read_text("utf-8")
    assert "Failed runs" in page
    assert "should be in [0, 0.001] m" in page


def test_the_command_varies_what_it_is_told_to(small, tmp_path):
    arguments = ["sweep", str(small()), "--workers", "0", "-q", "--no-page"]
    arguments += [
        "--vary",
        f"{NOISE}=1e-6,2e-6",
        "--vary",
        "part.again.noise={min=0, max=1e-6, points=3}",
    ]
    result = CliRunner().invoke(
        app, [*arguments, "--out", str(tmp_path / "out"), "--seconds", "1.3"]
    )
    assert result.exit_code == 0, result.output
    assert result.output == ""
    found = read(tmp_path / "out")
    assert found.metadata["method"] == "grid"
    assert [(r[NOISE], r["part.again.noise"]) for r in rows(found)] == [
        (a, b) for a in (1e-6, 2e-6) for b in (0.0, 5e-7, 1e-6)
    ]
    assert figures(found, 3) == alone(found, 3, tmp_path / "small.toml", tmp_path)


def test_a_variable_is_said_once(small):
    arguments = ["sweep", str(small()), "--vary", f"{NOISE}=1e-6", "--vary", f"{NOISE}=2e-6"]
    result = CliRunner().invoke(app, arguments)
    assert "is given twice: write all its values into one" in str(result.exception)


@pytest.mark.parametrize("width", [80, 120])
def test_figures_have_a_line_each_on_any_terminal(small, tmp_path, monkeypatch, width):
    monkeypatch.setattr(cli, "console", Console(width=width))
    arguments = ["sweep", str(small(GRID.replace("-1.0", "4e-6"))), "--workers", "0", "--no-page"]
    output = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")]).output
    assert ("most" in output) == (width > 80)
    for name in read(tmp_path / "out").summary:
        assert f"\n{name} " in output


def test_a_scenario_without_a_sweep_is_told_what_to_do(small, tmp_path):
    with pytest.raises(SteadytipError, match="give --vary KEY=VALUES, or add"):
        swept(small(), tmp_path / "out")


def test_the_page_shows_distributions_ranking_and_worst_runs_with_their_seeds(small, tmp_path):
    found = swept(small(CHANCE), tmp_path / "out", page=True, runs=40)
    page = found.page.read_text("utf-8")
    worst = found.worst(3)
    assert [w["drive_rms"] for w in worst] == sorted(found.values("drive_rms"))[::-1][:3]
    for row in worst:
        assert f"--seed {row['seed']}" in page
    for text in ("Distributions", "rank correlation", "share of variance", "Worst runs"):
        assert text in page
    assert 'src="http' not in page
    assert found.influences("drive_rms")[0].variable in {NOISE, "fault"}


# ---- Processes ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_workers_make_no_difference(small, tmp_path):
    path = small(CHANCE)
    one, two = (swept(path, tmp_path / f"{n}", workers=n) for n in (1, 2))
    assert rows(one) == rows(two) == rows(swept(path, tmp_path / "0", fuse=False))


BAD = """
[part.bad]
fmu = PROBE
u = 1.0
step_limit = 0.4
[signals]
actuator_voltage = "bad.count"
[sweep]
seeds = [1, 2]
[sweep.vary]
"part.bad.mode" = [0, MODE, 0]
"part.bad.at"   = [0.5]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "status", "told"),
    [
        (8, "lost", "its worker's process was ended by SIGSEGV"),
        (9, "lost", "its worker's process ended with exit code"),
        (3, "failed", "did not come back from its step"),
    ],
    ids=["segfaults", "exits", "hangs"],
)
@posix
def test_a_run_that_takes_its_process_along_is_lost_alone(
    write_scenario, tmp_path, mode, status, told
):
    path = write_scenario(BAD.replace("MODE", str(mode)), head="seconds = 1.5\nstep_size = 1e-3\n")
    found = swept(path, tmp_path / "out", workers=2)
    assert [row["status"] for row in rows(found)] == ["ok", "ok", status, status, "ok", "ok"]
    assert [number for number, _, _ in found.failed] == [2, 3]
    assert told in found.failed[0][2]


@pytest.mark.slow
@posix
def test_a_worker_that_is_killed_loses_its_run_only_which_is_tried_again(
    small, tmp_path, monkeypatch
):
    path, folder = small(CHANCE), tmp_path / "out"
    give = crews.ProcessExecutor.give

    def kill_during_run_5(self, worker, case):
        give(self, worker, case)
        if case.number == 5:
            self._workers[worker].process.kill()

    monkeypatch.setattr(crews.ProcessExecutor, "give", kill_during_run_5)
    found = swept(path, folder, workers=2)
    assert [number for number, _, _ in found.failed] == [5]
    assert "SIGKILL" in found.failed[0][2]
    monkeypatch.undo()
    again = swept(path, folder)
    assert not again.failed
    assert rows(again) == rows(swept(path, tmp_path / "whole"))


@pytest.mark.slow
@posix
def test_a_run_that_takes_too_long_is_lost_and_the_others_are_not(write_scenario, tmp_path):
    path = write_scenario(
        BAD.replace("MODE", "3").replace("step_limit = 0.4", "step_limit = 50.0"),
        head="seconds = 1.5\nstep_size = 1e-3\n",
    )
    found = swept(path, tmp_path / "out", workers=2, timeout=6.0)
    assert [row["status"] for row in rows(found)] == ["ok", "ok", "lost", "lost", "ok", "ok"]
    assert "'timeout' of 6 s" in found.failed[0][2]


@pytest.mark.slow
@posix
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["killed", "stopped"])
def test_an_interrupted_sweep_loses_nothing_that_was_finished(small, tmp_path, how):
    path, folder = small(CHANCE), tmp_path / "out"
    process = start(path, folder, "--runs", "400", "--workers", "1", "--seconds", "8")
    wait_for(folder, 5, process)
    before = journal_lines(folder)
    process.send_signal(how)
    output = process.communicate(timeout=30)[0]
    if how == signal.SIGINT:
        assert process.returncode == 1
        assert "the same command goes on from there" in output.replace("\n", " ")
        assert (folder / PARQUET).exists()
    kept = rows(read(folder))
    assert before <= len(kept) < 400
    runs = len(kept) + 3
    found = swept(path, folder, runs=runs, overrides={"seconds": 8.0})
    assert rows(found)[: len(kept)] == kept
    assert rows(found) == rows(
        swept(path, tmp_path / "whole", runs=runs, overrides={"seconds": 8.0})
    )


FULL = """
import resource
from harness.sweep.store import Store
add = Store.add
def full(self, row, case):
    if len(self.done) == 10:
        resource.setrlimit(resource.RLIMIT_FSIZE, (self._end + 100, self._end + 100))
    add(self, row, case)
Store.add = full
"""


@pytest.mark.slow
@posix
def test_a_full_disk_ends_the_sweep_with_a_message_and_room_lets_it_go_on(small, tmp_path):
    path, folder = small(CHANCE), tmp_path / "out"
    process = start(path, folder, "--runs", "60", "--workers", "0", "--no-page", code=FULL)
    output = process.communicate(timeout=60)[0].replace("\n", " ")
    assert process.returncode == 1, output
    assert "File too large" in output
    assert "give the same command again" in output
    assert "Traceback" not in output
    kept = rows(read(folder))
    assert len(kept) == 10
    found = swept(path, folder, runs=60)
    assert rows(found)[: len(kept)] == kept
    assert found.table.num_rows == 60


def test_ctrl_c_between_two_runs_keeps_what_there_is(small, tmp_path, monkeypatch):
    path, folder = small(CHANCE), tmp_path / "out"
    perform = crews.Worker.perform

    def stopped(self, case):
        if case.number == 4:
            raise KeyboardInterrupt
        return perform(self, case)

    monkeypatch.setattr(crews.Worker, "perform", stopped)
    with pytest.raises(StoppedError, match="4 of 12 runs are in"):
        swept(path, folder, seeds=[1])
    assert read(folder).table.num_rows == 4


@pytest.mark.slow
def test_throughput_is_of_the_runs_alone():
    from harness.sweep.speed import throughput

    (one, cost), (two, _) = (throughput(n, 6, 1.5) for n in (1, 2))
    # Not how fast: processor time of a run fits into the time it takes, and both count the same.
    assert 0.0 < cost < 2.0 / one
    assert 0.3 < two / one < 6.0


@pytest.mark.slow
def test_a_script_that_starts_itself_again_is_told_so(small, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        f"import steadytip as st\nst.sweep({str(small(CHANCE))!r}, out={str(tmp_path)!r})\n"
    )
    done = subprocess.run([sys.executable, script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert "below: if __name__ == '__main__':" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_recordings_of_a_folder_vary_too(tmp_path, recording, monkeypatch):
    folder = tmp_path / "hands"
    folder.mkdir()
    for k in (1, 2):
        lines = recording.read_text().splitlines()
        (folder / f"hand_{k}.csv").write_text("\n".join(lines[: 500 - 50 * k]) + "\n")
    path = tmp_path / "moved.toml"
    path.write_text(
        'extends = "closed_loop"\nwarm_up = 0.2\n[sweep]\nseeds = [1, 2]\nmotions = ["hands"]\n'
    )
    found = swept(path, tmp_path / "out", workers=2)
    assert found.axes == ["motion"]
    assert [row["motion"] for row in rows(found)] == ["hand_1.csv"] * 2 + ["hand_2.csv"] * 2
    for run in (0, 3):
        assert figures(found, run) == alone(found, run, path, tmp_path)


@pytest.mark.slow
@posix
def test_two_workers_halve_the_time_of_runs_that_wait(write_scenario, tmp_path):
    """Runs whose last step sleeps for 1.5 s: what is left to see is what the sweep itself adds."""
    text = (
        "[part.slow]\nfmu = PROBE\nmode = 4\nat = 1.4995\n"
        '[signals]\nactuator_voltage = "slow.count"\n'
        "[sweep]\nseeds = 4\n"
    )
    path = write_scenario(text, head="seconds = 1.5\nstep_size = 1e-3\n")

    def spent(workers: int) -> float:
        ends = []
        swept(
            path,
            tmp_path / f"{workers}",
            workers=workers,
            fuse=False,
            progress=lambda done, _runs, _failed: ends.append((done, time.monotonic())),
        )
        begun = next(at for done, at in ends if done >= workers)
        return (ends[-1][1] - begun) / (4 - workers)

    assert spent(1) / spent(2) > 1.7
