"""Phase cost of each part and wire on the way from the hand to the correction of the tip.

Signals on the way are vectors in several units: forces at three sites, voltages, strokes. At each
place where the way can be cut, signal p contributes c_p = g_p a_p to the correction, g_p what a
change of it does to the tip, a_p its response to the hand. Where the a_p rise and fall together
they have one phase, up to a half turn:

    phi = 1/2 arg sum_p |c_p| (a_p / |a_p|)^2

A part costs the difference between phi of what leaves it and of what comes in. Costs add up to the
phase of the correction. Half turns are chosen so that the phase of each stage, continued straight
from the tremor's band to 0 Hz, ends nearest to zero: a pure delay comes out as one however long it
is. What is then left of a turn between their sum and the correction is the sign of one stage, as of
a part from acceleration to displacement: that which is farthest from zero in the band gives it up.
Parts that stand side by side are one stage.
"""

from __future__ import annotations

import graphlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harness.analyze.linear import CutLoop, responses
from harness.analyze.multisine import OMEGA, ComplexArray, within
from harness.analyze.operating_point import AXES
from harness.common.types import FloatArray
from harness.results.metrics import TREMOR_BAND

__all__ = ["Stage", "phase_budget"]

HALF_TURN = np.pi
NOTHING = 1e-9
"""Contribution that is rounding, of the largest."""


@dataclass(frozen=True)
class Stage:
    """One part, or several side by side, or the wires behind them.

    Attributes:
        parts: names; for wires of the parts that they lead to.
        samples: delay of the wires, `1`, or several, `1/2`; empty for parts.
        phase: (f,) that it adds, positive where it leads, mean of the axes [rad].
    """

    parts: tuple[str, ...]
    samples: str
    phase: FloatArray

    @property
    def wire(self) -> bool:
        """True for wires."""
        return bool(self.samples)

    @property
    def label(self) -> str:
        """For people: `piezo_1 … piezo_3`, `→ piezo_1, 1 sample`."""
        few = len(self.parts) <= 2
        names = ", ".join(self.parts) if few else f"{self.parts[0]} … {self.parts[-1]}"
        plural = "" if self.samples == "1" else "s"
        return f"→ {names}, {self.samples} sample{plural}" if self.wire else names

    @property
    def delay(self) -> FloatArray:
        """(f,) equivalent delay [s]."""
        return np.asarray(-self.phase / OMEGA)


_Cost = tuple[tuple[str, ...], str, FloatArray]
"""Parts, samples of the wires, phase; see `Stage`."""


@dataclass(frozen=True)
class _Path:
    """Half of the way: from the hand to the command, or from the command to the tip.

    Attributes:
        signals: (f, n) responses of the outputs.
        effects: (f, n) what a change of each does at the end of the whole way.
        ends: outputs at which it ends.
        begins: links by which it begins; none where the hand moves outputs itself.
    """

    signals: ComplexArray
    effects: ComplexArray
    ends: tuple[int, ...]
    begins: tuple[int, ...]


def phase_budget(assembly: CutLoop, correction: FloatArray) -> list[Stage]:
    """Return the stages in order; none if the way has circles beside the command's loop.

    Args:
        assembly: parts and wires.
        correction: (f,) phase of the correction against the motion, up to whole turns [rad].
    """
    found = [_along(assembly, axis) for axis in range(len(AXES))]
    # Axes may have parts of their own, but only ways of one shape have stages in common.
    if not all(found) or len({tuple(samples for _, samples, _ in one) for one in found}) > 1:
        return []
    phases = [_unwound(_mean([one[i][2] for one in found])) for i in range(len(found[0]))]
    return [
        Stage(
            parts=tuple(sorted({part for one in found for part in one[i][0]})),
            samples=samples,
            phase=phase,
        )
        for i, ((_, samples, _), phase) in enumerate(
            zip(found[0], _signed(phases, correction), strict=True)
        )
    ]


def _along(assembly: CutLoop, axis: int) -> list[_Cost]:
    """Return parts, delay of wires, and phase of each stage for motion along one axis."""
    loop, commands = assembly.loop, list(assembly.commands)
    tip = assembly.tip[axis]
    acting = responses(loop.acting)[:, axis]
    command = responses(loop.sensed)[:, :, axis]
    there = _Path(
        signals=assembly.moving[:, :, axis],
        effects=np.einsum("fu,fun->fn", acting, assembly.open[:, commands]),
        ends=assembly.commands,
        begins=(),
    )
    back = _Path(
        signals=np.einsum("fnu,fu->fn", assembly.forced, command),
        effects=assembly.open[:, tip],
        ends=(tip,),
        begins=tuple(int(i) for i in np.flatnonzero(assembly.cut)),
    )
    given = np.zeros((len(OMEGA), len(assembly.outputs)), dtype=complex)
    given[:, commands] = command
    try:
        first, phase = _stages_along(assembly, there, given, np.zeros(len(OMEGA)))
        second, _ = _stages_along(assembly, back, given, phase)
    except graphlib.CycleError:
        return []
    return first + second


