"""What an FMU is made of, read off the sources: never less than what its model imports."""

import json
import subprocess
import sys

import pytest

from fmu_src.pack import build, discovery
from fmu_src.pack import fingerprint as sources
from fmu_src.pack.discovery import TEXTS, model_names

FLC = "fmu_src/tremor/flc.py"
LOADED = """
import importlib, json, sys
from fmu_src.pack import discovery, model_names
found = {}
for name in sys.argv[1:]:
    for module in [m for m in sys.modules if m.partition(".")[0] in ("fmu_src", "plants")]:
        del sys.modules[module]
    assert importlib.import_module(discovery.module_of(name)).MODEL.name == name
    found[name] = [m for m in sys.modules if m.partition(".")[0] in ("fmu_src", "plants")]
print(json.dumps(found))
"""


@pytest.fixture
def changed(monkeypatch):
    """Gives a source file another text, as if it had been so when the process began."""

    def change(file: str, text: str) -> None:
        monkeypatch.setitem(TEXTS, file, text)
        forget()

    def forget() -> None:
        for function in (discovery._defined, sources._content, sources._imports):
            function.cache_clear()

    yield change
    monkeypatch.undo()
    forget()


def test_every_module_that_a_model_loads_is_known():
    """Each model's module is loaded by itself, and with it whatever it needs."""
    command = [sys.executable, "-c", LOADED, *model_names()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = json.loads(done.stdout)
    assert set(loaded) == set(model_names())
    for name, modules in loaded.items():
        files = set(sources.made_of([name]))
        for module in modules:
            stem = module.replace(".", "/")
            assert files & {f"{stem}.py", f"{stem}/__init__.py"}, (name, module)


def test_kit_and_packing_are_in_every_fmu_but_no_other_model():
    for name in ("Hand", "Flc"):
        files = sources.made_of([name])
        assert {
            "fmu_src/pack/codegen/shell.c",
            "fmu_src/pack/docs/page.html.j2",
            "fmu_src/pack/docs/page.py",
            "fmu_src/kit/model.py",
        } <= {*files}
        assert ("plants/hand.py" in files) == (name == "Hand")
    both = set(sources.made_of(["Hand", "Flc"]))
    assert both == set(sources.made_of(["Hand"])) | set(sources.made_of(["Flc"]))


def test_a_change_concerns_those_that_are_made_of_it(changed):
    def digests() -> dict[str, str]:
        return {name: sources.digest(sources.made_of([name])) for name in model_names()}

    before = digests()
    changed(FLC, TEXTS[FLC] + "\n# changed\n")
    after = digests()
    concerned = {name for name in before if before[name] != after[name]}
    assert concerned == {name for name in before if FLC in sources.made_of([name])}
    assert {"Flc", "TremorCanceller"} <= concerned
    assert not concerned & {"Hand", "MicronEstimator", "PiezoStack"}


@pytest.mark.parametrize(
    ("text", "file"),
    [
        ("from . import flc", FLC),
        ("from .flc import step", FLC),
        (
            "from ..piezo import (\n    demand,\n    creeping,  # two\n)",
            "fmu_src/piezo/creeping.py",
        ),
        ("import os, plants.hand as hand", "plants/hand.py"),
        ("def later():\n    from fmu_src.tremor.flc import step", FLC),
        ("from fmu_src.tremor import elliptic, flc", FLC),
    ],
)
def test_every_way_to_import_is_seen(text, file, changed):
    changed("fmu_src/tremor/bmflc.py", f'{text}\nMODEL = Model("Bmflc")\n')
    files = sources.made_of(["Bmflc"])
    assert file in files
    assert f"{file.rpartition('/')[0]}/__init__.py" in files


def test_going_back_to_earlier_sources_costs_nothing(changed, tmp_path, monkeypatch):
    """And a change of one model costs nothing for another."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fmu_src.pack.compiler._compile", lambda *_: b"a library")
    built: list[str] = []

    def both() -> bytes:
        found = build(["Flc", "DisplacementSensor"], out=tmp_path, progress=built.append)
        return found["Flc"].read_bytes()

    original = TEXTS[FLC]
    first = both()
    assert built == ["Flc", "DisplacementSensor"]
    changed(FLC, original + "\n# changed\n")
    assert both() == first  # a remark makes no difference
    assert built == ["Flc", "DisplacementSensor", "Flc"]
    (tmp_path / "Flc.fmu").write_bytes(b"of the changed sources")
    changed(FLC, original)
    assert both() == first
    assert len(built) == 3
