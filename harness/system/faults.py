"""Parts that are put into wires to make them faulty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.parts.ports import Port
from harness.parts.protocols import Part
from harness.scenario.events import Fault
from harness.scenario.schema import Wire
from harness.system.wire import expand, port_named

__all__ = ["insert_fault", "insert_faults"]


def insert_fault(
    wires: Sequence[Wire], parts: Mapping[str, Part], place: str, entry: str, exit: str
) -> list[Wire]:
    """Wires with something put into one of them, before its delay.

    Args:
        wires: as the scenario has them.
        parts: by name.
        place: `part.port`: an output, for all wires from it, or an input, for the wire to it.
        entry: `part.port` that takes the signal.
        exit: `part.port` that gives it on.

    Raises:
        SteadytipError: no wire begins or ends there, or its values are not Real.
    """
    found: list[Wire] = []
    sources: dict[str, Port] = {}
    labels: set[str] = set()
    for wire in wires:
        links = list(expand(wire, parts, []))
        ends = [(str(link.source), str(link.target)) for link in links]
        labels.update(label for both in ends for label in both)
        if not any(place in both for both in ends):
            found.append(wire)
            continue
        for link, (source, target) in zip(links, ends, strict=True):
            hit = place in (source, target)
            found.append(Wire(exit if hit else source, target, wire.delay))
            if hit:
                sources[source] = port_named(parts[link.source.part].outputs, link.source.port)
    if not sources:
        raise SteadytipError(f"no wire begins or ends at '{place}'; {nearest(place, labels)}")
    for source, port in sources.items():
        if port.type != "Real":
            raise SteadytipError(f"'{source}' is {port.type}; only Real signals can go wrong")
        found.append(Wire(source, entry))
    return found


def insert_faults(
    wires: Sequence[Wire], parts: Mapping[str, Part], faults: Sequence[Fault]
) -> tuple[list[Wire], list[str]]:
    """Wires with the parts of the faults in them, and what is wrong with the faults."""
    found = list(wires)
    problems: list[str] = []
    for place in dict.fromkeys((fault.wire, fault.part) for fault in faults):
        try:
            found = insert_fault(found, parts, place[0], f"{place[1]}.signal", f"{place[1]}.faulty")
        except SteadytipError as error:
            problems.append(f"fault: {error}")
    return found, problems
