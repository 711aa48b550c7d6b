"""Who drives whom, in which order the parts run, and whether that makes sense at all.

A wire without delay hands on a value within the tick, so its source runs before its target. A wire
with `delay = d` hands on the value of d ticks ago (before the first tick: the initial one) and
orders nothing. Parts run in topological order, ties in the order of the scenario.
"""

from __future__ import annotations

import graphlib
import heapq
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from harness.errors import ProblemsError, SteadytipError, nearest
from harness.parts import Part, Port
from harness.scenario import Wire

__all__ = ["Link", "Wiring", "connect", "cross", "split", "stable_order", "tap"]


@dataclass(frozen=True)
class Link:
    """One scalar connection.

    Attributes:
        source_part: name of the part that gives the value.
        source: its output.
        target_part: name of the part that takes it.
        target: its input.
        delay: ticks.
        wire: the scenario's wire that it comes from.
    """

    source_part: str
    source: str
    target_part: str
    target: str
    delay: int
    wire: Wire

    def __str__(self) -> str:
        return f"{self.source_part}.{self.source} -> {self.target_part}.{self.target}"


@dataclass(frozen=True)
class Wiring:
    """Checked connections of a set of parts.

    Attributes:
        order: names of the parts in run order.
        links: all connections.
        undriven: `part.port` of the inputs that keep their start value.
        notes: what could not be checked.
    """

    order: tuple[str, ...]
    links: tuple[Link, ...]
    undriven: tuple[str, ...]
    notes: tuple[str, ...]


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
    driven: dict[tuple[str, str], Link] = {}
    for wire in wires:
        for link in _expand(wire, parts, problems):
            target = (link.target_part, link.target)
            if target in driven:
                problems.append(
                    f"input '{link.target_part}.{link.target}' is driven twice: by "
                    f"{_label(driven[target].wire)} and by {_label(link.wire)}; keep one"
                )
                continue
            driven[target] = link
            links.append(link)
    notes = [note for link in links for note in _compare(link, parts, problems)]
    if problems:
        raise ProblemsError(where, problems)
    return Wiring(
        order=_run_order(where, parts, links),
        links=tuple(links),
        undriven=tuple(
            f"{name}.{port.name}"
            for name, part in parts.items()
            for port in part.inputs
            if (name, port.name) not in driven
        ),
        notes=tuple(dict.fromkeys(notes)),
    )


def cross(
    wires: Sequence[Wire], parts: Mapping[str, Part], gone: Collection[str]
) -> tuple[list[Wire], list[str]]:
    """Wires as they run where some parts are at the other end of a bus.

    A wire from one side to the other goes over the bus if the part on it has a port with the name
    of the wire's output; the bus takes a sample of its delay. All others end in the open.

    Args:
        wires: as the scenario has them.
        parts: by name, companions among them.
        gone: names of the parts that are at the other end.

    Returns:
        Wires, and notes on those that end in the open.
    """
    buses = [name for name, part in parts.items() if getattr(part, "companions", None) is not None]
    if not buses:
        return list(wires), []
    kept: dict[str, Wire] = {}
    notes: list[str] = []
    for wire in wires:
        (start, _, output), (end, _, _) = wire.source.partition("."), wire.target.partition(".")
        target = split(wire.target, parts)
        leaves = end in gone or (target is not None and target[0] in buses)
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
            for part in ([bus] if arrives else parts[bus].companions)  # type: ignore[attr-defined]
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


