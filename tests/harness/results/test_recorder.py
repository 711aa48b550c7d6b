"""What is on the disk after a run, whatever became of it."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import csv

import steadytip
from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError
from harness.parts.ports import Column
from harness.recordings.run_record import ARROW_TYPES, values_of
from harness.results.recorder import CHUNK, Recorder
from harness.results.run_metadata import RunMetadata
from tests.waiting import wait_until

ROOT = Path(__file__).parents[3]
ONE = "[part.a]\nfmu = PROBE\n[part.b]\nfmu = PROBE\nu = 0.1\ngain = 3.0\n"
COLUMNS = (
    Column("a.y", "Real", "m", "a length"),
    Column("a.n", "Integer", "", "a count"),
    Column("a.on", "Boolean", "", "a state"),
)


def recorded(folder: Path, ticks: int) -> Recorder:
    recorder = Recorder(folder, COLUMNS, 1e-3, RunMetadata(step_size=1e-3, title="t"))
    for k in range(ticks):
        recorder.append(np.array([0.1 * k, k, k % 2]))
    return recorder


def check(result: steadytip.Result, ticks: int) -> None:
    k = np.arange(ticks)
    assert np.array_equal(result.signals("a.y"), 0.1 * k)
    assert np.array_equal(result.signals("a.n"), k)
    assert np.array_equal(result.signals("a.on"), k % 2)
    assert np.array_equal(result.time, k * 1e-3)


@pytest.mark.parametrize("ticks", [0, 1, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK + 7])
def test_every_tick_is_in_the_record_with_units(ticks, tmp_path):
    file = recorded(tmp_path, ticks).finish(RunMetadata(step_size=1e-3, title="t"))
    assert file == tmp_path / "results.parquet"
    assert not (tmp_path / "results.arrows").exists()
    for path in (tmp_path, file):
        result = steadytip.read(path)
        check(result, ticks)
        assert result.units == {"time": "s", "a.y": "m", "a.n": "", "a.on": ""}
        assert result.metadata.title == "t"


def test_the_stream_can_be_read_while_the_run_goes_on_and_when_it_is_cut_off(tmp_path):
    recorder = recorded(tmp_path, 3 * CHUNK + 7)
    check(steadytip.read(tmp_path), 3 * CHUNK)
    data = recorder.stream.read_bytes()
    for share in (0.4, 0.7, 0.999):
        cut = tmp_path / "cut" / "results.arrows"
        cut.parent.mkdir(exist_ok=True)
        cut.write_bytes(data[: int(share * len(data))])
        result = steadytip.read(cut.parent)
        check(result, len(result.time))
        assert len(result.time) == int(3 * share) * CHUNK
    recorder.close()


def test_signals_are_read_as_they_are_asked_for_but_of_a_growing_record_at_once(tmp_path):
    recorder = recorded(tmp_path, CHUNK)
    growing = steadytip.read(tmp_path)
    assert len(growing.time) == CHUNK
    for _ in range(CHUNK):
        recorder.append(np.zeros(3))
    assert len(growing.signals("a.y")) == CHUNK
    recorder.finish(RunMetadata(step_size=1e-3))
    whole = steadytip.read(tmp_path)
    assert len(whole.signals("a.y")) == len(whole.time) == 2 * CHUNK
    assert "table" not in vars(whole)
    assert whole.table.num_columns == 4


def test_a_new_run_clears_what_an_older_one_left(tmp_path):
    recorded(tmp_path, 10).finish(RunMetadata(step_size=1e-3))
    (tmp_path / "report.html").write_text("old")
    (tmp_path / "mine.txt").write_text("stays")
    recorder = recorded(tmp_path, 5)
    assert {p.name for p in tmp_path.iterdir()} == {"results.arrows", "mine.txt"}
    recorder.finish(RunMetadata(step_size=1e-3))
    check(steadytip.read(tmp_path), 5)


def test_csv_has_units_in_its_header_and_every_digit(write_scenario, tmp_path):
    path = write_scenario(ONE, head="seconds = 0.1\nstep_size = 1e-3\n")
    result = steadytip.run(path, out=tmp_path / "out", csv=True, report=False)
    lines = (tmp_path / "out" / "results.csv").read_text().splitlines()
    assert lines[0] == '"time [s]","a.y [m]","a.count","a.off","b.y [m]","b.count","b.off"'
    assert len(lines) == 101
    table = csv.read_csv(tmp_path / "out" / "results.csv")
    assert np.array_equal(table.column("b.y [m]").to_numpy(), result.signals("b.y"))
    assert result.signals("b.y")[0] == 3.0 * 0.1


def test_a_record_tells_all_that_is_needed_to_repeat_the_run(write_scenario, tmp_path, probe):
    result = steadytip.run(write_scenario(ONE), out=tmp_path / "out", report=False)
    metadata = steadytip.read(result.path).metadata
    assert metadata.parts["a"]["guid"] == "probe-1"
    assert len(metadata.parts["a"]["sha256"]) == 64
    assert metadata.texts[0][0] == "case.toml"
    assert metadata.step_size == 1e-3
    assert metadata.ticks == 1000
    assert "fmpy" in metadata.versions
    metrics = json.loads((result.path / "metrics.json").read_text())
    assert set(metrics["real_time_factor"]) == {"value", "unit", "definition"}


def run_limited(scenario: Path, out: Path, limit: int, *more: str) -> subprocess.CompletedProcess:
    code = (
        f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}));"
        "from harness.cli.main import main; main()"
    )
    command = [sys.executable, "-c", code, "run", str(scenario), "--out", str(out), *more]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


@pytest.mark.skipif(sys.platform == "win32", reason="needs RLIMIT_FSIZE")
def test_a_full_disk_ends_the_run_and_keeps_what_was_written(write_scenario, tmp_path):
    """A file may not grow beyond 100 kB: the stream of a long run does."""
    path = write_scenario(ONE, head="seconds = 60.0\nstep_size = 1e-3\n")
    done = run_limited(path, tmp_path / "out", 100_000)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    result = steadytip.read(tmp_path / "out")
    seconds = len(result.time) * 1e-3
    assert 1.0 <= seconds <= 10.0
    assert np.array_equal(result.signals("a.count"), np.arange(1, len(result.time) + 1))
    text = done.stderr.replace("\n", " ")
    assert f"{result.file}: File too large while writing" in text
    assert f"The {seconds:g} s recorded before are in that file" in text


def fail(*_: object) -> None:
    raise OSError(errno.ENOSPC, "no space")


@pytest.mark.parametrize(
    ("writer", "failed", "kept"),
    [
        ("pyarrow.parquet.ParquetWriter.write_table", "results.parquet", "results.arrows"),
        ("harness.results.recorder._write_csv", "results.csv", "results.parquet"),
    ],
)
def test_a_disk_that_fills_at_the_end_costs_one_file(
    writer, failed, kept, write_scenario, tmp_path, monkeypatch
):
    monkeypatch.setattr(writer, fail)
    with pytest.raises(RecordError, match=f"{failed}: No space left on device.* in .*{kept}") as e:
        steadytip.run(write_scenario(ONE), out=tmp_path / "out", csv=True)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {kept}
    assert len(e.value.result.time) == len(steadytip.read(tmp_path / "out").time) == 1000


@pytest.mark.skipif(sys.platform == "win32", reason="needs RLIMIT_FSIZE")
def test_a_disk_too_full_for_the_report_keeps_the_record(write_scenario, tmp_path):
    """A report is 5 MB, the record of a second is not."""
    done = run_limited(write_scenario(ONE), tmp_path / "out", 300_000)
    assert done.returncode == 1, done.stderr
    assert "report.html" in done.stderr
    assert "The record is complete in" in done.stderr.replace("\n", " ")
    assert len(steadytip.read(tmp_path / "out").time) == 1000


def test_a_folder_that_cannot_be_written_to_is_named(write_scenario, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordError, match=r"cannot record to .*file"):
        steadytip.run(write_scenario(ONE), out=tmp_path / "file" / "out")


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_killed_process_leaves_everything_but_its_last_chunk(write_scenario, tmp_path):
    path = write_scenario(ONE, head="seconds = 3600.0\nstep_size = 1e-3\n")
    code = f"import steadytip as st; st.run({str(path)!r}, out={str(tmp_path / 'out')!r})"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    stream = tmp_path / "out" / "results.arrows"

    def has_recorded() -> bool:
        assert process.poll() is None
        return stream.exists() and stream.stat().st_size > 100_000

    wait_until(has_recorded, what="the record")
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    result = steadytip.read(tmp_path / "out")
    assert len(result.time) >= 3 * CHUNK
    assert len(result.time) % CHUNK == 0
    assert np.array_equal(result.signals("a.count"), np.arange(1, len(result.time) + 1))
    assert result.metadata.parts["a"]["guid"] == "probe-1"


def test_what_is_no_record_is_refused(tmp_path):
    (tmp_path / "results.parquet").write_text("no")
    with pytest.raises(SteadytipError, match="is not a record"):
        _ = steadytip.read(tmp_path).table
    with pytest.raises(SteadytipError, match="holds no record"):
        steadytip.read(tmp_path / "..")
    with pytest.raises(SteadytipError, match="does not exist"):
        steadytip.read(tmp_path / "gone")


def test_brackets_in_names_are_no_pattern(tmp_path):
    columns = [Column(f"a.w[{i}]", "Real", "", "") for i in (1, 2)]
    recorder = Recorder(tmp_path, columns, 1e-3, RunMetadata(step_size=1e-3))
    recorder.append(np.array([1.0, 2.0]))
    recorder.finish(RunMetadata(step_size=1e-3))
    result = steadytip.read(tmp_path)
    assert result.signals("a.w[2]") == [2.0]
    assert result.signals("a.w[?]").tolist() == [[1.0, 2.0]]


def test_an_unknown_signal_is_answered_with_the_nearest(tmp_path):
    recorded(tmp_path, 3).finish(RunMetadata(step_size=1e-3))
    with pytest.raises(SteadytipError, match=r"no signal 'a\.yy'; did you mean 'a\.y'\?"):
        steadytip.read(tmp_path).signals("a.yy")


@given(data=st.data(), kind=st.sampled_from(["Real", "Integer", "Boolean"]))
def test_values_of_a_column_are_those_of_arrow(data, kind):
    """Whatever the chunks, and slices of them, that a column is made of."""
    element = {"Real": st.floats(), "Integer": st.integers(-(2**31), 2**31 - 1)}
    lists = st.lists(st.lists(element.get(kind, st.booleans()), max_size=20), max_size=4)
    chunks = [pa.array(values, ARROW_TYPES[kind]) for values in data.draw(lists)]
    column = pa.chunked_array(chunks, ARROW_TYPES[kind])
    first = data.draw(st.integers(0, len(column)))
    column = column.slice(first, data.draw(st.integers(0, len(column) - first)))
    found, expected = values_of(column), column.to_numpy()
    assert found.dtype == expected.dtype
    assert np.array_equal(found, expected, equal_nan=kind == "Real")
    assert found.flags.writeable
