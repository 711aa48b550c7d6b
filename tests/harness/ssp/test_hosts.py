"""The exported closed loop in other people's tools: libcosim and Ecos.

Both step all FMUs at once and then pass all values (a Jacobi master), so a signal is one sample
late at every connection between parts of one sample period. Against the harness, the hand's motion
is late by 1 ms at the instrument and by 4 ms at the controller (`harness.ssp.order.lag`), which
leaves the correction 3 ms later than the motion. A controller that is told so by its horizon gives
the figures of the harness.

Run as a program, this file is the tool's side: `TOOL FILE SECONDS OUTPUT`.
"""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

PERIOD = 1e-3
COMMUNICATION = 1e-4
"""Sample period of the stacks: a shorter communication step changes nothing [s]."""
SIGNALS = [
    *(f"instrument.{port}_{axis}" for port in ("tip", "free_tip") for axis in "xyz"),
    *(f"hand.intent_{axis}" for axis in "xyz"),
]
HAND_LATE, CORRECTION_LATE = 1, 3
"""Samples by which the instrument is later than the hand, and the correction than both."""


def libcosim(path: str, seconds: float) -> list[list[float]]:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    execution = CosimExecution.from_ssp_file(path, step_size=round(COMMUNICATION * 1e9))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    wanted = []
    for part in dict.fromkeys(name.split(".")[0] for name in SIGNALS):
        index = execution.slave_index_from_instance_name(part)
        references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
        ports = [n.partition(".")[2] for n in SIGNALS if n.startswith(f"{part}.")]
        wanted.append((index, [references[port] for port in ports]))
    rows = []
    for _ in range(round(seconds / PERIOD)):
        assert execution.step(round(PERIOD / COMMUNICATION))
        rows.append([v for index, refs in wanted for v in observer.last_real_values(index, refs)])
    return rows


def ecos(path: str, seconds: float) -> list[list[float]]:
    from ecospy import EcosSimulation

    simulation = EcosSimulation(COMMUNICATION, ssp_path=path)
    simulation.init(parameter_set=Path(path).stem)
    names = [name.replace(".", "::") for name in SIGNALS]
    rows = []
    for _ in range(round(seconds / PERIOD)):
        simulation.step(round(PERIOD / COMMUNICATION))
        rows.append([simulation.get_real(name) for name in names])
    return rows


TOOLS: dict[str, Callable[[str, float], list[list[float]]]] = {
    "libcosim": libcosim,
    "Ecos": ecos,
}

if __name__ == "__main__":
    tool, file, length, output = sys.argv[1:]
    np.save(output, np.array(TOOLS[tool](file, float(length))))
    sys.exit()

import steadytip as st  # noqa: E402 - the tool's side has nothing of the project in its process
from harness.bench.other_hosts import absent_host  # noqa: E402
from harness.parts.description import describe  # noqa: E402
from harness.results.metrics import MetricInputs, metrics_of  # noqa: E402
from harness.ssp.export import export  # noqa: E402
from harness.ssp.load import load  # noqa: E402

pytestmark = pytest.mark.xdist_group("ssp_hosts")  # all tests share few runs of some seconds

FIGURES = {"reduction_in_band": 2.0, "reduction_a_posteriori": 4.0}
"""How far a tool's may be from the harness's [percentage points]: farther ahead, a forecast is a
little worse."""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The loop in the harness."""
    return st.run("closed_loop", out=tmp_path_factory.mktemp("own"), report=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """The loop as it is, and with a controller that knows how late it is."""
    folder = tmp_path_factory.mktemp("ssp")
    plain = export("closed_loop", folder / "plain" / "closed_loop.ssp")
    fmu = load(plain, folder / "loaded").scenario.parent / "fmus" / "TremorCanceller.fmu"
    horizon = describe(fmu).variables["filter.horizon"].start
    assert isinstance(horizon, float)
    later = {"part.controller.filter.horizon": horizon + CORRECTION_LATE * PERIOD}
    told = export("closed_loop", folder / "told" / "closed_loop.ssp", later)
    return {"plain": plain, "told": told}


@pytest.fixture(scope="module")
def run_in(own, files, tmp_path_factory):
    """Runs a file in a tool once: (n, len(SIGNALS)) as the tool has them."""
    done: dict[tuple[str, str], np.ndarray] = {}

    def run(tool: str, file: str) -> np.ndarray:
        if (tool, file) not in done:
            output = tmp_path_factory.mktemp("out") / "signals.npy"
            command = [__file__, tool, str(files[file]), str(len(own.time) * PERIOD), str(output)]
            # In a process of its own: a tool that crashes fails this test alone.
            ended = subprocess.run(
                [sys.executable, *command], capture_output=True, text=True, errors="replace"
            )
            assert ended.returncode == 0, (ended.stdout + ended.stderr)[-3000:]
            done[tool, file] = np.load(output)
        return done[tool, file]

    return run


def available(tool: str) -> str:
    """The tool's name; skips where it is not installed."""
    if reason := absent_host(tool):
        pytest.skip(reason)
    return tool


def figures(signals: np.ndarray, settle: float) -> dict[str, float]:
    """Metrics; the intent is put beside the motion that the instrument made of it."""
    tip, moved, intent = np.split(signals, 3, axis=1)
    motion = MetricInputs(
        step=PERIOD,
        warm_up=settle,
        tip=tip[HAND_LATE:],
        tip_uncompensated=moved[HAND_LATE:],
        intent=intent[:-HAND_LATE],
    )
    return {name: metric.value for name, metric in metrics_of(motion).items()}


@pytest.mark.parametrize("tool", TOOLS)
def test_the_plant_moves_as_in_the_harness(tool, own, run_in):
    """The hand to the bit, and the uncompensated tip to the bit, one sample later."""
    signals = run_in(available(tool), "told")
    np.testing.assert_array_equal(signals[:, 6:], own.signals("hand.intent_*"))
    np.testing.assert_array_equal(
        signals[HAND_LATE:, 3:6], own.signals("instrument.free_tip_*")[:-HAND_LATE]
    )


@pytest.mark.parametrize("tool", TOOLS)
def test_the_figures_are_those_of_the_harness(tool, own, run_in):
    reached = figures(run_in(available(tool), "told"), own.metadata.warm_up)
    for name, within in FIGURES.items():
        value = own.metrics[name].value
        print(f"{tool}: {name} {reached[name]:.2f}, harness {value:.2f}")
        assert reached[name] == pytest.approx(value, abs=within)


@pytest.mark.slow
@pytest.mark.parametrize("tool", TOOLS)
def test_a_controller_that_is_not_told_cancels_tremor_there_too(tool, own, run_in):
    """What 3 ms make out of the loop; more or less than in the harness, as the tremor has it."""
    reached = figures(run_in(available(tool), "plain"), own.metadata.warm_up)
    for name in FIGURES:
        print(
            f"{tool}, not told: {name} {reached[name]:.2f}, harness {own.metrics[name].value:.2f}"
        )
    assert reached["reduction_in_band"] >= 50


def test_two_tools_agree_to_the_bit(run_in):
    np.testing.assert_array_equal(*(run_in(available(tool), "told") for tool in TOOLS))
