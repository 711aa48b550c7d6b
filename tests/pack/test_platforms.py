"""Binaries for other platforms: built here, run under wine and qemu, equal to those of this one."""

import os
import re
import shutil
import struct
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmu_src.pack import build
from fmu_src.pack.compiler import COMMAND, FOLDER, TARGETS, host
from harness.validation import validate as _validate  # noqa: F401 - registers the checks
from harness.validation.checks import FILES
from harness.validation.files import Fmu
from steadytip.testing import FmuUnderTest

HOST = Path(__file__).with_name("host.c")
STEPS = 40
MODELS = ["MicronEstimator", "TremorCanceller", "InertialSensors", "Hand"]
MEBIBYTE = 2**20
LARGEST = {"TremorCanceller": 3, "OpticalInertialEkf": 3}
"""Mebibytes of FMUs for five platforms that are larger than one."""
EVERYWHERE = sorted({*MODELS, *LARGEST, "Flc", "VarForecaster"})
"""The largest, the smallest, and each kind of code: of elements, of whole matrices, with noise.

All models take the same way through the same compiler, and five compilations of each take ten
minutes.
"""
RUNNERS = {
    "win64": (["wine64", "wine"], [], "x86_64-windows-gnu", "host.exe"),
    "aarch64-linux": (
        ["qemu-aarch64", "qemu-aarch64-static"],
        ["-L", "/usr/aarch64-linux-gnu"],
        "aarch64-linux-gnu.2.17",
        "host",
    ),
}
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("platforms")]


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory) -> dict[str, Path]:
    """FMUs for all platforms."""
    return build(EVERYWHERE, out=tmp_path_factory.mktemp("everywhere"), targets=["all"])


def test_five_platforms_fit_into_one_mebibyte(everywhere) -> None:
    """But for the largest: the controller, which holds two filters and two operators for each
    stack, and filters of up to 53 errors.
    """
    assert set(everywhere) == set(EVERYWHERE)
    for name, path in everywhere.items():
        inside = {p.split("/")[1] for p in zipfile.ZipFile(path).namelist() if p[:9] == "binaries/"}
        assert inside == set(TARGETS)
        assert path.stat().st_size < LARGEST.get(name, 1) * MEBIBYTE, name


def test_both_apple_folders_hold_one_universal_library(everywhere) -> None:
    """The head of the file names both CPUs, each slice is a library of its own for that CPU."""
    archive = zipfile.ZipFile(everywhere[MODELS[0]])
    libraries = [
        archive.read(f"binaries/{folder}/{MODELS[0]}.dylib")
        for folder in ("darwin64", "aarch64-darwin")
    ]
    assert libraries[0] == libraries[1]
    magic, count = struct.unpack_from(">II", libraries[0])
    assert (magic, count) == (0xCAFEBABE, 2)
    for i, cpu in enumerate((0x01000007, 0x0100000C)):
        kind, _, offset, size, _ = struct.unpack_from(">IIIII", libraries[0], 8 + 20 * i)
        assert kind == cpu
        assert struct.unpack_from("<II", libraries[0], offset) == (0xFEEDFACF, cpu)
        assert offset + size <= len(libraries[0])


@pytest.mark.parametrize("name", MODELS)
def test_every_platforms_binary_passes_the_checks_on_files(name, everywhere) -> None:
    """All of archive, description and binary: exports, dependencies, glibc, machine, stack."""
    pytest.importorskip("lief")
    fmu = Fmu(everywhere[name])
    outcomes = {key: check.run(fmu) for key, check in FILES.items()}
    binary = [outcome for key, outcome in outcomes.items() if key.startswith("B")]
    assert len(binary) >= 5
    for outcome in binary:
        assert not outcome.problems, outcome
    for outcome in outcomes.values():
        assert not outcome.problems or outcome.level != "error", outcome
    # glibc: as old as the targets promise.
    needed = re.findall(r"glibc 2\.(\d+)", " ".join(outcomes["B2.glibc"].notes))
    assert len(needed) == 2
    assert max(map(int, needed)) <= 17


