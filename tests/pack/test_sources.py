"""The C sources of every FMU: no warnings, clean under sanitizers, and good in single precision."""

import shutil
import subprocess
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmu_src.pack import build
from fmu_src.pack.codegen import c_source
from fmu_src.pack.compiler import COMMAND, compile_library
from fmu_src.pack.discovery import load_model
from steadytip.testing import FmuUnderTest
from tests.conftest import by_model

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
HOSTILE = Path(__file__).with_name("hostile.c")
# What single precision costs: rms error of an output over that of the output itself.
SINGLE = {"MicronEstimator": 2e-2, "TremorCanceller": 2e-3}


def written(name: str, folder: Path) -> Path:
    for file, text in c_source.sources(load_model(name), "{0}").items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module", params=by_model())
def sources(request, tmp_path_factory) -> Path:
    return written(request.param, tmp_path_factory.mktemp(request.param))


def compiler(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


FLAGS = {"double": [], "float": [f"-D{c_source.SINGLE_PRECISION}"]}
PREFIX = "-DFMI2_FUNCTION_PREFIX=Some_"
PREFIXED = ["Hand", "MicronEstimator", "VarForecaster"]
"""With noise, of elements, of whole matrices: functions of the standard are the same in all."""


# GCC finds what may be uninitialised only when it optimises; numbers of half the size change
# nothing about that, and what is wrong with their types is found before any code is made.
OPTIMISED = {
    ("gcc", "double"): ["-O1"],
    ("gcc", "float"): ["-fsyntax-only"],
}


@pytest.mark.parametrize(
    ("chain", "flags"),
    [
        *(("zig", flags) for flags in FLAGS),
        ("gcc", "double"),
        pytest.param("gcc", "float", marks=pytest.mark.slow),
    ],
)
def test_sources_compile_without_a_warning(sources, chain, flags) -> None:
    compile_strictly(sources, chain, [*FLAGS[flags], *OPTIMISED.get((chain, flags), [])])


@pytest.mark.parametrize("chain", ["zig", "gcc"])
@pytest.mark.parametrize("name", PREFIXED)
def test_sources_with_a_prefix_compile_without_a_warning(name, chain, tmp_path) -> None:
    compile_strictly(written(name, tmp_path), chain, [PREFIX])


@pytest.mark.parametrize("chain", ["zig", "gcc"])
@pytest.mark.parametrize(
    "mistake", ["int unused;", "int unset; if (unset) return 1;", "int a[1] = {1, 2}; (void)a;"]
)
def test_a_mistake_in_sources_would_be_found(mistake, chain, tmp_path) -> None:
    (tmp_path / c_source.ENTRY).write_text(f"int main(void) {{ {mistake} return 0; }}\n")
    with pytest.raises(AssertionError, match=r"unused|uninitialized|excess"):
        compile_strictly(tmp_path, chain, OPTIMISED.get((chain, "double"), []))


def compile_strictly(folder: Path, chain: str, flags: list[str]) -> None:
    """Clang's warnings all come before it optimises.

    Without the sanitizers that zig adds, and debug information, it takes a seventh of the time.
    """
    bare = ["-O0", "-g0", "-fno-sanitize=undefined"]
    command = (
        [*COMMAND, *STRICT, *flags, *bare] if chain == "zig" else [compiler("gcc"), *STRICT, *flags]
    )
    done = subprocess.run(
        [*command, "-c", c_source.ENTRY, "-o", "fmu.o"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sanitizers", "arguments"),
    [("address,undefined", ["walk", "300"]), ("thread", ["threads"])],
    ids=["random calls", "threads"],
)
def test_hostile_host_finds_nothing(sources, sanitizers, arguments) -> None:
    """Random calls under AddressSanitizer and UBSan; a hundred instances under ThreadSanitizer.

    Not optimised: nothing is found less for that, and the largest compile in a quarter of the time.
    """
    binary = sources / sanitizers.partition(",")[0]
    command = [compiler("gcc"), "-std=gnu99", "-g", "-O0", f"-fsanitize={sanitizers}"]
    command += ["-fno-sanitize-recover=all", f"-I{sources}", str(HOSTILE), "-o", str(binary)]
    built = subprocess.run([*command, "-lm", "-lpthread"], capture_output=True, text=True)
    if "cannot find" in built.stderr:
        pytest.skip("gcc has no sanitizer libraries here")
    assert built.returncode == 0, built.stderr
    done = subprocess.run(
        [str(binary), *arguments], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "messages" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGLE)
def test_single_precision_costs_what_the_readme_says(name, tmp_path) -> None:
    """The instrument's FMUs for a microcontroller, against double precision in the closed loop."""
    import steadytip as st

    path = build([name])[name]
    run = st.run("closed_loop", overrides={"seconds": 4.0}, out=tmp_path / "run", report=False)
    folder = tmp_path / "single"
    fmpy.extract(str(path), str(folder))
    texts = {p.name: p.read_text("utf-8") for p in (folder / "sources").iterdir() if p.is_file()}
    texts[c_source.ENTRY] = f"#define {c_source.SINGLE_PRECISION}\n" + texts[c_source.ENTRY]
    library = next((folder / "binaries").rglob(f"{name}.*"))
    library.write_bytes(compile_library(name, texts).read_bytes())

    role = {"MicronEstimator": "estimator", "TremorCanceller": "controller"}[name]
    source = {"MicronEstimator": "sensors", "TremorCanceller": "estimator"}[name]
    instance = FmuUnderTest(path, folder)
    inputs = [v for v in instance.variables if v.causality == "input"]
    outputs = [v for v in instance.variables if v.causality == "output" and v.type == "Real"]
    recorded = set(run.table.column_names)
    wired = {v.name for v in inputs if f"{source}.{v.name}" in recorded}
    table = {name: run.signals(f"{source}.{name}") for name in wired}
    found = []
    for k in range(len(run.time)):
        instance.apply({name: values[k] for name, values in table.items()})
        instance.step()
        found.append(instance.fmu.getReal([v.valueReference for v in outputs]))
    instance.close()
    double = np.column_stack([run.signals(f"{role}.{v.name}") for v in outputs])
    error = np.sqrt(np.mean((np.array(found) - double)[2000:] ** 2, axis=0))
    size = np.sqrt(np.mean(double[2000:] ** 2, axis=0))
    wanted = ("tip_displacement", "attitude", "volts", "tremor")
    worst = {v.name: e / s for v, e, s in zip(outputs, error, size, strict=True)}
    print({key: float(f"{value:.2g}") for key, value in worst.items()})
    for key, value in worst.items():
        if key.startswith(wanted) and not key.startswith("attitude_sigma"):
            assert value < SINGLE[name], key


def test_fmpy_compiles_the_sources_of_an_fmu(tmp_path) -> None:
    """Another importer's build of `sources/` gives the same outputs as ours."""
    compiler("gcc")
    compiler("cmake")
    from fmpy.build import build_platform_binary

    name = "MicronEstimator"  # the largest takes half a minute
    path = build([name])[name]
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    for folder in (ours, theirs):
        fmpy.extract(str(path), str(folder))
    shutil.rmtree(theirs / "binaries")
    cmake = tmp_path / "cmake"
    cmake.mkdir()
    build_platform_binary(theirs, cmake)
    results = []
    for folder in (ours, theirs):
        instance = FmuUnderTest(path, folder)
        instance.apply({"volts_a1x": 2.6})
        for _ in range(50):
            instance.step()
        results.append(instance.outputs())
        instance.close()
    np.testing.assert_allclose(results[0], results[1], rtol=1e-12)
