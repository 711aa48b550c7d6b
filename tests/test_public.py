"""`steadytip`, the public package: complete in `dir()` and `help()`, typed, and nothing else."""

import importlib
import pydoc
import subprocess
import sys
import types
from pathlib import Path

import pytest

import harness
import steadytip as st

ROOT = Path(__file__).parents[1]
SCRIPT = '''"""What a user writes."""

import steadytip as st
from steadytip.kit import Inputs, Model, Outputs, Parameters, State, real


def reduction(motion: str) -> float:
    result: st.Result = st.run("closed_loop", motion=motion, overrides={"seconds": 5.0})
    metric: st.Metric = result.metrics["reduction_in_band"]
    return metric.value


def worst(paths: list[str]) -> st.Validation:
    return min((st.validate(path) for path in paths), key=lambda each: -each.counts["error"])


names: list[str] = [*st.models(), *st.scenarios()]
step: float = st.load("closed_loop").step_size
try:
    st.read("build/runs/closed_loop").signals("instrument.tip_*")
except st.RunError as error:
    print(error)
except st.SteadytipError as error:
    print(error)
reveal_type(st.sweep("closed_loop_sweep", runs=3))
'''


def test_everything_public_is_listed_and_nothing_else() -> None:
    assert st.__all__ == sorted(st.__all__, key=lambda name: (not name.isupper(), name))
    extra = {
        name
        for name in set(dir(st)) - set(st.__all__)
        if not name.startswith("_") and not isinstance(getattr(st, name), types.ModuleType)
    }
    assert extra == set()
    assert set(st.__all__) >= {"run", "sweep", "build", "validate", "Result", "kit"}


@pytest.mark.parametrize("name", [name for name in st.__all__ if name != "__version__"])
def test_everything_public_says_what_it_is(name) -> None:
    found = getattr(st, name)
    assert found.__doc__
    assert name in pydoc.render_doc(st) or isinstance(found, types.ModuleType)


def test_the_kit_is_the_models_kit() -> None:
    inner = importlib.import_module("fmu_src.kit")
    assert st.kit.__all__ == inner.__all__
    assert all(getattr(st.kit, name) is getattr(inner, name) for name in inner.__all__)


def test_names_of_before_say_the_new_ones() -> None:
    with pytest.raises(AttributeError, match=r"'harness\.read' is 'steadytip\.read' now"):
        _ = harness.read
    with pytest.raises(AttributeError, match=r"'harness\.available' is 'steadytip\.scenarios' now"):
        _ = harness.available
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = harness.nothing
    assert harness.sweep is importlib.import_module("harness.sweep")
    with pytest.raises(TypeError, match=r"'harness\.sweep' is 'steadytip\.sweep' now"):
        harness.sweep("closed_loop_sweep")


@pytest.mark.slow
def test_a_type_checker_knows_every_public_name(tmp_path) -> None:
    """A user's script, checked strictly against the package with its `py.typed`."""
    assert (ROOT / "steadytip" / "py.typed").is_file()
    path = tmp_path / "script.py"
    path.write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent", str(path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    wrong = [line for line in done.stdout.splitlines() if "script.py" in line and "error" in line]
    assert not wrong, done.stdout
    assert 'Revealed type is "harness.sweep.outcome.SweepResult"' in done.stdout
