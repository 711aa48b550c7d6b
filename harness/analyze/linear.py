"""The loop as frequency responses: parts and wires put together, opened at the command.

    s   = H E s + B r                every output, from every output over wires and parts
    s   = S (B r + H E_c u),         S = (1 - H E_0)^-1, the loop cut where the command leaves
    u   = F_1 r + L u                F_1 = R_u S B,      L = R_u S H E_c
    tip = T_0 r + F_2 u              T_0 = R_t S B,      F_2 = R_t S H E_c
    A   = (T_0 + F_2 (1 - L)^-1 F_1) M^-1

A further delay of the command multiplies F_2 and L by exp(-i w tau). Where nothing that the command
moves comes back into what the command is made from, L is zero, and the loop is a feed-forward one;
this is measured.

Parts are measured alone. A part that in the loop does with the responses R_in of its inputs to the
hand something else than H R_in = R_out by more than LINEAR is not linear to that extent. Then the
least change of H makes it what the part does in the loop,

    H <- H + (R_out - H R_in) R_in^+        R_in^+ pseudoinverse, inputs by their size in the loop

and is told with the results: such a response holds for this operation only.

| symbol | meaning |
| --- | --- |
| r, u, tip | motion of the hand along each axis of W, commands, tip |
| H, B | responses of the parts, measured one at a time; those to the hand's motion |
| E_0, E_c | wires with their delays, exp(-i w d T): all but those of the command, and those |
| M | tip without compensation by motion of the hand |
| A | tip by tip without compensation: what is left of a motion |
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import control
import numpy as np

from harness.analyze.multisine import OMEGA, ComplexArray
from harness.analyze.operating_point import OperatingPoint
from harness.analyze.part_response import TINY, PartResponse
from harness.common.types import FloatArray
from harness.system.wire import Link

__all__ = [
    "CutLoop",
    "OpenedLoop",
    "attenuation",
    "connect_parts",
    "fit_to_loop",
    "frd",
    "modified",
    "responses",
]

NOTHING = 1e-9
"""Loop gain that is rounding."""
LINEAR = 0.05
"""Largest misfit in the tremor's band of a part that passes for linear; see `CutLoop.misfit`."""


@dataclass(frozen=True)
class OpenedLoop:
    """A loop opened at its command, as frequency responses over the lines.

    Attributes:
        direct: T_0, (tip, axes).
        sensed: F_1, (commands, axes).
        acting: F_2, (tip, commands).
        returned: L, (commands, commands).
        moved: M, (tip, axes).
    """

    direct: control.FrequencyResponseData
    sensed: control.FrequencyResponseData
    acting: control.FrequencyResponseData
    returned: control.FrequencyResponseData
    moved: control.FrequencyResponseData

    @property
    def feedback(self) -> bool:
        """True if the command comes back into what it is made from."""
        return bool(np.abs(responses(self.returned)).max() > NOTHING)

    @cached_property
    def open_correction(self) -> ComplexArray:
        """F_2 F_1 M^-1, (f, tip, axes): what the command does, ideally -1, the loop open."""
        return responses(self.acting * self.sensed) @ np.linalg.inv(responses(self.moved))


@dataclass(frozen=True)
class CutLoop:
    """All signals of the loop, with the wires of the command cut.

    Attributes:
        outputs: `part.port` of every output, (n).
        links: that carry something to an input that was probed.
        commands: outputs that are the command, places in `outputs`.
        tip: places in `outputs`.
        moved: places in `outputs`.
        parts: H by link: response of all outputs to the target, (f, n, links).
        delays: exp(-i w d T), (f, links).
        cut: (links,) whether a link carries a command.
        source: (links,) place in `outputs`.
        motion: B, (f, n, axes).
    """

    outputs: tuple[str, ...]
    links: tuple[Link, ...]
    commands: tuple[int, ...]
    tip: tuple[int, ...]
    moved: tuple[int, ...]
    parts: ComplexArray
    delays: ComplexArray
    cut: np.ndarray
    source: np.ndarray
    motion: ComplexArray

    @cached_property
    def open(self) -> ComplexArray:
        """S, (f, n, n)."""
        carried = self._carried(~self.cut)
        return np.asarray(np.linalg.inv(np.eye(len(self.outputs)) - carried), dtype=complex)

    @cached_property
    def forced(self) -> ComplexArray:
        """S H E_c, (f, n, commands): all outputs by the command."""
        return self.open @ self._carried(self.cut)[:, :, list(self.commands)]

    @cached_property
    def moving(self) -> ComplexArray:
        """S B, (f, n, axes): all outputs by the hand, the command at rest."""
        return self.open @ self.motion

    def _carried(self, which: np.ndarray) -> ComplexArray:
        """Return H E of some links, (f, n, n)."""
        n = len(self.outputs)
        carried = np.zeros((len(OMEGA), n, n), dtype=complex)
        for link in np.flatnonzero(which):
            carried[:, :, self.source[link]] += self.parts[:, :, link] * self.delays[:, [link]]
        return carried

    @cached_property
    def effect(self) -> ComplexArray:
        """Effect of a change of each output on the tip, the loop open, (f, tip, n)."""
        tip, commands = list(self.tip), list(self.commands)
        return self.open[:, tip] + self.forced[:, tip] @ self.open[:, commands]

    def misfit(self, responses: ComplexArray) -> dict[str, FloatArray]:
        """Measure how well each part alone does what it does in the loop.

        Args:
            responses: of all outputs to the hand, in the loop, (f, n, axes).

        Returns:
            For each part, (f,), what is left of its outputs' responses to the hand when those of
            its inputs are passed through it: by its effect on the tip, per motion of the hand, rms
            over the axes.
        """
        everything = self._carried(np.ones(len(self.links), dtype=bool))
        left = responses - everything @ responses - self.motion
        found = {}
        owners = np.array([name.partition(".")[0] for name in self.outputs])
        for part in dict.fromkeys(owners):
            mine = owners == part
            error = self.effect[:, :, mine] @ left[:, mine]
            found[str(part)] = np.sqrt(np.mean(np.abs(error) ** 2, axis=(1, 2)) * 3.0)
        return found

    @cached_property
    def loop(self) -> OpenedLoop:
        """Loop, described by what it does with motion and commands."""
        tip, commands = list(self.tip), list(self.commands)
        return OpenedLoop(
            direct=frd(self.moving[:, tip]),
            sensed=frd(self.moving[:, commands]),
            acting=frd(self.forced[:, tip]),
            returned=frd(self.forced[:, commands]),
            moved=frd(self.moving[:, list(self.moved)]),
        )


