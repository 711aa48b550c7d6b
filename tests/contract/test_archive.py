"""The FMU as a zip file and what is in it; the names say which line of the checklist is meant."""

import re
import zipfile
from pathlib import Path, PurePosixPath

import fmpy
import numpy as np
import pytest
from fmpy.util import read_csv, read_ref_opt_file
from lxml import etree

from fmu_src.pack.fmu import reference
from tests.contract.conftest import FLAVOURS

_BINARIES = {
    "win64": ".dll",
    "linux64": ".so",
    "darwin64": ".dylib",
    "aarch64-darwin": ".dylib",
    "aarch64-linux": ".so",
}
_BUILD_SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"
# Of the C library: limits and types, mathematics, malloc, memcpy; no files, threads or signals.
_HEADERS = {"float.h", "limits.h", "stddef.h", "stdint.h", "math.h", "tgmath.h"}
_HEADERS |= {"stdlib.h", "string.h"}


@pytest.fixture(params=FLAVOURS)
def flavour(request) -> str:
    return request.param


@pytest.fixture
def archive(paths, flavour):
    with zipfile.ZipFile(paths[flavour]) as opened:
        yield opened


def _text(archive: zipfile.ZipFile, name: str) -> str:
    return archive.read(name).decode("utf-8")


def test_a1_zip_needs_nothing_beyond_version_two(archive) -> None:
    assert archive.testzip() is None
    for entry in archive.infolist():
        assert entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED), entry.filename
        assert entry.extract_version <= 20, entry.filename
        # Bit 0 encryption, bit 3 data descriptor, bit 11 names beyond ASCII.
        assert entry.flag_bits == 0, entry.filename
        assert entry.volume == 0
        assert not entry.extra


def test_a1_nothing_stands_before_the_first_entry(paths, flavour, archive) -> None:
    assert paths[flavour].read_bytes()[:4] == b"PK\x03\x04"
    assert paths[flavour].suffix == ".fmu"
    assert archive.namelist()[0] == "modelDescription.xml"


def test_a2_names_are_plain_relative_ascii_and_unique(archive) -> None:
    names = archive.namelist()
    assert len({name.lower() for name in names}) == len(names)
    for name in names:
        assert name.isascii()
        assert name.isprintable()
        assert "\\" not in name
        assert not PurePosixPath(name).is_absolute()
        assert str(PurePosixPath(name)) == name
        assert not {".", ".."} & set(PurePosixPath(name).parts)
        assert not re.match(r"[A-Za-z]:", name)


def test_a3_description_icon_and_documents_are_where_the_standard_says(archive, flavour) -> None:
    assert archive.read("modelDescription.xml").startswith(
        (b"<?xml version='1.0' encoding='UTF-8'", b'<?xml version="1.0" encoding="UTF-8"')
    )
    assert archive.read("model.png")[:8] == b"\x89PNG\r\n\x1a\n"
    names = set(archive.namelist())
    assert {"documentation/index.html", "documentation/licenses/license.txt"} <= names
    needs = "documentation/externalDependencies.txt"
    assert (needs in names) == (flavour == "python")
    if needs in names:
        assert {"Python", "numpy", "casadi"} <= set(re.findall(r"\w+", _text(archive, needs)))


def test_a3_licences_are_whole_texts(archive, flavour) -> None:
    entry = _text(archive, "documentation/licenses/license.txt")
    assert "Apache License" in entry
    assert "END OF TERMS AND CONDITIONS" in entry
    others = {n for n in archive.namelist() if n.startswith("documentation/licenses/")}
    others.remove("documentation/licenses/license.txt")
    # One for everybody's work inside, each named by the entry.
    packed = any("pythonfmu" in name for name in archive.namelist())
    assert len(others) == packed
    for name in others:
        assert PurePosixPath(name).name in entry
        assert "Permission is hereby granted" in _text(archive, name)


def test_a4_binaries_are_called_like_the_model(model, archive) -> None:
    binaries = [PurePosixPath(n) for n in archive.namelist() if n.startswith("binaries/")]
    assert binaries
    for path in binaries:
        assert path.parts[1] in _BINARIES
        assert path.name == model.name + _BINARIES[path.parts[1]]


def test_a5_sources_are_listed_and_listed_alike(model, paths) -> None:
    with zipfile.ZipFile(paths["native"]) as archive:
        names = set(archive.namelist())
        build = etree.fromstring(archive.read("sources/buildDescription.xml"))
        described = etree.fromstring(archive.read("modelDescription.xml"))
    etree.XMLSchema(etree.parse(_BUILD_SCHEMA)).assertValid(build)
    assert build.get("fmiVersion") == "3.0"
    (configuration,) = build
    assert configuration.get("modelIdentifier") == model.name
    listed = [file.get("name") for file in configuration.iter("SourceFile")]
    assert listed == [file.get("name") for file in described.findall("CoSimulation/SourceFiles/*")]
    assert {f"sources/{name}" for name in listed} <= names


