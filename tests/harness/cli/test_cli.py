"""The command line: what it prints, and its exit codes."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from harness.cli.main import app, main
from tests.harness.conftest import WriteScenario

ROOT = Path(__file__).parents[3]
ONE = "[part.a]\nfmu = PROBE\n[part.b]\nfmu = PROBE\n"
WIRE = '[[wire]]\nfrom = "a.y"\nto = "b.u"\ndelay = 1\n'


def call(monkeypatch, capsys, *arguments: str) -> tuple[int, str, str]:
    """Exit code, output, errors; blanks and line breaks of tables made single."""
    monkeypatch.setattr(sys, "argv", ["steadytip", *arguments])
    monkeypatch.setenv("COLUMNS", "200")
    try:
        main()
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    shown = capsys.readouterr()
    return code, re.sub(r"\s+", " ", shown.out), re.sub(r"\s+", " ", shown.err)


def test_help_imports_nothing_heavy():
    """What makes `--help` come at once, whatever the machine is doing meanwhile."""
    code = "import sys, harness.cli.main; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "casadi", "fmpy", "pyarrow", "plotly", "pydantic"}


def test_what_only_metrics_and_report_need_is_not_loaded_before_the_first_step(
    write_scenario: WriteScenario, tmp_path
):
    code = (
        "import sys, harness.loop.loop as loop; begin = loop.Loop._laid_out\n"
        "loop.Loop._laid_out = lambda self: print('loaded', *sys.modules) or begin(self)\n"
        "from harness.cli.main import main; main()"
    )
    path = write_scenario("[part.a]\nfmu = PROBE\n", head="seconds = 0.01\nstep_size = 1e-3\n")
    command = [sys.executable, "-c", code, "run", str(path), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    (line,) = [text for text in done.stdout.splitlines() if text.startswith("loaded ")]
    loaded = set(line.split())
    assert "pyarrow" in loaded
    assert not loaded & {"scipy", "plotly", "pandas", "jinja2", "harness.results.metrics"}


def test_a_folder_of_recordings_is_run_one_by_one_and_compared(
    data_dir, monkeypatch, capsys, tmp_path
):
    """Two recordings of a real hand through the shipped loop, each with a record of its own."""
    folder = tmp_path / "hands"
    folder.mkdir()
    for path in sorted((data_dir / "hand_motion_m2s2").glob("S_pointing*.csv")):
        (folder / path.name).symlink_to(path)
    code, out, _ = call(
        monkeypatch,
        capsys,
        *("run", "closed_loop", "--motion", str(folder), "--seconds", "4", "--no-report"),
        *("--out", str(tmp_path / "out")),
    )
    assert code == 0
    assert out.count("record:") == 2
    assert "mean" in out
    assert len(list((tmp_path / "out").glob("S_pointing*/results.parquet"))) == 2


def test_variants_are_run_compared_and_written(tmp_path, monkeypatch, capsys):
    """Two chains of the shipped bench for a short time; one by name prints its figures."""
    arguments = ("run", "tremor_bench", "--seconds", "6", "--out", str(tmp_path / "out"))
    both = ("--variant", "inertial-forecaster", "--variant", "shelving")
    file = tmp_path / "bench.json"
    code, out, _ = call(monkeypatch, capsys, *arguments, *both, "--json", str(file))
    assert code == 0
    assert out.index("variant a posteriori") < out.index("in band [%], mean worst")
    assert out.rindex("inertial-forecaster") < out.rindex("shelving")
    entries = json.loads(file.read_text("utf-8"))
    assert {entry["quantity"] for entry in entries} >= {"reduction in band, mean: shelving"}
    assert all(entry["source"] == "tremor_bench" for entry in entries)
    assert (tmp_path / "out" / "shelving" / "results.parquet").is_file()

    alone = ("--variant", "shelving", "--json", str(file))
    code, out, _ = call(monkeypatch, capsys, *arguments, *alone)
    assert code == 0
    assert "reduction_in_band" in out
    assert len(json.loads(file.read_text("utf-8"))) == 4  # mean and worst of two figures
    code, _, err = call(monkeypatch, capsys, *arguments, "--variant", "shelvin")
    assert code == 2
    assert "did you mean 'shelving'?" in err
    code, _, err = call(monkeypatch, capsys, "run", "closed_loop", "--json", str(file))
    assert code == 2
    assert "closed_loop has no variants to compare" in err


def test_version_is_printed():
    import fmu_src

    assert CliRunner().invoke(app, ["--version"]).output.strip() == fmu_src.__version__


def test_a_run_prints_its_figures_and_where_its_files_are(
    write_scenario: WriteScenario, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, out, _ = call(monkeypatch, capsys, "run", str(write_scenario(ONE + WIRE)))
    assert code == 0
    assert float(out.split("real_time_factor")[1].split()[0]) > 1.0
    assert "record: build/runs/case/0001/results.parquet" in out.replace("\\", "/")
    assert "report: build/runs/case/0001/report.html" in out.replace("\\", "/")
    assert (tmp_path / "build/runs/case/0001/metrics.json").is_file()


def test_overrides_on_the_command_line_are_typed_as_in_toml(
    write_scenario, tmp_path, monkeypatch, capsys
):
    import steadytip as st

    arguments = ["run", str(write_scenario(ONE)), "--out", str(tmp_path / "o"), "--no-report", "-q"]
    arguments += ["--set", "part.a.gain=2.5", "--set", "title=just words", "--seconds", "0.1"]
    code, out, _ = call(monkeypatch, capsys, *arguments)
    assert (code, out) == (0, "")
    metadata = st.read(tmp_path / "o").metadata
    assert metadata.parts["a"]["start_values"]["gain"] == 2.5
    assert metadata.title == "just words"
    assert metadata.ticks == 100


def test_a_mistake_of_the_user_ends_with_2_and_no_traceback(write_scenario, monkeypatch, capsys):
    path = write_scenario(ONE + WIRE.replace("b.u", "b.v"))
    code, _, err = call(monkeypatch, capsys, "run", str(path))
    assert code == 2
    assert "case: wire 'a.y' -> 'b.v': 'b' has no input 'v'; known: add, on, u" in err
    assert "Traceback" not in err


def test_a_set_without_a_value_is_explained(write_scenario, monkeypatch, capsys):
    code, _, err = call(monkeypatch, capsys, "run", str(write_scenario(ONE)), "--set", "seed")
    assert code == 2
    assert "--set seed: write KEY=VALUE, as in part.hand.seed=3" in err


def test_a_run_that_ends_early_ends_with_1_and_keeps_its_record(
    write_scenario, tmp_path, monkeypatch, capsys
):
    path = write_scenario(ONE + "mode = 1\nat = 0.5\n")
    code, out, err = call(monkeypatch, capsys, "run", str(path), "--out", str(tmp_path / "o"))
    assert code == 1
    assert "part 'b' ended the run at t = 0.5 s" in err
    assert "results.parquet" in out


def test_a_part_that_does_not_start_ends_with_1(write_scenario, tmp_path, monkeypatch, capsys):
    path = write_scenario(ONE + "mode = 7\n")
    code, _, err = call(monkeypatch, capsys, "run", str(path), "--out", str(tmp_path / "o"))
    assert code == 1
    assert "part 'b' does not start" in err


def test_info_shows_order_wires_units_and_delays(write_scenario, monkeypatch, capsys):
    code, out, _ = call(monkeypatch, capsys, "info", str(write_scenario(ONE + WIRE)))
    assert code == 0
    assert "│ a.y │ b.u │ 1 │ m │ 1 │" in out
    assert "inputs that keep their start value: a.u, a.add, a.on, b.add, b.on" in out


def test_info_shows_ports_parameters_units_and_limits_of_an_fmu(probe, monkeypatch, capsys):
    code, out, _ = call(monkeypatch, capsys, "info", str(probe))
    assert code == 0
    assert (
        "Probe 0.9 (probe.fmu): FMI 2.0 co-simulation, sample period 0.001 s, GUID probe-1" in out
    )
    assert "│ gain │ Real │ │ 1.0 │ -10 │ 10 │" in out
    assert "│ y │ Real │ m │" in out


@pytest.mark.usefixtures("nothing_kept")
def test_build_writes_the_fmus_that_are_asked_for(tmp_path, monkeypatch, capsys):
    code, out, _ = call(monkeypatch, capsys, "build", "PiezoStack", "--out", str(tmp_path))
    assert code == 0
    assert (tmp_path / "PiezoStack.fmu").is_file()
    assert "building PiezoStack" in out
    code, _, err = call(monkeypatch, capsys, "build", "PiezoStak", "--out", str(tmp_path))
    assert code == 2
    assert "PiezoStack" in err
