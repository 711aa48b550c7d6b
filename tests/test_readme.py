"""What the README shows works as shown."""

import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from fmu_src.kit import Runner
from fmu_src.pack import archive, native
from fmu_src.pack.compiled import CACHE
from fmu_src.pack.csource import sources
from fmu_src.pack.description import content_guid
from harness.cli import app

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
    files = native.files(module.MODEL, guid, [native.host()], CACHE)
    archive.write(tmp_path / "LowPass.fmu", files)
    assert validate_fmu(str(tmp_path / "LowPass.fmu")) == []


def test_the_scenario_on_the_page_is_toml() -> None:
    (text,) = blocks("toml")
    assert tomllib.loads(text)["extends"] == "closed_loop"


def test_every_command_on_the_page_exists() -> None:
    commands = set(re.findall(r"steadytip ([a-z]+)", TEXT))
    assert {"run", "build", "validate", "info", "ssp"} <= commands
    for command in commands:
        assert CliRunner().invoke(app, [command, "--help"]).exit_code == 0, command


def test_every_path_on_the_page_exists() -> None:
    for path in re.findall(r"`((?:fmu_src|plants|harness|tests)/[\w/.]*)`", TEXT):
        assert (ROOT / path).exists(), path
