"""Run order and delays of a system whose description knows neither.

SSP lists components and connections. Everything that runs one after the other within a sample needs
an order, and a loop needs a delay somewhere. The rule here, for reading and for writing:

1. A component runs after those that drive it.
2. In a loop, a connection into an input on which no output depends within a sample (as the FMU's
   `ModelStructure` declares) does not count for that.
3. In a loop that is closed nevertheless, neither does one from a later component of the file to an
   earlier one.
4. Components that are free to change places keep the order of the file.

A connection from a component that runs later, or to itself, is delayed by one sample; the others
are not delayed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from harness.common.endpoint import Endpoint
from harness.parts.ports import Port
from harness.system.order import stable_order

__all__ = ["Connection", "delays", "feedthrough", "lag", "run_order"]


@dataclass(frozen=True)
class Connection:
    """Output to input.

    Attributes:
        source: output of the component that gives the value.
        target: input of the component that takes it.
    """

    source: Endpoint
    target: Endpoint

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


def feedthrough(outputs: Iterable[Port], name: str) -> bool:
    """Return whether an output may depend on the input `name` within a sample."""
    return any(port.depends_on is None or name in port.depends_on for port in outputs)


def run_order(
    parts: Sequence[str],
    connections: Collection[Connection],
    through: Callable[[Connection], bool],
) -> list[str]:
    """Parts in the order in which they run.

    Args:
        parts: in the order of the file.
        connections: between them.
        through: whether an output of the target may depend on that input within a sample.
    """
    rank = {name: index for index, name in enumerate(parts)}
    loop = _loops(rank, connections)
    counting = [c for c in connections if loop[c.source.part] != loop[c.target.part] or through(c)]
    loop = _loops(rank, counting)
    counting = [
        c
        for c in counting
        if loop[c.source.part] != loop[c.target.part] or rank[c.source.part] < rank[c.target.part]
    ]
    before: dict[str, set[str]] = {name: set() for name in parts}
    for connection in counting:
        before[connection.target.part].add(connection.source.part)
    return stable_order(before)


def delays(order: Sequence[str], connections: Iterable[Connection]) -> dict[Connection, int]:
    """Return the samples by which each connection is delayed when parts run in this order."""
    place = {name: index for index, name in enumerate(order)}
    return {c: int(place[c.source.part] >= place[c.target.part]) for c in connections}


def lag(
    order: Sequence[str],
    connections: Collection[Connection],
    periods: Mapping[str, float],
) -> dict[str, float]:
    """Return how much later than in the harness a Jacobi master brings signals to each part [s].

    Communication steps are as short as the shortest sample period. A part that samples at `n T`
    then sees what the others have put out before `n T`: of a source with the same period, its
    sample before. In the harness it sees the sample of the same instant, where the connection is
    not delayed. What was late at the source is late at the target, too; where several ways lead to
    a part, the longest counts.

    Args:
        order: parts in run order.
        connections: between them.
        periods: sample period of each part [s].
    """
    late = dict.fromkeys(order, 0.0)
    delayed = delays(order, connections)
    for name in order:
        late[name] = max(
            (
                late[c.source.part] + periods[c.source.part]
                for c in connections
                if c.target.part == name and not delayed[c]
            ),
            default=0.0,
        )
    return late


def _loops(rank: Mapping[str, int], connections: Iterable[Connection]) -> dict[str, int]:
    """Return the number of the loop that each part is in; equal for parts that reach each other."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    edges = [(rank[c.source.part], rank[c.target.part]) for c in connections]
    rows, columns = np.array(edges, dtype=int).reshape(-1, 2).T
    graph = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(rank), len(rank)))
    _, labels = connected_components(graph, connection="strong")
    return {name: int(labels[index]) for name, index in rank.items()}
