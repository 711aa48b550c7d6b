"""A sample of each FMU: inputs set, a step, outputs got.

From C, each FMU goes through all samples of a recorded run, several times from the start. The time
of a sample is the least of all passes, so that what else the machine did is left out: `worst` is
the sample that is dearest for itself, not the machine's worst moment. `whole passes` is what
pytest-benchmark makes of the same: the mean over a pass, of which the median. Each sample includes
one reading of a clock, some 0.03 us. From Python, it is the function that the loop of the harness
calls where it does not go natively.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.bench.samples import StepCase, cases, names
from harness.bench.session import Bench
from harness.bench.stepper import SteppedFmu
from harness.common.types import FloatArray

_TONES = "TremorCanceller (tremor_filter = 1)"
_FORECASTER = ("TremorCanceller", "TremorCanceller (tremor_filter = 2)")
_WANTED = {
    ("MicronEstimator", "median"): "at most 3 us",
    (_TONES, "median"): "at most 5 us",
    **{(name, "mean"): "at most 60 us" for name in _FORECASTER},
    **{(name, "worst"): "at most 500 us" for name in _FORECASTER},
    ("OpticalInertialUkf", "median"): "at most 30 us",
}
_STATISTICS: dict[str, Any] = {"min": np.min, "median": np.median, "mean": np.mean, "worst": np.max}
_ROWS = 500


Spent = dict[str, list[FloatArray]]


@pytest.fixture(scope="module")
def known(folder: Path, quick: bool) -> dict[str, StepCase]:
    """Return the cases that FMUs are measured with."""
    place = folder / "samples"
    place.mkdir()
    return {case.name: case for case in cases(place, 0.5 if quick else 4.0)}


@pytest.fixture(scope="module")
def spent() -> Spent:
    """Time of every sample [s], a row for each pass."""
    return {}


@pytest.mark.parametrize("name", names())
def bench_from_c(
    bench: Bench, turn: int, name: str, known: dict[str, StepCase], spent: Spent, tmp_path: Path
) -> None:
    """Measure all samples of the run."""
    case = known[name]
    for column in _STATISTICS:  # in this order, to be filled at the end
        wanted = _WANTED.get((name, column), "")
        bench.add(name, column, [], "us", setting=case.setting, wanted=wanted)
    room = np.empty(len(case.table))
    with SteppedFmu(case, tmp_path) as fmu:
        bench.time(
            name,
            "whole passes",
            lambda: fmu.samples(0, len(room), room),
            per=len(room),
            rounds=1,
            setting=case.setting,
        )
    spent.setdefault(name, []).append(room)


@pytest.mark.parametrize("name", names())
def bench_from_python(
    bench: Bench, turn: int, name: str, known: dict[str, StepCase], tmp_path: Path
) -> None:
    """Measure some hundred samples of the run."""
    case = known[name]
    rows, period = case.table[:_ROWS], case.period
    with SteppedFmu(case, tmp_path) as fmu:
        u, advance = fmu.u, fmu.advance

        def samples() -> None:
            for k, row in enumerate(rows):
                u[:] = row
                advance(k * period, period)

        bench.time(name, "from Python", samples, per=len(rows), rounds=1, setting=case.setting)


def bench_samples(bench: Bench, spent: Spent) -> None:
    """Compute the statistics of all passes."""
    for name, passes in spent.items():
        least = 1e6 * np.min(passes, axis=0)
        for column, statistic in _STATISTICS.items():
            bench.add(name, column, float(statistic(least)), "us")
