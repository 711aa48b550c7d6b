"""Who drives whom, in which order the parts run, and whether that makes sense at all.

A wire without delay hands on a value within the tick, so its source runs before its target. A wire
with `delay = d` hands on the value of d ticks ago (before the first tick: the initial one) and
orders nothing. Parts run in topological order, ties in the order of the scenario.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from harness.common.errors import ProblemsError
from harness.parts.protocols import Part
from harness.scenario.schema import Wire
from harness.system.order import run_order
from harness.system.wire import Link, expand, label_of, port_named

__all__ = ["Wiring", "connect"]


@dataclass(frozen=True)
class Wiring:
    """Checked connections of a set of parts.

    Attributes:
        order: names of the parts in run order.
        links: all connections.
        unconnected: `part.port` of the inputs that keep their start value.
        notes: what could not be checked.
    """

    order: tuple[str, ...]
    links: tuple[Link, ...]
    unconnected: tuple[str, ...]
    notes: tuple[str, ...]

    def into(self, part: str) -> dict[str, Link]:
        """Return the connections to the inputs of a part, by input."""
        return {link.target.port: link for link in self.links if link.target.part == part}


def connect(where: str, parts: Mapping[str, Part], wires: Sequence[Wire]) -> Wiring:
    """Expand and check wires between parts.

    Args:
        where: name of the scenario, for messages.
        parts: by name, in the scenario's order.
        wires: as the scenario has them.

    Raises:
        ProblemsError: unknown parts or ports, types or units that differ, inputs driven twice,
            loops without delay; all of them at once, but loops only when the rest is right.
    """
    problems: list[str] = []
    links: list[Link] = []
    connected: dict[tuple[str, str], Link] = {}
    for wire in wires:
        for link in expand(wire, parts, problems):
            target = link.target
            if target in connected:
                problems.append(
                    f"input '{link.target}' is driven twice: by "
                    f"{label_of(connected[target].wire)} and by {label_of(link.wire)}; keep one"
                )
                continue
            connected[target] = link
            links.append(link)
    notes = [note for link in links for note in _compare(link, parts, problems)]
    if problems:
        raise ProblemsError(where, problems)
    return Wiring(
        order=run_order(where, parts, links),
        links=tuple(links),
        unconnected=tuple(
            f"{name}.{port.name}"
            for name, part in parts.items()
            for port in part.inputs
            if (name, port.name) not in connected
        ),
        notes=tuple(dict.fromkeys(notes)),
    )


def _compare(link: Link, parts: Mapping[str, Part], problems: list[str]) -> Iterator[str]:
    source = port_named(parts[link.source.part].outputs, link.source.port)
    target = port_named(parts[link.target.part].inputs, link.target.port)
    if source.type != target.type:
        problems.append(
            f"wire '{link}': types differ ({source.type}, {target.type}); "
            "both sides have to be of one type"
        )
        return
    if source.type != "Real":
        return
    if source.unit is None or target.unit is None:
        silent = link.source.part if source.unit is None else link.target.part
        yield f"units of '{silent}' are not checked: its FMU declares none"
    elif not source.unit.same_as(target.unit):
        problems.append(
            f"wire '{link}': units differ ({source.unit.name}, {target.unit.name}). "
            f"Convert in '{link.source.part}', or declare the input in {source.unit.name}."
        )