def _stages_along(
    assembly: CutLoop, way: _Path, given: ComplexArray, phase: FloatArray
) -> tuple[list[_Cost], FloatArray]:
    levels = _levels(assembly, way)
    found: list[_Cost] = []
    if not levels:
        return found, phase
    if way.begins:
        before, after = _cut(assembly, way, levels, -1, given)
        found += _wires(assembly, way.begins, after - before)
        phase = after
    for level in range(max(levels.values()) + 1):
        before, after = _cut(assembly, way, levels, level, given)
        owners = dict.fromkeys(
            assembly.outputs[n].partition(".")[0] for n in levels if levels[n] == level
        )
        found.append((tuple(sorted(owners)), "", before - phase))
        crossing = [
            link
            for link, source in enumerate(assembly.source)
            if not assembly.cut[link] and levels.get(int(source), level + 1) <= level
        ]
        found += _wires(assembly, crossing, after - before)
        phase = after
    return found, phase


def _wires(assembly: CutLoop, links: Sequence[int], phase: FloatArray) -> list[_Cost]:
    """Return the wires as a stage, if they delay anything."""
    if not np.abs(np.exp(2j * phase) - 1).max() > 1e-12:
        return []
    late = [assembly.links[link] for link in links if assembly.links[link].delay]
    samples = "/".join(str(n) for n in sorted({link.delay for link in late}))
    return [(tuple(sorted({link.target.part for link in late})), samples, phase)]


def _levels(assembly: CutLoop, way: _Path) -> dict[int, int]:
    """Return the outputs on the way, by the number of others that come before."""
    contribution = np.abs(way.signals * way.effects).max(axis=0)
    on_way = {int(n) for n in np.flatnonzero(contribution > NOTHING * contribution.max())}
    before: dict[int, set[int]] = {n: set() for n in on_way}
    for link, source in enumerate(assembly.source):
        if assembly.cut[link] or int(source) not in on_way:
            continue
        answers = np.abs(assembly.parts[:, :, link]).max(axis=0) > 0.0
        for place in on_way & set(np.flatnonzero(answers).tolist()):
            before[place].add(int(source))
    levels: dict[int, int] = {}
    for n in graphlib.TopologicalSorter(before).static_order():
        levels[n] = 1 + max((levels[other] for other in before[n]), default=-1)
    return levels


def _cut(
    assembly: CutLoop, way: _Path, levels: dict[int, int], level: int, given: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """Return phases before and after the wires that lead on from a level, each (f,)."""
    later = [n for n in levels if levels[n] > level]
    before: list[ComplexArray] = []
    after: list[ComplexArray] = []
    weights: list[FloatArray] = []

    def add(signal: ComplexArray, late: ComplexArray, effect: ComplexArray) -> None:
        weights.append(np.abs(effect * signal))
        before.append(signal)
        after.append(signal * late)

    for link, source in enumerate(assembly.source):
        begins = link in way.begins
        if begins if level >= 0 else not begins:
            continue
        if level >= 0 and (assembly.cut[link] or levels.get(int(source), level + 1) > level):
            continue
        effect = np.einsum("fn,fn->f", way.effects[:, later], assembly.parts[:, later, link])
        signals = given if begins else way.signals
        add(signals[:, source], assembly.delays[:, link], effect)
    for n in way.ends:
        if levels.get(n, level + 1) <= level:
            add(way.signals[:, n], np.ones(len(OMEGA), dtype=complex), way.effects[:, n])
    return _common(before, weights), _common(after, weights)


def _common(signals: Sequence[ComplexArray], weights: Sequence[FloatArray]) -> FloatArray:
    """Return common phase of signals up to a half turn, (f,) [rad]."""
    doubled = sum(
        weight * np.exp(2j * np.angle(signal))
        for signal, weight in zip(signals, weights, strict=True)
    )
    return np.asarray(0.5 * np.angle(doubled))


def _mean(phases: Sequence[FloatArray]) -> FloatArray:
    """Return mean of phases that are known up to a half turn, (f,)."""
    return np.asarray(0.5 * np.angle(np.sum(np.exp(2j * np.array(phases)), axis=0)))


def _unwound(phase: FloatArray) -> FloatArray:
    """Unwrap a phase known up to half turns, so that it is nearest to zero at 0 Hz."""
    whole = np.unwrap(phase, period=HALF_TURN)
    inside = within(*TREMOR_BAND)
    at_zero = np.polynomial.Polynomial.fit(OMEGA[inside], whole[inside], 1)(0.0)
    return np.asarray(whole - HALF_TURN * np.round(at_zero / HALF_TURN))


def _signed(phases: list[FloatArray], correction: FloatArray) -> list[FloatArray]:
    """Choose half turns so that phases add up to one that is known up to whole turns."""
    inside = within(*TREMOR_BAND)
    missing = (correction - np.sum(phases, axis=0))[inside]
    if not phases or np.sum(np.exp(1j * missing)).real >= 0:
        return phases
    middles = [float(np.mean(phase[inside])) for phase in phases]
    farthest = int(np.argmax(np.abs(middles)))
    phases[farthest] = phases[farthest] - np.sign(middles[farthest]) * HALF_TURN
    return phases
