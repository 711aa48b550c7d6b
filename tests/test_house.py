"""Structure of the repository: floors, circles, sizes, names. What a reader may rely on."""

import ast
import re
import shutil
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("fmu_src", "plants", "harness", "steadytip")
LONGEST = 100
"""Lines of a function, decorators and docstring included."""
LONG_FUNCTIONS: dict[str, str] = {}
"""`path:function` of those that may be longer, with the reason."""
SHARED_NAMES: dict[str, str] = {}
"""Classes of one name in several modules that mean the same thing, with the reason."""


def modules() -> dict[str, ast.Module]:
    """Syntax tree of every module of the product, by its path."""
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def lint(folder: Path) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"],
        cwd=folder,
        env={"PYTHONPATH": str(folder), "PATH": ""},
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """A copy of the product's sources, to be violated."""
    folder = tmp_path_factory.mktemp("house")
    for package in PACKAGES:
        skip = shutil.ignore_patterns("__pycache__", "*.toml", "*.dbc", "*.md")
        shutil.copytree(ROOT / package, folder / package, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def test_the_floors_hold(copy) -> None:
    done = lint(copy)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("harness/haptics/__init__.py", '"""New, on no floor."""\n', "haptics"),
        ("fmu_src/haptics/__init__.py", '"""New, on no floor."""\n', "haptics"),
        ("harness/common/up.py", "import harness.loop.loop\n", "harness.common"),
        ("fmu_src/kit/up.py", "import fmu_src.tremor.wflc\n", "fmu_src.kit"),
        ("fmu_src/tremor/up.py", "import plants.hand\n", "plants"),
        ("fmu_src/tremor/across.py", "import fmu_src.piezo.demand\n", "fmu_src.piezo"),
        ("plants/copycat.py", "import fmu_src.estimation.micron.model\n", "plants"),
        ("plants/friend.py", "import plants.hand\n", "plants.hand"),
        ("harness/sweep/model.py", "import fmu_src.controller.tremor_canceller\n", "controller"),
        ("harness/can/late.py", "def late():\n    import harness.hil.session\n", "harness.can"),
    ],
)
def test_a_violation_is_seen(copy, file, text, words) -> None:
    path = copy / file
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    try:
        done = lint(copy)
    finally:
        path.unlink()
        if path.name == "__init__.py":
            shutil.rmtree(path.parent)
    assert done.returncode == 1
    broken = done.stdout[done.stdout.index("Broken contracts") :]
    assert words in broken


def test_a_circle_is_seen(copy) -> None:
    paths = [copy / "harness" / "report" / name for name in ("first.py", "second.py")]
    for path, other in zip(paths, ("second", "first"), strict=True):
        path.write_text(f"import harness.report.{other}\n", encoding="utf-8")
    try:
        done = lint(copy)
    finally:
        for path in paths:
            path.unlink()
    assert done.returncode == 1
    assert "No cycles are allowed in harness.report" in done.stdout


def test_the_picture_of_the_floors_is_the_contract() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    pictures = dict(re.findall(r"```floors ?(\w*)\n(.*?)```", text, re.DOTALL))
    tables = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = [c for c in tables["tool"]["importlinter"]["contracts"] if c["type"] == "layers"]
    assert len(contracts) == len(pictures) == 3
    for contract in contracts:
        drawn = pictures[contract.get("containers", [""])[0]].splitlines()
        assert [line.partition("   ")[0].strip() for line in drawn] == contract["layers"]
        assert contract.get("exhaustive", False) == ("containers" in contract)


def test_the_top_floor_of_the_harness_is_tidy() -> None:
    assert len(list((ROOT / "harness").glob("*.py"))) <= 3


def test_functions_are_short() -> None:
    long = {}
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
                if node.end_lineno - first + 1 > LONGEST:
                    long[f"{path}:{node.name}"] = node.end_lineno - first + 1
    assert long.keys() == LONG_FUNCTIONS.keys(), long


def test_a_class_name_means_one_thing() -> None:
    """Classes of models aside, which every model calls Params, In, X and Out."""
    homes = defaultdict(list)
    for path, tree in modules().items():
        if path.startswith(("fmu_src/estimation", "fmu_src/tremor", "fmu_src/piezo", "plants")):
            continue
        if path.startswith(("fmu_src/manipulator", "fmu_src/controller")):
            continue
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(path)
    twice = {name: found for name, found in homes.items() if len(found) > 1}
    assert twice.keys() == SHARED_NAMES.keys(), twice


def test_every_folder_says_what_it_is_for() -> None:
    for path, tree in modules().items():
        if path.endswith("__init__.py"):
            assert ast.get_docstring(tree), f"{path} has no docstring"


def test_links_of_the_pages_lead_somewhere() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    assert len(pages) > 10
    dead = []
    for page in pages:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#\s]+)", text):
            if "://" not in target and not (page.parent / target).exists():
                dead.append(f"{page.name}: {target}")
    assert not dead


def test_docstrings_of_functions_start_with_a_verb_or_a_noun() -> None:
    """Ruff's D401 sees most; what it lets pass are questions."""
    questions = re.compile(r"(What|Whether|Of|Where|How|Which|Why|When|All|Nothing|The same)\b")
    found = [
        f"{path}: {node.name}"
        for path, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and questions.match(ast.get_docstring(node) or "")
    ]
    assert not found
