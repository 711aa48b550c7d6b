"""Order in which parts run."""

from __future__ import annotations

import graphlib
import heapq
import itertools
from collections.abc import Mapping, Sequence

from harness.common.errors import ProblemsError
from harness.parts.protocols import Part
from harness.system.wire import Link

__all__ = ["stable_order"]


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


def run_order(where: str, parts: Mapping[str, Part], links: Sequence[Link]) -> tuple[str, ...]:
    before: dict[str, set[str]] = {name: set() for name in parts}
    for link in links:
        if link.delay == 0:
            before[link.target.part].add(link.source.part)
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
            if (link.source.part, link.target.part, link.delay) == (source, target, 0)
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
        port.depends_on is not None and link.target.port not in port.depends_on
        for port in parts[link.target.part].outputs
    )