def test_a5_sources_include_only_each_other_and_the_c_library(paths) -> None:
    with zipfile.ZipFile(paths["native"]) as archive:
        sources = {
            PurePosixPath(name).name: _text(archive, name)
            for name in archive.namelist()
            if name.startswith("sources/") and name.endswith((".c", ".h"))
        }
    own, system = set(), set()
    for text in sources.values():
        own |= set(re.findall(r'#\s*include\s+"([^"]+)"', text))
        system |= set(re.findall(r"#\s*include\s+<([^>]+)>", text))
    assert own <= set(sources)
    assert own | {"fmu.c"} == set(sources), "a file that nothing includes"
    assert system <= _HEADERS
    assert not any(name.startswith("fmi2") for name in sources)


def test_a5_python_flavour_has_no_sources(paths) -> None:
    with zipfile.ZipFile(paths["python"]) as archive:
        assert not any(name.startswith("sources/") for name in archive.namelist())


def test_a6_identifiers_and_paths_are_short(model, archive) -> None:
    assert re.fullmatch(r"[A-Za-z_]\w{0,31}", model.name, re.ASCII)
    # Unpacked below a folder of 100 characters that is still less than 180.
    assert max(map(len, archive.namelist())) < 80


def test_a7_extra_holds_the_layered_standard_only(archive) -> None:
    extra = {n.rpartition("/")[0] for n in archive.namelist() if n.startswith("extra/")}
    assert extra == {reference.FOLDER}


def test_a7_manifest_names_every_file_beside_it_and_nothing_else(archive) -> None:
    namespace = "{http://fmi-standard.org/fmi-ls-manifest}"
    manifest = f"{reference.FOLDER}/fmi-ls-manifest.xml"
    root = etree.fromstring(archive.read(manifest))
    assert root.tag == "fmiReferences"
    assert root.get(f"{namespace}fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"
    assert re.fullmatch(r"\d+\.\d+\.\d+(-[\w.]+)?", root.get(f"{namespace}fmi-ls-version"))
    assert root.get(f"{namespace}fmi-ls-description")
    related = {f"{reference.FOLDER}/{node.get('source')}" for node in root}
    beside = {n for n in archive.namelist() if n.startswith(reference.FOLDER)} - {manifest}
    assert related == beside
    assert {node.get("role") for node in root} >= {"result", "experiment/smoke-test"}


def test_a7_times_and_permissions_are_fixed(archive) -> None:
    for entry in archive.infolist():
        assert entry.date_time == (1980, 1, 1, 0, 0, 0)
        assert entry.external_attr == 0o644 << 16
    names = archive.namelist()
    assert names[1:] == sorted(names[1:])


@pytest.fixture
def compared(folders, flavour, model):
    """Folder of the unpacked reference, its settings, inputs (or None) and outputs."""
    stem = str(folders[flavour] / reference.FOLDER / model.name)
    has_inputs = Path(stem + "_in.csv").is_file()
    inputs = read_csv(stem + "_in.csv") if has_inputs else None
    return read_ref_opt_file(stem + "_ref.opt"), inputs, read_csv(stem + "_ref.csv")


def test_a7_fmu_gives_its_own_reference_results(paths, flavour, compared) -> None:
    """As any importer would: settings, inputs and results from the files inside the FMU."""
    settings, inputs, expected = compared
    names = list(expected.dtype.names[1:])
    found = fmpy.simulate_fmu(
        str(paths[flavour]),
        start_time=settings["StartTime"],
        stop_time=settings["StopTime"],
        output_interval=settings["StepSize"],
        input=inputs,
        output=names,
    )
    every = round((expected["time"][1] - expected["time"][0]) / settings["StepSize"])
    found = found[::every]
    np.testing.assert_allclose(found["time"], expected["time"], rtol=1e-12)
    for name in names:
        gap = np.abs(found[name] - expected[name]).max()
        assert gap <= settings["RelTol"] * np.abs(expected[name]).max(), name


def test_a7_reference_moves_and_is_small(model, compared, paths, flavour) -> None:
    settings, inputs, expected = compared
    assert 1 <= len(expected.dtype.names) - 1 <= reference.OUTPUTS
    assert any(np.ptp(expected[name]) > 0 for name in expected.dtype.names[1:])
    assert settings["StopTime"] == expected["time"][-1]
    description = fmpy.read_model_description(paths[flavour])
    experiment = description.defaultExperiment
    assert float(experiment.stopTime) == settings["StopTime"]
    assert float(experiment.stepSize) == settings["StepSize"]
    if inputs is not None:
        assert list(inputs.dtype.names) == ["time", *(s.name for s in model.variables["input"])]
        for scalar in model.variables["input"]:
            column = inputs[scalar.name]
            assert scalar.field.min <= column.min() <= column.max() <= scalar.field.max
            assert np.ptp(column) > 0, scalar.name
    with zipfile.ZipFile(paths[flavour]) as archive:
        packed = [e for e in archive.infolist() if e.filename.startswith(reference.FOLDER)]
    assert sum(entry.compress_size for entry in packed) < 60_000