def tap(
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
        links = list(_expand(wire, parts, []))
        ends = [(f"{k.source_part}.{k.source}", f"{k.target_part}.{k.target}") for k in links]
        labels.update(label for both in ends for label in both)
        if not any(place in both for both in ends):
            found.append(wire)
            continue
        for link, (source, target) in zip(links, ends, strict=True):
            hit = place in (source, target)
            found.append(Wire(exit if hit else source, target, wire.delay))
            if hit:
                sources[source] = _port(parts[link.source_part].outputs, link.source)
    if not sources:
        raise SteadytipError(f"no wire begins or ends at '{place}'; {nearest(place, labels)}")
    for source, port in sources.items():
        if port.type != "Real":
            raise SteadytipError(f"'{source}' is {port.type}; only Real signals can go wrong")
        found.append(Wire(source, entry))
    return found


def _by_name(
    parts: Mapping[str, Part], buses: Sequence[str], driven: Sequence[str]
) -> Iterator[Wire]:
    """What a board can send and no wire brings, from the one part that has it."""
    for bus in buses:
        for name, companion in parts[bus].companions.items():  # type: ignore[attr-defined]
            if not getattr(companion, "takes_by_name", False):
                continue
            for port in companion.inputs:
                target = f"{name}.{port.name}"
                sources = [n for n, p in parts.items() if n != bus and _has(p, port.name, False)]
                if len(sources) == 1 and not any(_fits(text, target) for text in driven):
                    yield Wire(f"{sources[0]}.{port.name}", target)


def _fits(pattern: str, name: str) -> bool:
    return _star(pattern, name) is not None if "*" in pattern else pattern == name


def _has(part: Part, pattern: str, as_input: bool) -> bool:
    ports = part.inputs if as_input else part.outputs
    if "*" not in pattern:
        return any(port.name == pattern for port in ports)
    return any(_star(pattern, port.name) is not None for port in ports)


def split(text: str, parts: Mapping[str, Part]) -> tuple[str, str] | None:
    """Part and port of `part.port`; None if it starts with no part's name.

    Port names may hold dots and so may the names of parts that were brought along, so the longest
    name that fits is taken.
    """
    fitting = [name for name in parts if text.startswith(f"{name}.")]
    if not fitting:
        return None
    name = max(fitting, key=len)
    return name, text[len(name) + 1 :]


def _label(wire: Wire) -> str:
    return f"wire '{wire.source}' -> '{wire.target}'"


def _expand(wire: Wire, parts: Mapping[str, Part], problems: list[str]) -> Iterator[Link]:
    label = _label(wire)
    start, end = split(wire.source, parts), split(wire.target, parts)
    for text, found in ((wire.source, start), (wire.target, end)):
        if found is None:
            name = text.partition(".")[0]
            problems.append(f"{label}: there is no part '{name}'; {nearest(name, parts)}")
    if start is None or end is None:
        return
    (source_part, source), (target_part, target) = start, end
    if [source.count("*"), target.count("*")] not in ([0, 0], [1, 1]):
        problems.append(f"{label}: a wire has one '*' on both sides or none at all")
        return
    outputs = [port.name for port in parts[source_part].outputs]
    inputs = [port.name for port in parts[target_part].inputs]
    if "*" not in source:
        good = _known(label, parts[source_part], source, "output", problems)
        if _known(label, parts[target_part], target, "input", problems) and good:
            yield Link(source_part, source, target_part, target, wire.delay, wire)
        return
    matched = [star for name in outputs if (star := _star(source, name)) is not None]
    both = [star for star in matched if target.replace("*", star) in inputs]
    if not both:
        side = "matches an output" if not matched else "matches an input for the same '*'"
        problems.append(
            f"{label}: nothing {side}; {source_part} gives {', '.join(outputs) or 'nothing'}; "
            f"{target_part} takes {', '.join(inputs) or 'nothing'}"
        )
    for star in both:
        yield Link(
            source_part,
            source.replace("*", star),
            target_part,
            target.replace("*", star),
            wire.delay,
            wire,
        )


def _star(pattern: str, name: str) -> str | None:
    """What the `*` of a pattern stands for in a name; None if it does not fit."""
    head, _, tail = pattern.partition("*")
    fits = name.startswith(head) and name.endswith(tail) and len(name) >= len(head) + len(tail)
    return name[len(head) : len(name) - len(tail)] if fits else None


def _known(
    label: str,
    part: Part,
    port: str,
    role: Literal["output", "input"],
    problems: list[str],
) -> bool:
    names, others = [port.name for port in part.outputs], [port.name for port in part.inputs]
    other = "input"
    if role == "input":
        names, others, other = others, names, "output"
    if port in names:
        return True
    if port in others:
        problems.append(f"{label}: '{part.name}.{port}' is an {other}, not an {role}")
    else:
        problems.append(f"{label}: '{part.name}' has no {role} '{port}'; {nearest(port, names)}")
    return False


def _port(ports: Sequence[Port], name: str) -> Port:
    return next(port for port in ports if port.name == name)


def _compare(link: Link, parts: Mapping[str, Part], problems: list[str]) -> Iterator[str]:
    source = _port(parts[link.source_part].outputs, link.source)
    target = _port(parts[link.target_part].inputs, link.target)
    if source.type != target.type:
        problems.append(
            f"wire '{link}': types differ ({source.type}, {target.type}); "
            "both sides have to be of one type"
        )
        return
    if source.type != "Real":
        return
    if source.unit is None or target.unit is None:
        silent = link.source_part if source.unit is None else link.target_part
        yield f"units of '{silent}' are not checked: its FMU declares none"
    elif not source.unit.same_as(target.unit):
        problems.append(
            f"wire '{link}': units differ ({source.unit.name}, {target.unit.name}). "
            f"Convert in '{link.source_part}', or declare the input in {source.unit.name}."
        )


def stable_order(before: Mapping[str, set[str]]) -> list[str]:
    """Names after all that they wait for; those that are free to, in the order given.

    Args:
        before: for each name those that come before it.

    Raises:
        graphlib.CycleError: some wait for each other.
    """
    names = list(before)
    rank = {name: index for index, name in enumerate(names)}
    sorter = graphlib.TopologicalSorter(before)
    sorter.prepare()
    ready: list[int] = []
    order: list[str] = []
    while sorter.is_active():
        for name in sorter.get_ready():
            heapq.heappush(ready, rank[name])
        name = names[heapq.heappop(ready)]
        order.append(name)
        sorter.done(name)
    return order


def _run_order(where: str, parts: Mapping[str, Part], links: Sequence[Link]) -> tuple[str, ...]:
    before: dict[str, set[str]] = {name: set() for name in parts}
    for link in links:
        if link.delay == 0:
            before[link.target_part].add(link.source_part)
    try:
        return tuple(stable_order(before))
    except graphlib.CycleError as error:
        raise ProblemsError(where, [_cycle_text(error.args[1], links, parts)]) from None


def _cycle_text(cycle: Sequence[str], links: Sequence[Link], parts: Mapping[str, Part]) -> str:
    lines = []
    hint = ""
    # graphlib gives predecessors first and repeats the first name at the end.
    for source, target in itertools.pairwise(cycle):
        between = [
            link
            for link in links
            if (link.source_part, link.target_part, link.delay) == (source, target, 0)
        ]
        more = f" and {len(between) - 1} more" if len(between) > 1 else ""
        lines.append(f"\n    {between[0]}{more}")
        if not hint and all(_without_feedthrough(link, parts) for link in between):
            hint = (
                f" '{target}' declares that none of its outputs depends on these inputs within a "
                f"sample: the wire from '{source}' to '{target}' is a natural place."
            )
    return (
        f"parts wait for each other in a loop without delay: {' -> '.join(cycle)}{''.join(lines)}\n"
        f"    Declare 'delay = 1' on one of these wires.{hint}"
    )


def _without_feedthrough(link: Link, parts: Mapping[str, Part]) -> bool:
    return all(
        port.depends_on is not None and link.target not in port.depends_on
        for port in parts[link.target_part].outputs
    )