def frd(response: ComplexArray) -> control.FrequencyResponseData:
    """Return a response (f, out, in) over the lines as an object of python-control."""
    return control.FrequencyResponseData(np.moveaxis(response, 0, 2), OMEGA)


def responses(system: control.FrequencyResponseData) -> ComplexArray:
    """Return a response as (f, out, in)."""
    return np.moveaxis(system.frdata, 2, 0)


def connect_parts(
    blocks: Iterable[PartResponse],
    links: Sequence[Link],
    roles: Mapping[str, Sequence[str]],
    hand: str,
    step: float,
) -> CutLoop:
    """Join the responses of the parts over the wires.

    Args:
        blocks: of all parts with connected inputs.
        links: of the loop.
        roles: `tip_uncompensated`, `tip`, `actuator_voltage`, each with `part.port`.
        hand: part that is the hand.
        step: sample period [s].
    """
    blocks = list(blocks)
    outputs = tuple(name for block in blocks for name in block.outputs)
    place = {name: i for i, name in enumerate(outputs)}
    columns = {label: (block, i) for block in blocks for i, label in enumerate(block.inputs)}
    kept = [link for link in links if str(link.target) in columns and str(link.source) in place]

    def column(label: str) -> ComplexArray:
        block, i = columns[label]
        column_of_all = np.zeros((len(OMEGA), len(outputs)), dtype=complex)
        first = place[block.outputs[0]]
        column_of_all[:, first : first + len(block.outputs)] = block.response[:, :, i]
        return column_of_all

    sources = [str(link.source) for link in kept]
    commands = tuple(dict.fromkeys(place[n] for n in roles["actuator_voltage"] if n in place))
    return CutLoop(
        outputs=outputs,
        links=tuple(kept),
        commands=commands,
        tip=tuple(place[name] for name in roles["tip"]),
        moved=tuple(place[name] for name in roles["tip_uncompensated"]),
        parts=_stacked([column(str(link.target)) for link in kept]),
        delays=_stacked([np.exp(-1j * OMEGA * link.delay * step) for link in kept]),
        cut=np.array([place[name] in commands for name in sources], dtype=bool),
        source=np.array([place[name] for name in sources], dtype=np.intp),
        motion=_stacked([column(f"{hand}.{axis}") for axis in "xyz"]),
    )


def _stacked(columns: Sequence[ComplexArray]) -> ComplexArray:
    return np.stack(columns, axis=-1)


def fit_to_loop(
    block: PartResponse,
    links: Sequence[Link],
    operation: OperatingPoint,
    seen: ComplexArray,
    step: float,
) -> PartResponse:
    """Return the response with the least change that makes it agree with the loop.

    Args:
        block: measured alone.
        links: of the loop.
        operation: signals of the loop.
        seen: responses of all signals to the hand, (f, names, axes).
        step: sample period [s].
    """
    into = {str(link.target): link for link in links}
    feeds = [into[label] for label in block.inputs]
    places = [operation.names.index(str(link.source)) for link in feeds]
    late = _stacked([np.exp(-1j * OMEGA * link.delay * step) for link in feeds])
    sizes = np.maximum(operation.amplitudes[:, places], TINY)
    moved = seen[:, places] * late[:, :, None]
    given = seen[:, [operation.names.index(name) for name in block.outputs]]
    missing = given - block.response @ moved
    inverse = np.linalg.pinv(moved / sizes[:, :, None], rcond=1e-6)
    return replace(block, response=block.response + missing @ inverse / sizes[:, None, :])


def modified(loop: OpenedLoop, delay: float = 0.0, gain: float = 1.0) -> OpenedLoop:
    """Return the loop with its command later or larger.

    Args:
        loop: as it is.
        delay: further delay [s].
        gain: factor.
    """
    factor = gain * np.exp(-1j * OMEGA * delay)
    made = frd(factor[:, None, None] * np.eye(loop.acting.ninputs))
    return OpenedLoop(
        loop.direct, loop.sensed, loop.acting * made, loop.returned * made, loop.moved
    )


def attenuation(loop: OpenedLoop) -> ComplexArray:
    """Return A, (f, tip, axes): motion of the tip by its motion without compensation."""
    # FRD.feedback takes its sign from the argument only: (1 - L)^-1 = 1 / (1 + 1 (-L)).
    one = frd(np.broadcast_to(np.eye(loop.returned.ninputs), responses(loop.returned).shape))
    tip = loop.direct + loop.acting * one.feedback(-loop.returned) * loop.sensed
    return responses(tip) @ np.linalg.inv(responses(loop.moved))
