"""Every recipe of `docs/recipes`, followed to the letter in a copy of the repository.

A block ```python file=PATH``` is written to that file, a block ```diff file=PATH``` is applied to
it (lines that begin with a blank or `-` have to stand there once), and a block ```sh``` is run
line by line.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RECIPES = ROOT / "docs" / "recipes"
COPIED = (
    "fmu_src",
    "plants",
    "harness",
    "steadytip",
    "tests",
    "docs",
    "README.md",
    "pyproject.toml",
)
BLOCK = re.compile(r"^```(\w+)(?: file=(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PROGRAMS = {
    "steadytip": "from harness.cli.main import main as run",
    "pytest": "import sys; from pytest import console_main as c; run = lambda: sys.exit(c())",
    "lint-imports": "from importlinter.cli import lint_imports_command as run",
    "python": "",
}
"""What the commands of a recipe stand for in this environment."""


@pytest.fixture
def copy(tmp_path) -> Path:
    """A copy of the repository that is found before the installed one, entry points and all."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            skip = shutil.ignore_patterns("__pycache__", ".*_cache")
            shutil.copytree(ROOT / name, tmp_path / name, ignore=skip)
        else:
            shutil.copy(ROOT / name, tmp_path)
    return tmp_path


def install(folder: Path) -> None:
    """Stand in for `pip install -e .`: the entry points that the copy's pyproject.toml declares."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"console_scripts": project["scripts"], **project.get("entry-points", {})}
    metadata = folder / "steadytip-0.dist-info"
    metadata.mkdir(exist_ok=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: steadytip\nVersion: 0\n")
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in points.items())
             for group, points in groups.items()]  # fmt: skip
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    shutil.copytree(_licenses(), metadata / "licenses", dirs_exist_ok=True)
    (metadata / "RECORD").write_text("steadytip-0.dist-info/licenses/LICENSE,,\n")


def _licenses() -> Path:
    from importlib.metadata import distribution

    (text,) = [file for file in distribution("steadytip").files or () if file.name == "LICENSE"]
    return Path(str(text.locate())).parent


def edit(path: Path, diff: str) -> None:
    """Apply a diff without line numbers."""
    lines = [(line[:1] or " ", line[1:]) for line in diff.splitlines()]
    old = "\n".join(text for sign, text in lines if sign in " -")
    new = "\n".join(text for sign, text in lines if sign in " +")
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{path.name} has to hold this once:\n{old}"
    path.write_text(text.replace(old, new), encoding="utf-8")


def run(folder: Path, line: str) -> str:
    """Run a command of a recipe in the copy; returns its output."""
    program, *arguments = line.split()
    code = f"{PROGRAMS[program]}; run()" if PROGRAMS[program] else ""
    command = [sys.executable, *(["-c", code] if code else []), *arguments]
    environment = {**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "120"}
    for name in [name for name in environment if name.startswith("PYTEST_")]:
        del environment[name]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in RECIPES.glob("*.md")))
def test_a_recipe_works_as_it_stands(copy, name) -> None:
    blocks = BLOCK.findall((RECIPES / f"{name}.md").read_text(encoding="utf-8"))
    assert any(kind == "sh" for kind, _, _ in blocks)
    for kind, file, text in blocks:
        if kind == "sh":
            install(copy)
            for line in text.splitlines():
                run(copy, line.partition("  #")[0])
        elif kind == "diff":
            edit(copy / file, text)
        elif file:
            path = copy / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")


def test_there_is_a_recipe_for_everything_that_grows() -> None:
    found = {path.stem for path in RECIPES.glob("*.md")}
    assert found == {
        *("estimator", "plant", "part", "can-transport", "metric", "paper-figure", "fmu-check"),
        "identify-command",
    }
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for name in found:
        assert f"docs/recipes/{name}.md" in contributing
