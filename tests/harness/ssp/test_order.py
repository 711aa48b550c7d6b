"""Run order and delays that follow from a system's connections alone."""

import graphlib

from hypothesis import given
from hypothesis import strategies as st

from harness.common.endpoint import Endpoint
from harness.parts.ports import Port
from harness.ssp.order import Connection, delays, feedthrough, lag, run_order

NAMES = [f"p{i}" for i in range(6)]


def wire(source: str, target: str) -> Connection:
    return Connection(Endpoint(source, f"to_{target}"), Endpoint(target, f"from_{source}"))


GRAPHS = st.tuples(
    st.permutations(NAMES),
    st.sets(st.builds(wire, st.sampled_from(NAMES), st.sampled_from(NAMES))),
    st.sets(st.sampled_from(NAMES)),
)
"""Order in the file, connections, components without feed-through."""


def order_of(parts, connections, without):
    return run_order(parts, connections, lambda c: c.target.part not in without)


@given(GRAPHS)
def test_undelayed_connections_leave_no_loop_and_go_forward(graph):
    parts, connections, without = graph
    order = order_of(parts, connections, without)
    assert sorted(order) == sorted(parts)
    delayed = delays(order, connections)
    before: dict[str, set[str]] = {name: set() for name in parts}
    for c in connections:
        if not delayed[c]:
            before[c.target.part].add(c.source.part)
            assert order.index(c.source.part) < order.index(c.target.part)
    graphlib.TopologicalSorter(before).prepare()


@given(GRAPHS)
def test_nothing_outside_a_loop_is_delayed(graph):
    parts, connections, without = graph
    delayed = delays(order_of(parts, connections, without), connections)
    reach = {name: {name} for name in parts}
    for _ in parts:
        for c in connections:
            reach[c.source.part] |= reach[c.target.part]
    for c in connections:
        assert not delayed[c] or c.source.part in reach[c.target.part]


@given(GRAPHS)
def test_an_exported_system_is_read_back_as_it_was(graph):
    """Export writes components in run order; reading that file gives the same order and delays."""
    parts, connections, without = graph
    order = order_of(parts, connections, without)
    assert order_of(order, connections, without) == order


def test_a_loop_is_cut_where_a_component_has_no_feedthrough():
    loop = [wire("p0", "p1"), wire("p1", "p2"), wire("p2", "p0")]
    for without, cut in (("p1", loop[0]), ("p2", loop[1]), ("p0", loop[2])):
        delayed = delays(order_of(NAMES[:3], loop, {without}), loop)
        assert [c for c in loop if delayed[c]] == [cut]


def test_a_loop_with_feedthrough_everywhere_is_cut_where_it_goes_back_in_the_file():
    loop = [wire("p0", "p1"), wire("p1", "p2"), wire("p2", "p0")]
    for first, cut in ((0, loop[2]), (1, loop[0]), (2, loop[1])):
        parts = NAMES[first:3] + NAMES[:first]
        delayed = delays(order_of(parts, loop, set()), loop)
        assert [c for c in loop if delayed[c]] == [cut]


def test_feedthrough_is_what_the_outputs_declare():
    assert feedthrough([Port("y", depends_on=frozenset({"u"}))], "u")
    assert not feedthrough([Port("y", depends_on=frozenset({"v"}))], "u")
    assert feedthrough([Port("y", depends_on=None)], "u")


def test_lag_adds_the_periods_along_the_longest_way_and_stops_at_a_delay():
    connections = [wire("p0", "p1"), wire("p1", "p2"), wire("p0", "p2"), wire("p2", "p0")]
    periods = {"p0": 1e-3, "p1": 2e-3, "p2": 1e-3}
    assert lag(NAMES[:3], connections, periods) == {"p0": 0.0, "p1": 1e-3, "p2": 3e-3}
