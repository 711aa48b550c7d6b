"""What the README shows works as shown."""

import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from fmu_src.kit import Runner
from fmu_src.pack.codegen.c_source import sources
from fmu_src.pack.compiler import host
from fmu_src.pack.fmu import archive, native
from fmu_src.pack.fmu.description import content_guid
from harness.cli.main import app
from harness.scenario.load import load
from harness.system.assembly import assemble

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_the_model_on_the_page_becomes_a_valid_fmu(tmp_path, monkeypatch) -> None:
    (text,) = [block for block in blocks("python") if "MODEL = " in block]
    path = tmp_path / "low_pass.py"
    path.write_text(text, "utf-8")
    spec = importlib.util.spec_from_file_location("low_pass", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "low_pass", module)
    spec.loader.exec_module(module)
    settled = Runner(module.MODEL).run(5000, {"position": [1.0, 2.0, 3.0]})["slow"][-1]
    assert settled == pytest.approx([1.0, 2.0, 3.0])
    guid = content_guid(module.MODEL, sources(module.MODEL, ""))
    files = native.files(module.MODEL, guid, [host()])
    archive.write(tmp_path / "LowPass.fmu", files)
    assert validate_fmu(str(tmp_path / "LowPass.fmu")) == []


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
