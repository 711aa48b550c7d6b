"""One wire of a scenario as scalar connections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from harness.common.endpoint import Endpoint
from harness.common.errors import nearest
from harness.parts.ports import Port
from harness.parts.protocols import Part
from harness.scenario.schema import Wire

__all__ = ["Link"]


@dataclass(frozen=True)
class Link:
    """One scalar connection.

    Attributes:
        source: output that gives the value.
        target: input that takes it.
        delay: ticks.
        wire: the scenario's wire that it comes from.
    """

    source: Endpoint
    target: Endpoint
    delay: int
    wire: Wire

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


def label_of(wire: Wire) -> str:
    return f"wire '{wire.source}' -> '{wire.target}'"


def expand(wire: Wire, parts: Mapping[str, Part], problems: list[str]) -> Iterator[Link]:
    label = label_of(wire)
    start, end = Endpoint.find(wire.source, parts), Endpoint.find(wire.target, parts)
    for text, found in ((wire.source, start), (wire.target, end)):
        if found is None:
            name = text.partition(".")[0]
            problems.append(f"{label}: there is no part '{name}'; {nearest(name, parts)}")
    if start is None or end is None:
        return
    source, target = start.port, end.port
    if [source.count("*"), target.count("*")] not in ([0, 0], [1, 1]):
        problems.append(f"{label}: a wire has one '*' on both sides or none at all")
        return
    outputs = [port.name for port in parts[start.part].outputs]
    inputs = [port.name for port in parts[end.part].inputs]
    if "*" not in source:
        good = _known(label, parts[start.part], source, "output", problems)
        if _known(label, parts[end.part], target, "input", problems) and good:
            yield Link(start, end, wire.delay, wire)
        return
    matched = [star for name in outputs if (star := star_of(source, name)) is not None]
    both = [star for star in matched if target.replace("*", star) in inputs]
    if not both:
        side = "matches an output" if not matched else "matches an input for the same '*'"
        problems.append(
            f"{label}: nothing {side}; {start.part} gives {', '.join(outputs) or 'nothing'}; "
            f"{end.part} takes {', '.join(inputs) or 'nothing'}"
        )
    for star in both:
        yield Link(
            start._replace(port=source.replace("*", star)),
            end._replace(port=target.replace("*", star)),
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
