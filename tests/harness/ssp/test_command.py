"""`steadytip ssp`: what it prints, and its exit codes."""

import sys
import zipfile

import pytest

import steadytip as st
from harness.cli.main import main
from tests.harness.conftest import WriteScenario

LOOP = (
    "[part.a]\nfmu = PROBE\ngain = 0.5\n[part.b]\nfmu = PROBE\n"
    '[[wire]]\nfrom = "a.y"\nto = "b.u"\n[[wire]]\nfrom = "b.y"\nto = "a.u"\ndelay = 1\n'
)
NOTE = "the loop is closed by one sample of delay from 'b' to 'a'"


@pytest.fixture
def call(monkeypatch, capsys):
    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["steadytip", "ssp", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "200")
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    return run


def test_out_in_and_run(call, write_scenario: WriteScenario, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = write_scenario(LOOP, name="two.toml")
    assert call("export", scenario, "--set", "part.b.gain=0.25") == (0, "two.ssp\n", "")
    code, out, _ = call("import", "two.ssp", "-o", "two")
    assert (code, out.splitlines()) == (0, [NOTE, "two/two.toml"])
    code, out, _ = call("run", "two.ssp", "--seconds", "0.5", "--no-report", "--out", "results")
    assert code == 0
    assert NOTE in out
    own = st.run(scenario, overrides={"seconds": 0.5, "part.b.gain": 0.25}, out="own")
    assert st.read("results").table.drop("time").equals(own.table.drop("time"))


def test_settings_of_a_run(call, write_scenario: WriteScenario, tmp_path):
    call("export", write_scenario(LOOP), "-o", tmp_path / "x.ssp")
    code, out, _ = call(
        *("run", tmp_path / "x.ssp", "--step", "0.01", "--set", "part.a.gain=3", "--quiet"),
        *("--csv", "--out", tmp_path / "out"),
    )
    assert (code, out) == (0, "")
    metadata = st.read(tmp_path / "out").metadata
    assert metadata.step_size == 0.01
    assert metadata.parts["a"]["start_values"]["gain"] == 3
    assert (tmp_path / "out" / "results.csv").is_file()
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize("command", [("import", "-o", "x"), ("run",)])
def test_mistakes_end_with_2_and_a_sentence(command, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, *options = command
    assert call(name, "gone.ssp", *options)[::2] == (2, "SSP file gone.ssp does not exist\n")
    with zipfile.ZipFile("evil.ssp", "w") as archive:
        archive.writestr("../evil.fmu", "")
    code, _, err = call(name, "evil.ssp", *options)
    assert code == 2
    assert "evil.ssp is not unpacked" in err
    assert "Traceback" not in err
    assert not (tmp_path / "x").exists()
