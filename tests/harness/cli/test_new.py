"""`steadytip new`: a model with its test, good as it is written."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fmu_src.errors import SteadytipError
from harness.cli.main import app
from harness.cli.new import NewKind

ROOT = Path(__file__).parents[3]


def new(*words: str) -> str:
    done = CliRunner().invoke(app, ["new", *words])
    if done.exception:
        raise done.exception
    return done.stdout


@pytest.mark.parametrize("kind", list(NewKind))
def test_what_it_writes_builds_and_passes_its_test_in_an_empty_folder(
    kind, tmp_path, monkeypatch
) -> None:
    """As a user has it: the package is installed, and pytest knows nothing of the repository."""
    monkeypatch.chdir(tmp_path)
    assert "slow_drift.py" in new(kind, "SlowDrift")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["slow_drift.py", "test_slow_drift.py"]
    (told,) = new_build("slow_drift.py")
    assert told.is_file()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", "."]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout


def new_build(file: str) -> list[Path]:
    done = CliRunner().invoke(app, ["build", file])
    assert done.exit_code == 0, done.output
    return [Path(line) for line in done.stdout.splitlines() if line.endswith(".fmu")]


@pytest.mark.parametrize("kind", list(NewKind))
def test_what_it_writes_is_in_the_style_of_the_house(kind, tmp_path) -> None:
    new(kind, "SlowDrift", "--out", str(tmp_path))
    ruff = [sys.executable, "-m", "ruff"]
    options = ["--no-cache", "--config", str(ROOT / "pyproject.toml"), str(tmp_path)]
    for words in (["check", "--ignore", "D,ANN,I"], ["format", "--check"]):
        done = subprocess.run([*ruff, *words, *options], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


def test_files_that_are_there_are_kept(tmp_path) -> None:
    (tmp_path / "test_hum.py").write_text("mine", "utf-8")
    with pytest.raises(SteadytipError, match=r"test_hum.py exists and is kept"):
        new("model", "Hum", "--out", str(tmp_path))
    assert [f.name for f in tmp_path.iterdir()] == ["test_hum.py"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("2nd", "'2nd' must begin with a letter"),
        ("../up", "must begin with a letter"),
        ("A" * 33, "at most 32 characters"),
        ("Random", "Python has a module 'random' already"),
        ("Class", "Python has the keyword 'class' already"),
    ],
)
def test_names_that_cannot_be_are_refused(name, words, tmp_path) -> None:
    with pytest.raises(SteadytipError, match=words):
        new("plant", name, "--out", str(tmp_path))
    assert not any(tmp_path.iterdir())


def test_names_become_modules_as_they_are_read() -> None:
    from harness.cli.new import module_name

    found = {name: module_name(name) for name in ("LowPass", "EKFFilter", "Wflc2", "a_b")}
    assert found == {
        "LowPass": "low_pass",
        "EKFFilter": "ekf_filter",
        "Wflc2": "wflc2",
        "a_b": "a_b",
    }
