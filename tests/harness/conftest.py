"""An FMU by somebody else, and scenarios around it."""

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy import sharedLibraryExtension

from fmu_src.pack.compiler import compile_c
from harness.loop import native as march
from harness.parts.description import platform_folders

HERE = Path(__file__).parent

MODES = {
    "gain": 0,
    "fails": 1,
    "gives_nan": 2,
    "hangs": 3,
    "is_slow": 4,
    "is_fatal": 5,
    "discards": 6,
    "fails_to_start": 7,
    "segfaults": 8,
    "exits": 9,
    "crashes_to_start": 10,
}
"""What the probe does in the step that holds the time `at`."""


def compile_probe(*macros: str) -> Path:
    """The probe's library, without a defect or with some that macros define."""
    texts = {"probe.c": (HERE / "probe.c").read_text("utf-8")}
    binary = f"probe{sharedLibraryExtension}"
    flags = ["-std=gnu11", "-O1", "-shared", "-fvisibility=hidden"]
    flags += [] if sys.platform == "win32" else ["-fPIC", "-lm"]
    flags += [f"-D{macro}" for macro in macros]
    return compile_c(texts, [*flags, "probe.c", "-o", binary], binary)


@pytest.fixture(scope="session")
def probe_binary() -> Path:
    return compile_probe()


PackProbe = Callable[..., Path]


@pytest.fixture(scope="session")
def pack_probe(probe_binary: Path, tmp_path_factory: pytest.TempPathFactory) -> PackProbe:
    """Makes a probe FMU whose model description has some texts replaced."""

    def pack(
        *replacements: tuple[str, str],
        folder: str = platform_folders()[0],
        binary: bytes | None = None,
    ) -> Path:
        xml = (HERE / "probe.xml").read_text()
        for old, new in replacements:
            assert old in xml
            xml = xml.replace(old, new)
        path = tmp_path_factory.mktemp("fmu") / "probe.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", xml)
            content = probe_binary.read_bytes() if binary is None else binary
            archive.writestr(f"binaries/{folder}/probe{sharedLibraryExtension}", content)
        return path

    return pack


@pytest.fixture(scope="session")
def probe(pack_probe: PackProbe) -> Path:
    return pack_probe()


WriteScenario = Callable[..., Path]


@pytest.fixture
def write_scenario(tmp_path: Path, probe: Path) -> WriteScenario:
    """Writes a scenario; `PROBE` in its text stands for the probe's FMU."""

    def write(
        text: str, name: str = "case.toml", head: str = "seconds = 1.0\nstep_size = 1e-3\n"
    ) -> Path:
        path = tmp_path / name
        path.write_text(head + text.replace("PROBE", f'"{probe.as_posix()}"'))
        return path

    return write


@pytest.fixture(params=["native", "python"])
def tick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How the loop goes: many ticks in one native call, or each in Python."""
    if request.param == "python":
        monkeypatch.setattr("harness.loop.native.library", lambda: None)
    else:
        assert march.library() is not None
    return request.param


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two seconds of a hand-like motion at 250 Hz, in the M2S2 layout."""
    n = np.arange(500)
    t = n / 250.0
    xyz = 5.0 + np.column_stack([np.sin(2 * np.pi * f * t) * 0.05 for f in (8.0, 9.0, 10.0)])
    rows = [f"{i:.6f},{x:.9f},{y:.9f},{z:.9f},200.0" for i, (x, y, z) in zip(n, xyz, strict=True)]
    path = tmp_path / "hand.csv"
    path.write_text("\n".join([*rows, "500.0,0.0,0.0,0.0,200.0"]) + "\n")
    return path