@pytest.mark.usefixtures("nothing_kept")
def test_binaries_repeat_to_the_byte(everywhere, tmp_path) -> None:
    name = "Flc"
    again = build([name], out=tmp_path, targets=["all"])[name]
    assert again.read_bytes() == everywhere[name].read_bytes()


def write_case(path: Path, folder: Path, case: Path) -> np.ndarray:
    """Run an FMU here; write state and inputs before every step; return the values after it."""
    instance = FmuUnderTest(path, folder)
    inputs = [v for v in instance.variables if v.causality == "input" and v.type == "Real"]
    reals = [v for v in instance.variables if v.type == "Real"]
    references = [np.array([v.valueReference for v in vs], np.uint32) for vs in (inputs, reals)]
    rows, results = [], []
    for k in range(STEPS):
        state = instance.fmu.getFMUState()
        blob = bytes(instance.fmu.serializeFMUstate(state))
        instance.fmu.freeFMUState(state)
        u = np.array(
            [
                np.clip(
                    float(v.start) + 1e-5 * np.sin(0.3 * k + i),
                    float(v.min or -np.inf),
                    float(v.max or np.inf),
                )
                for i, v in enumerate(inputs)
            ]
        )
        rows.append(blob + struct.pack("<d", instance.time) + u.astype("<f8").tobytes())
        instance.fmu.setReal(references[0].tolist(), u.tolist())
        instance.step()
        results.append(instance.fmu.getReal(references[1].tolist()))
    instance.close()
    head = struct.pack("<4i", len(inputs), len(reals), STEPS, len(blob))
    head += instance.description.guid.encode().ljust(64, b"\0")
    head += struct.pack("<d", instance.period)
    case.write_bytes(head + references[0].tobytes() + references[1].tobytes() + b"".join(rows))
    return np.array(results)


@pytest.fixture(scope="module")
def wine(tmp_path_factory) -> Path:
    """Wine's own folder; it takes some seconds to set up."""
    return tmp_path_factory.mktemp("wine")


@pytest.mark.parametrize("folder", RUNNERS)
@pytest.mark.parametrize("name", MODELS)
def test_other_platforms_step_as_this_one(name, folder, everywhere, wine, tmp_path) -> None:
    """From equal state, one step at a time: within 1e-12 of a variable's size."""
    if host() != "linux64":
        pytest.skip("the reference is linux64")
    programs, options, triple, runner = RUNNERS[folder]
    program = next((found for p in programs if (found := shutil.which(p))), None)
    if program is None:
        pytest.skip(f"{programs[0]} is not installed")
    if options and not Path(options[-1]).is_dir():
        pytest.skip(f"{options[-1]} is missing: no C library for the emulated platform")
    fmpy.extract(str(everywhere[name]), str(tmp_path))
    expected = write_case(everywhere[name], tmp_path, tmp_path / "case")
    libraries = [] if folder == "win64" else ["-ldl"]
    # Flags as for the FMU: with others, zig makes Windows' C library anew, which takes a minute.
    command = [*COMMAND, "-target", triple, "-O2", "-s", str(HOST)]
    cache = {f"ZIG_{scope}_CACHE_DIR": str(FOLDER.resolve()) for scope in ("GLOBAL", "LOCAL")}
    subprocess.run(
        [*command, "-o", runner, *libraries], cwd=tmp_path, env={**os.environ, **cache}, check=True
    )
    (library,) = (tmp_path / "binaries" / folder).glob(f"{name}.*")
    quiet = {"WINEDEBUG": "-all", "WINEPREFIX": str(wine)}
    done = subprocess.run(
        [program, *options, f"./{runner}", str(library.relative_to(tmp_path)), "case", "result"],
        cwd=tmp_path,
        env={**os.environ, **quiet},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = np.fromfile(tmp_path / "result").reshape(expected.shape)
    scale = np.abs(expected).max(axis=0)
    gap = np.abs(found - expected)
    assert (gap <= 1e-12 * scale).all(), gap.max(axis=0).max()
