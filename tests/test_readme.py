"""What the README shows works as shown."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

import steadytip as st
from fmu_src.kit import Runner
from fmu_src.pack.own_models import load_own_model
from harness.cli.main import app
from harness.scenario.load import load
from harness.system.assembly import assemble

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture
def typed(tmp_path, monkeypatch) -> Path:
    """The model on the page as a file in a folder that holds nothing else, the current one."""
    (text,) = [block for block in blocks("python") if "MODEL = " in block]
    path = tmp_path / "lowpass.py"
    path.write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    return path


SCENARIO = """
title = "README's model behind the hand"
seconds = 1.0
step_size = 1e-3

[part.hand]
fmu = "Hand"

[part.filter]
fmu = "lowpass.py"
corner = 0.5

[[wire]]
from = "hand.body_{axis}"
to = "filter.position_{axis}"
"""


def test_the_model_on_the_page_becomes_a_valid_fmu(typed) -> None:
    """Word by word, in an empty folder beside the installed package."""
    model = load_own_model(str(typed))
    settled = Runner(model).run(5000, {"position": [1.0, 2.0, 3.0]})["slow"][-1]
    assert settled == pytest.approx([1.0, 2.0, 3.0])
    lines = re.search(r"```\n(steadytip build lowpass.py.*?)```", TEXT, re.DOTALL)
    main = [sys.executable, "-c", "from harness.cli.main import main; main()"]
    for line in lines[1].splitlines():
        words = [
            name
            for word in shlex.split(line, comments=True)[1:]
            for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])
        ]
        done = subprocess.run([*main, *words], capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, (line, done.stdout, done.stderr)
    (path,) = Path().glob("build/fmus/native/LowPass-*.fmu")
    assert validate_fmu(str(path)) == []


@pytest.mark.parametrize("flavour", ["native", "python"])
def test_the_model_on_the_page_runs_in_a_scenario_of_another_folder(typed, flavour) -> None:
    folder = typed.parent / "mine"
    folder.mkdir()
    typed.rename(folder / typed.name)
    scenario = folder / "mine.toml"
    text = SCENARIO.replace("corner", f'flavour = "{flavour}"\ncorner')
    head, wire = text.split("[[wire]]")
    wires = ["[[wire]]" + wire.format(axis=axis) for axis in "xyz"]
    scenario.write_text(head + "".join(wires), "utf-8")
    result = st.run(scenario)
    moved, slow = result.signals("hand.body_?"), result.signals("filter.slow_?")
    expected = Runner(load_own_model(str(folder / typed.name)), {"corner": 0.5}).run(
        len(moved), {"position": moved}
    )
    np.testing.assert_allclose(slow, expected["slow"], rtol=1e-9, atol=1e-15)
    if flavour == "native":
        fused = st.run(scenario, fuse=True)
        np.testing.assert_array_equal(fused.signals("filter.slow_?"), slow)


def test_the_scenario_and_the_fault_on_the_page_are_what_they_say() -> None:
    text, fault = blocks("toml")
    assert tomllib.loads(text)["extends"] == "closed_loop"
    system = assemble(load("closed_loop", tomllib.loads(fault)))
    assert [(e.tick, e.part) for e in system.events] == [(5000, "fault_sensors_volts_a3y")]


def test_every_command_on_the_page_exists() -> None:
    commands = set(re.findall(r"(?<!import )steadytip ([a-z]+)", TEXT))
    assert {"run", "build", "validate", "info", "ssp"} <= commands
    for command in commands:
        assert CliRunner().invoke(app, [command, "--help"]).exit_code == 0, command


def test_every_path_on_the_page_exists() -> None:
    for path in re.findall(r"`((?:fmu_src|plants|harness|tests)/[\w/.]*)`", TEXT):
        assert (ROOT / path).exists(), path


def section(title: str) -> str:
    return TEXT.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]


def test_one_changed_part_puts_a_board_in_the_place_of_the_sensors(tmp_path) -> None:
    (diff,) = re.findall(r"```diff\n(.*?)```", section("Boards on a CAN bus"), re.DOTALL)
    lines = diff.splitlines()
    removed = [line[1:] for line in lines if line.startswith("-")]
    added = [line[1:] for line in lines if line.startswith("+")]
    assert len(added) == 3
    shipped = (ROOT / "harness" / "scenario" / "library" / "closed_loop.toml").read_text("utf-8")
    head = "[part.sensors]\n"
    assert head + removed[0] in shipped
    path = tmp_path / "rig.toml"
    path.write_text(shipped.replace(head + removed[0], head + "\n".join(added)), "utf-8")
    system = assemble(load(path))
    assert type(system.parts["sensors"]).__name__ == "FeedPart"
    assert len(system.parts["sensors"].outputs) > 20


@pytest.mark.slow
@pytest.mark.xdist_group("wall-clock")
@pytest.mark.skipif(sys.platform == "win32", reason="the buses need Unix sockets and terminals")
def test_the_commands_on_boards_run_as_they_stand() -> None:
    """Word by word, in the order of the page; the last two at the same time."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", section("Boards on a CAN bus"), re.M | re.S)
    alone, together = (text for language, text in fenced if not language)
    main = [sys.executable, "-c", "from harness.cli.main import main; main()"]

    def command(line: str) -> list[str]:
        words = shlex.split(line, comments=True)
        assert words[0] == "steadytip"
        return [*main, *words[1:]]

    for line in alone.splitlines():
        done = subprocess.run(command(line), cwd=ROOT, capture_output=True, text=True, timeout=200)
        assert done.returncode == 0, (line, done.stdout, done.stderr)
        assert "Traceback" not in done.stderr, line
    board, loop = (command(line) for line in together.splitlines())
    at_the_board = subprocess.Popen(board, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert at_the_board.stdout is not None
    while "on the bus" not in at_the_board.stdout.readline():
        assert at_the_board.poll() is None
    done = subprocess.run(loop, cwd=ROOT, capture_output=True, text=True, timeout=200)
    said, _ = at_the_board.communicate(timeout=100)
    assert done.returncode == 0, done.stderr
    assert at_the_board.returncode == 0
    assert "reduction_in_band" in said
