"""Wires that go over a bus."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from harness.common.endpoint import Endpoint
from harness.parts.protocols import Part
from harness.scenario.schema import Wire
from harness.system.wire import star_of

__all__ = ["route_over_bus"]


def route_over_bus(
    wires: Sequence[Wire], parts: Mapping[str, Part], gone: Collection[str]
) -> tuple[list[Wire], list[str]]:
    """Wires as they run where some parts are at the other end of a bus.

    A wire from one side to the other goes over the bus if the part on it has a port with the name
    of the wire's output; the bus takes a sample of its delay. All others end in the open.

    Args:
        wires: as the scenario has them.
        parts: by name, siblings among them.
        gone: names of the parts that are at the other end.

    Returns:
        Wires, and notes on those that end in the open.
    """
    buses = [name for name, part in parts.items() if getattr(part, "siblings", None) is not None]
    if not buses:
        return list(wires), []
    everything = [*parts, *gone]
    kept: dict[str, Wire] = {}
    notes: list[str] = []
    for wire in wires:
        start, output = Endpoint.find(wire.source, everything) or Endpoint("", "")
        target = Endpoint.find(wire.target, everything)
        leaves = target is not None and (target.part in gone or target.part in buses)
        # What a board makes of its commands is out there, too: it has no port for it.
        arrives = start in gone or (start in buses and not _has(parts[start], output, False))
        if not leaves and not arrives:
            kept[wire.target] = wire
            continue
        if arrives and leaves:
            continue
        over = [
            text
            for bus in buses
            for part in ([bus] if arrives else parts[bus].siblings)  # type: ignore[attr-defined]
            if _has(parts[part], output, not arrives)
            for text in [f"{part}.{output}"]
        ]
        if not over:
            notes.append(f"wire '{wire.source}' -> '{wire.target}' has no signal on the bus")
        elif arrives:
            kept[wire.target] = Wire(over[0], wire.target, max(0, wire.delay - 1))
        else:
            kept[over[0]] = Wire(wire.source, over[0], max(0, wire.delay - 1))
    for wire in _by_name(parts, buses, list(kept)):
        kept[wire.target] = wire
    return list(kept.values()), notes


def _by_name(
    parts: Mapping[str, Part], buses: Sequence[str], connected: Sequence[str]
) -> Iterator[Wire]:
    """Yield wires for what a board can send and no wire brings, from the one part that has it."""
    for bus in buses:
        for name, companion in parts[bus].siblings.items():  # type: ignore[attr-defined]
            if not getattr(companion, "takes_by_name", False):
                continue
            for port in companion.inputs:
                target = f"{name}.{port.name}"
                sources = [n for n, p in parts.items() if n != bus and _has(p, port.name, False)]
                if len(sources) == 1 and not any(_fits(text, target) for text in connected):
                    yield Wire(f"{sources[0]}.{port.name}", target)


def _fits(pattern: str, name: str) -> bool:
    return star_of(pattern, name) is not None if "*" in pattern else pattern == name


def _has(part: Part, pattern: str, as_input: bool) -> bool:
    ports = part.inputs if as_input else part.outputs
    if "*" not in pattern:
        return any(port.name == pattern for port in ports)
    return any(star_of(pattern, port.name) is not None for port in ports)
