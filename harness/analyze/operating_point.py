"""The loop in operation: what its signals are, and what each of them answers to a moving hand.

    X_ij = a_i exp(i (phi_i + 2 pi i j / 3))     motion along axis i in experiment j = 0, 1, 2
    Z_j  = (Y_j+ - Y_j-) / 2                     lines of a signal, the hand moving by X_j and -X_j
    R    = Z X^-1                                its response to motion along each axis

The scenario is run once as it is, which tells how large its hand's tremor is. The hand then moves
by multisines: a tremor of that size, as broad as real ones are, and slow motion that falls as
1 / f into the band. So adaptive parts have a tremor to learn from, hysteresis loops are as wide as
in use, every line is excited, and R is the best linear approximation for such a hand. Experiments
are orthogonal, all axes move at once. Seeds are the same in all runs, so that noise and everything
else that does not follow the hand cancels in Z, and so does nonlinearity of even order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from fmu_src.errors import SteadytipError
from harness.analyze.multisine import (
    FREQUENCIES,
    SPACING,
    WINDOW,
    ComplexArray,
    lines_of,
    multisine,
    random_phases,
    within,
)
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.recordings.run_record import values_of
from harness.results.metrics import TREMOR_BAND
from harness.running import run
from harness.scenario.schema import Scenario
from harness.system.assembly import System

__all__ = ["AXES", "REALISATIONS", "OperatingPoint", "duration", "find_operating_point"]

AXES = "xyz"
REALISATIONS = 2
"""Of the random phases: two that differ tell a response from what only looks like one."""
LEARNING = 6.0
"""Time after `settle` before anything is measured, for filters that learn [s]."""
LEAST_SHARE = 0.1
"""Least tremor along an axis, of the largest."""
FAINTEST = 1e-8
"""Motion in the band below which there is no tremor, rms [m]."""
WITHOUT_TREMOR = 1e-5
"""Size of the tremor that is put in its place, rms [m]."""
RUNS = 1 + 2 * REALISATIONS * len(AXES)

Progress = Callable[[float, str], None]
"""Told the share that is done, 0 to 1, and in a few words what is next."""


@dataclass(frozen=True)
class OperatingPoint:
    """Signals of the loop, and their responses to motion of the hand.

    Attributes:
        names: of the signals, `part.port`.
        time: (n,) instants [s].
        settled: when the loop is in operation [s].
        signals: (n, names) of the first experiment.
        amplitudes: (f, names) lines of the signals, rms over the experiments.
        motion: (axes, f) amplitudes of the hand's lines [m].
        responses: (realisations, f, names, axes) to motion of the hand, per metre.
        recording: plays the hand's motion of the first experiment.
    """

    names: tuple[str, ...]
    time: FloatArray
    settled: float
    signals: FloatArray
    amplitudes: FloatArray
    motion: FloatArray
    responses: ComplexArray
    recording: Path

    def signal(self, name: str) -> FloatArray:
        """Return one signal of the first experiment, (n,)."""
        return self.signals[:, self.names.index(name)]

    def response(self, names: Sequence[str]) -> ComplexArray:
        """Return responses to the hand, (realisations, f, len(names), axes), per metre."""
        return self.responses[:, :, [self.names.index(name) for name in names]]


def duration(scenario: Scenario) -> float:
    """Return simulated time of a run [s]."""
    return scenario.warm_up + LEARNING + WINDOW


def find_operating_point(
    scenario: str,
    system: System,
    overrides: Mapping[str, Any],
    motion: Path | None,
    folder: Path,
    progress: Progress,
) -> OperatingPoint:
    """Run the loop, as it is and with experiments.

    Args:
        scenario: path or name.
        system: assembled from it.
        overrides: of the scenario.
        motion: recording that the hand plays; None: the scenario's own.
        folder: for recordings and records.
        progress: see `Progress`.

    Raises:
        ProblemsError: the hand's recording is too short.
        RunError: a run ended early.
    """
    step = system.scenario.step_size
    seconds = duration(system.scenario)
    done_runs = 0

    def once(name: str, played: Path | None) -> tuple[tuple[str, ...], FloatArray]:
        nonlocal done_runs
        number, done_runs = done_runs, done_runs + 1
        progress(number / RUNS, name)
        result = run(
            scenario,
            motion=played,
            overrides={**overrides, "seconds": seconds},
            out=folder / "run",
            report=False,
            progress=lambda done, total: progress((number + done / total) / RUNS, name),
        )
        names = tuple(result.table.column_names[1:])
        columns = [values_of(result.table.column(name)).astype(float) for name in names]
        return names, np.column_stack(columns)

    names, signals = once("the loop as it is", motion)
    if len(signals) < round(seconds / step):
        raise ProblemsError(
            system.scenario.name,
            [
                f"the motion lasts {len(signals) * step:g} s, the analysis needs {seconds:g} s: "
                f"'warm_up' = {system.scenario.warm_up:g} s, and {LEARNING + WINDOW:g} s to learn "
                "and to measure. Give a longer recording, or less 'settle'"
            ],
        )
    moved = signals[:, [names.index(name) for name in system.roles["tip_uncompensated"]]]
    amplitudes = _amplitudes(moved[round(system.scenario.warm_up / step) :], step)
    # One sample more: n samples of a recording last n - 1 periods.
    total: FloatArray = np.arange(len(signals) + 1, dtype=float) * step
    time, kept = total[:-1], np.empty((0, 0))
    shape = (REALISATIONS, len(AXES), len(FREQUENCIES))
    phases = np.stack(
        [
            [random_phases(system.scenario.seed, m, i) for i in range(len(AXES))]
            for m in range(REALISATIONS)
        ]
    )
    moves = np.empty((*shape, len(AXES)), dtype=complex)
    answers = np.empty((*shape, 0), dtype=complex)
    for m, j in np.ndindex(shape[:2]):
        turns = 2 * np.pi * np.arange(len(AXES)) * j / len(AXES)
        lines = amplitudes * np.exp(1j * (phases[m] + turns[:, None]))
        position = np.column_stack([multisine(total, 0.0, line) for line in lines])
        lots = []
        for sign in (1, -1):
            name = f"experiment {j + 1} of {len(AXES)}, phases {m + 1}, {'+-'[sign < 0]}"
            played = folder / f"{m}{j}{sign}.parquet"
            _write(played, total, sign * position)
            names, lot = once(f"the loop, {name}", played)
            lots.append(lot)
        if not kept.size:
            # With the recording there are signals of its own.
            kept, answers = lots[0], np.empty((*shape, len(names)), dtype=complex)
        moves[m, j] = lines.T
        answers[m, j] = lines_of(time, (lots[0] - lots[1]) / 2)
    progress(1.0, "the loop")
    # By line: (signals, experiments) times the inverse of (axes, experiments).
    found = np.moveaxis(answers, 1, -1) @ np.linalg.inv(np.moveaxis(moves, 1, -1))
    return OperatingPoint(
        names=names,
        time=time,
        settled=system.scenario.warm_up,
        signals=kept,
        amplitudes=np.sqrt(np.mean(np.abs(answers) ** 2, axis=(0, 1))),
        motion=amplitudes,
        responses=np.asarray(found, dtype=complex),
        recording=folder / "001.parquet",
    )


def _amplitudes(moved: FloatArray, step: float) -> FloatArray:
    """Return amplitudes (axes, f) [m] of lines with as much tremor as a motion (n, axes) [m]."""
    low, high = TREMOR_BAND
    frequency, power = signal.welch(
        moved, 1 / step, nperseg=round(1 / (SPACING * step)), detrend="linear", axis=0
    )
    inside = (frequency >= low) & (frequency <= high)
    tremor = np.sqrt(SPACING * power[inside].sum(axis=0))
    if np.max(tremor) < FAINTEST:
        tremor = np.full(len(AXES), WITHOUT_TREMOR)
    tremor = np.maximum(tremor, LEAST_SHARE * tremor.max())
    shape = np.maximum(low / FREQUENCIES, 1.0) * np.minimum(high / FREQUENCIES, 1.0) ** 2
    return np.asarray(tremor[:, None] * shape / np.sqrt(within(low, high).sum() / 2))


def _write(path: Path, time: FloatArray, position: FloatArray) -> None:
    """Write a recording; see `harness.recordings.motion`."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = {"time [s]": time}
    columns |= {f"{axis} [m]": position[:, i] for i, axis in enumerate(AXES)}
    try:
        parquet.write_table(pa.table(columns), path)
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {error.strerror}") from None
