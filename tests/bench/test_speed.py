"""Figures of speed, printed, never judged: machines are shared. `make bench`."""

import subprocess
import sys
import time

import pytest

import harness

pytestmark = pytest.mark.bench


def best(action, repeats: int = 3) -> float:
    spent = []
    for _ in range(repeats):
        begun = time.perf_counter()
        action()
        spent.append(time.perf_counter() - begun)
    return min(spent)


def test_closed_loop_against_real_time(tmp_path) -> None:
    """Eight native FMUs, recording on; wanted: five times real time or better."""
    factors = [
        harness.run("closed_loop", out=tmp_path, report=False).metrics["real_time_factor"].value
        for _ in range(3)
    ]
    print(f"\nclosed loop, 8 native FMUs, recorded: {max(factors):.1f} x real time")


def test_help(tmp_path) -> None:
    command = [sys.executable, "-c", "from harness.cli import main; main()", "--help"]
    seconds = best(lambda: subprocess.run(command, check=True, capture_output=True))
    print(f"\nsteadytip --help: {seconds:.2f} s")


def test_first_step_of_a_run(tmp_path) -> None:
    code = (
        "import harness; harness.run('closed_loop', overrides={'seconds': 1.0, 'settle': 0.0},"
        f" out={str(tmp_path)!r}, report=False)"
    )
    command = [sys.executable, "-c", code]
    seconds = best(lambda: subprocess.run(command, check=True, capture_output=True))
    print(f"\n1 s of closed loop from a new process, FMUs built: {seconds:.2f} s")


def test_cost_of_a_sample(tmp_path) -> None:
    """Of each model's native FMU, a thousand samples in one call: what the C code costs."""
    import fmpy

    from fmu_src.pack import build

    print()
    for name, path in build().items():
        description = fmpy.read_model_description(path, validate=False)
        folder = fmpy.extract(str(path), tmp_path / name)
        fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation")
        fmu.setupExperiment()
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        stretch = 1000 * float(description.defaultExperiment.stepSize)
        spent = []
        for k in range(10):
            begun = time.perf_counter()
            fmu.doStep(k * stretch, stretch)
            spent.append(time.perf_counter() - begun)
        print(f"{name}: {1e3 * min(spent):.2f} us a sample")
        fmu.terminate()
        fmu.freeInstance()
