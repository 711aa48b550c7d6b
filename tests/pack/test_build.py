"""FMUs from models: built when needed, the same bytes each time, a GUID of the content."""

import subprocess
import sys
import zipfile

import pytest

from fmu_src.errors import SteadytipError
from fmu_src.pack import build
from fmu_src.pack.codegen.c_source import sources
from fmu_src.pack.discovery import load_model, model_names
from fmu_src.pack.fmu.description import content_guid

NAME = "MicronEstimator"


def test_every_module_with_a_model_is_found() -> None:
    names = model_names()
    expected = {"Hand", "Instrument", "InertialSensors", "PiezoStack", NAME, "TremorCanceller"}
    assert expected <= set(names)
    assert load_model(NAME).name == NAME


def test_unknown_names_and_flavours_are_refused_with_the_known_ones() -> None:
    with pytest.raises(SteadytipError, match="the nearest is 'MicronEstimator'"):
        load_model("MicronEstimater")
    with pytest.raises(SteadytipError, match="must be one of native, python"):
        build([NAME], "fortran")


@pytest.mark.usefixtures("nothing_kept")
@pytest.mark.parametrize("flavour", ["native", "python"])
def test_an_fmu_is_built_once_and_repeats_to_the_byte(tmp_path, flavour) -> None:
    built: list[str] = []
    first = build([NAME], flavour, tmp_path / "one", built.append)[NAME]
    build([NAME], flavour, tmp_path / "one", built.append)
    assert built == [NAME]
    second = build([NAME], flavour, tmp_path / "two", built.append)[NAME]
    assert built == [NAME, NAME]
    assert first.read_bytes() == second.read_bytes()


def test_native_archive_holds_what_an_importer_expects(tmp_path) -> None:
    names = zipfile.ZipFile(build([NAME], out=tmp_path)[NAME]).namelist()
    assert names[0] == "modelDescription.xml"
    assert {"sources/fmu.c", "sources/shell.c", "documentation/index.html"} <= set(names)
    assert any(name.startswith("binaries/") for name in names)
    assert not any(name.startswith(("/", ".")) or ".." in name for name in names)


@pytest.mark.usefixtures("nothing_kept")
def test_python_fmu_in_the_process_does_not_spoil_the_next_build(tmp_path, monkeypatch) -> None:
    """A loaded FMU leaves its own `pythonfmu`, without binaries, on the path."""
    first = build(["Wflc"], "python", tmp_path / "first")["Wflc"]
    with zipfile.ZipFile(first) as archive:
        archive.extractall(tmp_path / "loaded")
    monkeypatch.syspath_prepend(str(tmp_path / "loaded" / "resources"))
    for name in [name for name in sys.modules if name.partition(".")[0] == "pythonfmu"]:
        monkeypatch.delitem(sys.modules, name)
    second = build(["Wflc"], "python", tmp_path / "second")["Wflc"]
    with zipfile.ZipFile(second) as archive:
        assert any(name.startswith("binaries/") for name in archive.namelist())
    assert second.read_bytes() == first.read_bytes()


def test_guid_follows_the_content() -> None:
    model = load_model(NAME)
    texts = sources(model, "")
    assert content_guid(model, texts) == content_guid(model, dict(texts))
    changed = {**texts, "shell.c": texts["shell.c"] + " "}
    assert content_guid(model, changed) != content_guid(model, texts)


def test_generated_sources_name_their_cost_and_no_machine() -> None:
    texts = sources(load_model(NAME), "{guid}")
    assert "MicronEstimator_step: " in texts["functions.c"]
    assert '"{guid}"' in texts["model.h"]
    assert not any("/tmp" in text or "/home" in text for text in texts.values())


def test_two_processes_build_an_fmu_once(tmp_path):
    """The second waits for the first, and takes what that has built."""
    code = (
        "import sys; from pathlib import Path; from fmu_src.pack import build, cache\n"
        "cache.find = lambda *_: None\n"
        "build(['Flc'], out=Path(sys.argv[1]), progress=print)"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[0] for process in running]
    assert all(process.returncode == 0 for process in running)
    assert sorted(said) == ["", "Flc\n"]
