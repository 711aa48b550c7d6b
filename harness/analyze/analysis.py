"""From a scenario to its delay budget."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.analyze.multisine import ComplexArray
from harness.analyze.operating_point import OperatingPoint, Progress, duration, find_operating_point
from harness.analyze.part_response import PartResponse, measure_part
from harness.common.endpoint import Endpoint
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.parts.protocols import Part
from harness.results.metrics import TREMOR_BAND
from harness.scenario.load import load
from harness.scenario.schema import Scenario
from harness.system.assembly import System, assemble, part_moved_by_recording

if TYPE_CHECKING:
    from harness.analyze.delay_budget import DelayBudget, Margins
    from harness.analyze.linear import CutLoop, OpenedLoop
    from harness.analyze.phase_budget import Stage

__all__ = ["DOUBTFUL", "INCOHERENT", "Analysis", "analyze"]

DOUBTFUL = 0.1
"""Scatter, or difference of parts and whole, beyond which what is left is not to be trusted."""
INCOHERENT = 0.9
"""Coherence below which the phase of the correction is not to be trusted."""
DEPARTED = 1e-3
"""Departure of a part alone from the same in the loop that is told."""
LOOP_SHARE = 0.7
"""Of the time, what the experiments with the whole loop take."""


@dataclass(frozen=True)
class Analysis:
    """A delay budget, with what it rests on.

    Attributes:
        scenario: what was analysed.
        motion: recording that the size of the tremor is from; None: the scenario's own hand.
        tremor: rms of the hand's motion in the tremor's band, all axes together [m].
        measured: (f, tip, axes) motion of the tip by motion of the hand, of the whole loop.
        scatter: (f,) standard error of that, rms of a column.
        coherence: (f,) of the correction with the motion, over the realisations.
        from_parts: (f, tip, axes) the same as `measured` from the parts and wires.
        held_out: (f,) difference between parts and whole, rms of a column; where a part was fitted
            to the loop, this was done on one realisation, and the whole is that of another one.
        misfit: for each part, (f,) how far alone it differs from itself in the loop, by its effect.
        fitted: parts whose response holds for this operation only.
        loop: frequency responses of the loop opened at the command.
        stages: phases on the way from hand to correction.
        budget: what delay it bears.
        margins: of a feedback loop; None for a feed-forward one.
        notes: what should be known; sentences.
    """

    scenario: Scenario
    motion: Path | None
    tremor: float
    measured: ComplexArray
    scatter: FloatArray
    coherence: FloatArray
    from_parts: ComplexArray
    held_out: FloatArray
    misfit: Mapping[str, FloatArray]
    fitted: tuple[str, ...]
    loop: OpenedLoop
    stages: Sequence[Stage]
    budget: DelayBudget
    margins: Margins | None
    notes: tuple[str, ...]

    @property
    def doubtful(self) -> FloatArray:
        """(f,) whether what is left at a line is not to be trusted."""
        return np.maximum(self.scatter, self.held_out / np.sqrt(2)) > DOUBTFUL


def analyze(
    scenario: str | os.PathLike[str],
    *,
    wanted: float = 0.5,
    motion: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress = lambda _share, _what: None,
    status: Callable[[str], None] = lambda _: None,
) -> Analysis:
    """Linearise a loop from its FMUs.

    Args:
        scenario: path of a scenario file, or the name of a shipped one; its `seconds` do not count.
        wanted: tip motion that may be left in the tremor's band, of the hand's, between 0 and 1.
        motion: recording that says how large the tremor is, for the part that takes one.
        overrides: values by dotted key, put in place of the scenario's.
        progress: called with the share that is done, 0 to 1, and a text on what is next.
        status: called with a text on what is being done, as builds are.

    Raises:
        SteadytipError: python-control is missing, `wanted` is out of range, or the scenario is not
            one that can be analysed; says what is missing.
        RunError: a run ended early.
    """
    if find_spec("control") is None:
        raise SteadytipError(
            "the analysis needs python-control, which is not installed: "
            "pip install 'steadytip[analyze]'"
        )
    if not 0.0 < wanted < 1.0:
        raise SteadytipError(
            f"--attenuation {wanted:g}: the share of the tremor that may be left is between 0 and "
            "1, as in --attenuation 0.5"
        )
    settings = dict(overrides or {})
    given = load(scenario, settings)
    recording = Path(motion) if motion is not None else None
    system = assemble(given, recording, status)
    hand = _moved_part(system)
    system = _checked(system, hand)
    name = os.fspath(scenario)
    with tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True) as folder:
        workspace = Path(folder)
        operation = find_operating_point(
            name,
            system,
            settings,
            recording,
            workspace,
            lambda share, what: progress(LOOP_SHARE * share, what),
        )
        own = load(scenario, {**settings, "seconds": duration(given)})
        played = assemble(own, operation.recording)
        played = replace(played, roles=system.roles)
        blocks = _blocks(own, played, operation, workspace, progress)
    progress(1.0, "putting together")
    return _conclude(played, hand, operation, blocks, wanted, recording)


def _moved_part(system: System) -> str:
    if len(system.motions) == 1:
        return next(iter(system.motions))
    try:
        return part_moved_by_recording(system.parts)
    except SteadytipError as error:
        raise SteadytipError(
            f"{system.scenario.name}: the analysis moves the hand as a recording does; {error}"
        ) from None


def _checked(system: System, hand: str) -> System:
    """Check that a system can be analysed, and fill its role `actuator_voltage`."""
    where, roles = system.scenario.name, dict(system.roles)
    problems = [
        f"the delay budget compares the tip with and without compensation: signals.{role} is "
        f'missing; write [signals] {role} = "PART.PORT_*", three outputs [m] in the world'
        for role in ("tip_uncompensated", "tip")
        if role not in roles
    ]
    problems += [
        f"part '{name}' is of kind '{part.metadata()['kind']}': only FMUs can be measured alone; "
        "put an FMU in its place"
        for name, part in system.parts.items()
        if part.metadata()["kind"] not in {"fmu", "replay"}
    ]
    if "actuator_voltage" not in roles:
        # Every loop has a delayed wire; without a word on it, that is where the command leaves.
        late = [link for link in system.wiring.links if link.delay]
        roles["actuator_voltage"] = tuple(dict.fromkeys(str(link.source) for link in late))
        if not late:
            problems.append(
                "which signals are the command is not known: signals.actuator_voltage is missing, "
                "and no wire "
                'has a delay; write [signals] actuator_voltage = "PART.PORT_*"'
            )
    if not problems:
        downstream = _reached(system, hand)
        volts = (Endpoint.find(name, system.parts) for name in roles["actuator_voltage"])
        commanding = {endpoint.part for endpoint in volts if endpoint}
        deaf = sorted(commanding - downstream)
        if deaf:
            problems.append(
                f"nothing senses the hand: no wires lead from '{hand}' to {', '.join(deaf)}, "
                f"where the command ({', '.join(roles['actuator_voltage'])}) is made; add a "
                "[[wire]] from a part that feels the motion"
            )
    if problems:
        raise ProblemsError(where, problems)
    return replace(system, roles=roles)


def _reached(system: System, start: str) -> set[str]:
    """Return the parts that wires lead to from one, itself included."""
    found, waiting = {start}, [start]
    while waiting:
        name = waiting.pop()
        for link in system.wiring.links:
            if link.source.part == name and link.target.part not in found:
                found.add(link.target.part)
                waiting.append(link.target.part)
    return found


def _blocks(
    scenario: Scenario,
    system: System,
    operation: OperatingPoint,
    workspace: Path,
    progress: Progress,
) -> list[PartResponse]:
    # The hand first: its label in the results is where the motion begins.
    names = [name for name in system.wiring.order if system.parts[name].inputs]
    blocks = []
    for number, name in enumerate(names):

        def make(name: str = name) -> Part:
            return assemble(scenario, operation.recording).parts[name]

        def report(share: float, number: int = number, name: str = name) -> None:
            done = (number + share) / len(names)
            progress(LOOP_SHARE + (1.0 - LOOP_SHARE) * done, f"{name} alone")

        report(0.0)
        blocks.append(measure_part(make, system, operation, workspace, report))
    return blocks


def _conclude(
    system: System,
    hand: str,
    operation: OperatingPoint,
    blocks: Sequence[PartResponse],
    wanted: float,
    motion: Path | None,
) -> Analysis:
    from harness.analyze.delay_budget import band, correction_of, delay_budget, left_of, margins
    from harness.analyze.linear import LINEAR, attenuation, connect_parts, fit_to_loop
    from harness.analyze.phase_budget import phase_budget

    links, step = system.wiring.links, system.scenario.step_size

    def assembled(blocks: Sequence[PartResponse]) -> CutLoop:
        return connect_parts(blocks, links, system.roles, hand, step)

    mean = operation.responses.mean(axis=0)
    alone = assembled(blocks)
    misfit = alone.misfit(mean[:, [operation.names.index(name) for name in alone.outputs]])
    inside = {
        part: float(np.sqrt(np.mean(band(values, *TREMOR_BAND) ** 2)))
        for part, values in misfit.items()
    }
    nonlinear = tuple(part for part, size in inside.items() if size > LINEAR and part != hand)

    def as_in_loop(seen: ComplexArray) -> CutLoop:
        return assembled(
            [
                fit_to_loop(b, links, operation, seen, step) if b.part in nonlinear else b
                for b in blocks
            ]
        )

    together = as_in_loop(mean)
    tip, moved = (operation.response(system.roles[role]) for role in ("tip", "tip_uncompensated"))
    realisations = tip @ np.linalg.inv(moved)
    measured = realisations.mean(axis=0)
    corrections = realisations - np.eye(3)
    power = np.mean(np.sum(np.abs(corrections) ** 2, axis=(2, 3)), axis=0)
    common = np.sum(np.abs(corrections.mean(axis=0)) ** 2, axis=(1, 2))
    one, other = as_in_loop(operation.responses[0]), realisations[-1]
    loop = together.loop
    from_parts = attenuation(loop)
    stages = phase_budget(together, np.angle(correction_of(from_parts)))
    return Analysis(
        scenario=system.scenario,
        motion=motion,
        tremor=float(np.sqrt(np.sum(band(operation.motion.T, *TREMOR_BAND) ** 2) / 2)),
        measured=measured,
        scatter=left_of(realisations.std(axis=0)) / np.sqrt(max(len(realisations) - 1, 1)),
        coherence=_coherence(common / np.maximum(power, np.finfo(float).tiny), len(realisations)),
        from_parts=from_parts,
        held_out=left_of(attenuation(one.loop) - other),
        misfit=misfit,
        fitted=nonlinear,
        loop=loop,
        stages=stages,
        budget=delay_budget(loop, wanted),
        margins=margins(loop) if loop.feedback else None,
        notes=tuple(_notes(blocks, nonlinear, inside, loop, stages, hand)),
    )


def _coherence(raw: FloatArray, realisations: int) -> FloatArray:
    """Return coherence less what so few realisations share by chance; 1 where there is one."""
    if realisations == 1:
        return np.ones_like(raw)
    return np.asarray(np.maximum((realisations * raw - 1.0) / (realisations - 1.0), 0.0))


def _notes(
    blocks: Sequence[PartResponse],
    nonlinear: Sequence[str],
    misfit: Mapping[str, float],
    loop: OpenedLoop,
    stages: Sequence[Stage],
    hand: str,
) -> list[str]:
    notes = [
        "feedback: what the command moves comes back into what it is made from"
        if loop.feedback
        else "feed-forward: nothing that the command moves comes back into what it is made from; "
        "the gain of the loop, measured, is 0"
    ]
    if nonlinear:
        sizes = ", ".join(
            f"{part} ({100 * misfit[part]:.0f} % of the motion)" for part in nonlinear
        )
        notes.append(
            f"not linear beside the signals of the loop: {sizes}; their responses are those in the "
            "loop, and hold for motion as large and as broad as here"
        )
    notes += [
        f"'{block.part}' alone departs from what it does in the loop by {block.departure:.2g} of "
        "its signals, though fed the same: its response is not to be trusted"
        for block in blocks
        if block.departure > DEPARTED
    ]
    replayed = [block.part for block in blocks if not block.restored]
    if replayed:
        notes.append(
            f"{', '.join(replayed)} cannot save the state; each probe was run from the start"
        )
    if not stages:
        notes.append(
            f"what each part costs cannot be told: the way from '{hand}' to the tip differs "
            "between the axes, or goes in circles beside the command"
        )
    return notes
