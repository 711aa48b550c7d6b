"""One wire of a scenario as scalar connections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from harness.common.errors import nearest
from harness.parts.ports import Port
from harness.parts.protocols import Part
from harness.scenario.schema import Wire
from harness.system.endpoint import split

__all__ = ["Link"]


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


def label_of(wire: Wire) -> str:
    return f"wire '{wire.source}' -> '{wire.target}'"


def expand(wire: Wire, parts: Mapping[str, Part], problems: list[str]) -> Iterator[Link]:
    label = label_of(wire)
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
    matched = [star for name in outputs if (star := star_of(source, name)) is not None]
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


def star_of(pattern: str, name: str) -> str | None:
    """Return what the `*` of a pattern stands for in a name; None if it does not fit."""
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


def port_named(ports: Sequence[Port], name: str) -> Port:
    return next(port for port in ports if port.name == name)
