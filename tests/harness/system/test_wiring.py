"""Wires: expansion, checks, run order."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.common.errors import ProblemsError
from harness.parts.ports import Port, Unit
from harness.scenario.load import load
from harness.scenario.schema import Wire
from harness.system.assembly import assemble
from harness.system.wiring import Wiring, connect

METRE = Unit("m", (0, 1, 0, 0, 0, 0, 0, 0))
MILLIMETRE = Unit("mm", (0, 1, 0, 0, 0, 0, 0, 0), 1e-3)
AREA = Unit("m2", (0, 2, 0, 0, 0, 0, 0, 0))


@dataclass
class Ports:
    """A part that has ports and nothing else."""

    name: str
    inputs: Sequence[Port] = field(default_factory=tuple)
    outputs: Sequence[Port] = field(default_factory=tuple)


def part(name: str, inputs: str = "", outputs: str = "", **more) -> Ports:
    ports = [[Port(n, **more) for n in names.split()] for names in (inputs, outputs)]
    return Ports(name, *ports)


def wired(*parts: Ports, wires: Sequence[Wire]) -> Wiring:
    return connect("case", {p.name: p for p in parts}, wires)


def problems(*parts: Ports, wires: Sequence[Wire]) -> tuple[str, ...]:
    with pytest.raises(ProblemsError) as caught:
        wired(*parts, wires=wires)
    return caught.value.problems


def test_a_star_stands_for_every_suffix_that_both_sides_have():
    wiring = wired(
        part("a", outputs="tip_x tip_y tip_z tipped other"),
        part("b", inputs="tip_x tip_y tip_z tip_w"),
        wires=[Wire("a.tip_*", "b.tip_*", 2)],
    )
    assert [(str(w.source), str(w.target), w.delay) for w in wiring.links] == [
        (f"a.tip_{axis}", f"b.tip_{axis}", 2) for axis in "xyz"
    ]
    assert wiring.unconnected == ("b.tip_w",)


def test_a_star_that_stands_for_nothing_is_refused_with_what_there_is():
    a, b = part("a", outputs="x y"), part("b", inputs="u v")
    (text,) = problems(a, b, wires=[Wire("a.tip_*", "b.tip_*")])
    assert "nothing matches an output; a gives x, y; b takes u, v" in text
    (text,) = problems(a, b, wires=[Wire("a.*", "b.*")])
    assert "nothing matches an input" in text
    (text,) = problems(a, b, wires=[Wire("a.*", "b.u")])
    assert "one '*' on both sides" in text


def test_unknown_parts_and_ports_and_wrong_directions_are_all_named():
    found = problems(
        part("sensor", inputs="force", outputs="volts"),
        part("filter", inputs="volts", outputs="angle"),
        wires=[
            Wire("senser.volts", "filter.volts"),
            Wire("sensor.volt", "filter.volts"),
            Wire("sensor.force", "filter.volts"),
            Wire("sensor.volts", "filter.angle"),
        ],
    )
    assert [text.partition(": ")[2] for text in found] == [
        "there is no part 'senser'; did you mean 'sensor'?",
        "'sensor' has no output 'volt'; did you mean 'volts'?",
        "'sensor.force' is an input, not an output",
        "'filter.angle' is an output, not an input",
    ]


def test_an_input_driven_twice_is_refused_with_both_wires():
    a = part("a", outputs="x y")
    (text,) = problems(a, part("b", inputs="u"), wires=[Wire("a.x", "b.u"), Wire("a.y", "b.u")])
    assert "input 'b.u' is driven twice: by wire 'a.x' -> 'b.u' and by wire 'a.y' -> 'b.u'" in text


def test_units_that_differ_are_refused_and_both_are_shown():
    a = Ports("a", outputs=[Port("x", unit=METRE), Port("y", unit=MILLIMETRE)])
    b = Ports("b", inputs=[Port("x", unit=AREA), Port("y", unit=METRE)])
    found = problems(a, b, wires=[Wire("a.x", "b.x"), Wire("a.y", "b.y")])
    assert found[0].startswith("wire 'a.x -> b.x': units differ (m, m2).")
    assert found[1].startswith("wire 'a.y -> b.y': units differ (mm, m).")


def test_units_are_compared_by_what_they_are_made_of_not_by_name():
    a = Ports("a", outputs=[Port("x", unit=Unit("metre", METRE.exponents))])
    b = Ports("b", inputs=[Port("x", unit=METRE)])
    assert wired(a, b, wires=[Wire("a.x", "b.x")]).notes == ()


def test_an_fmu_without_any_units_is_allowed_and_noted():
    a = Ports("a", outputs=[Port("x", unit=None)])
    b = Ports("b", inputs=[Port("x", unit=METRE)])
    (note,) = wired(a, b, wires=[Wire("a.x", "b.x")]).notes
    assert note == "units of 'a' are not checked: its FMU declares none"


def test_types_that_differ_are_refused():
    a, b = part("a", outputs="x", type="Boolean"), part("b", inputs="x")
    (text,) = problems(a, b, wires=[Wire("a.x", "b.x")])
    assert "types differ (Boolean, Real)" in text


def test_a_loop_without_delay_is_refused_by_name_with_the_cure():
    parts = [
        Ports(n, [Port("u")], [Port("y", depends_on=frozenset() if n == "plant" else None)])
        for n in ("plant", "sensor", "controller")
    ]
    wires = [
        Wire("plant.y", "sensor.u"),
        Wire("sensor.y", "controller.u"),
        Wire("controller.y", "plant.u"),
    ]
    (text,) = problems(*parts, wires=wires)
    assert "loop without delay" in text
    for wire in ("plant.y -> sensor.u", "sensor.y -> controller.u", "controller.y -> plant.u"):
        assert wire in text
    assert "Declare 'delay = 1' on one of these wires." in text
    assert "the wire from 'controller' to 'plant' is a natural place" in text
    wiring = wired(*parts, wires=[*wires[:2], Wire("controller.y", "plant.u", 1)])
    assert wiring.order == ("plant", "sensor", "controller")


def test_a_part_wired_to_itself_needs_a_delay():
    (text,) = problems(part("a", inputs="u", outputs="y"), wires=[Wire("a.y", "a.u")])
    assert "a.y -> a.u" in text


@given(st.data())
def test_sources_run_first_and_ties_keep_the_scenarios_order(data):
    names = [f"p{i}" for i in range(data.draw(st.integers(2, 7)))]
    hidden = data.draw(st.permutations(names))
    pairs = st.tuples(st.sampled_from(range(len(names))), st.sampled_from(range(len(names))))
    edges = {
        (hidden[min(i, j)], hidden[max(i, j)])
        for i, j in data.draw(st.lists(pairs, max_size=12))
        if i != j
    }
    parts = [part(n, " ".join(f"u_{m}" for m in names), "y") for n in names]
    wiring = wired(*parts, wires=[Wire(f"{a}.y", f"{b}.u_{a}") for a, b in sorted(edges)])
    at = {name: index for index, name in enumerate(wiring.order)}
    assert sorted(at) == sorted(names)
    assert all(at[a] < at[b] for a, b in edges)
    # Nothing could have run earlier: each part comes right after the last one that it waits for,
    # but for parts that the scenario names before it.
    for name, index in at.items():
        waited = max((at[a] for a, b in edges if b == name), default=-1)
        assert all(other < name for other in wiring.order[waited + 1 : index])


def test_the_shipped_loop_of_real_fmus_runs_in_wire_order():
    system = assemble(load("closed_loop"))
    assert system.wiring.order == (
        "hand",
        "piezo_1",
        "piezo_2",
        "piezo_3",
        "instrument",
        "sensors",
        "estimator",
        "controller",
    )
    left = [name for name in system.wiring.unconnected if not name.startswith("hand.recorded")]
    # No room, no thermometer, no lost samples; nobody holds, no filter is outside.
    outside = [f"controller.external_tremor_{axis}" for axis in "xyz"]
    room = ["sensors.ambient", "estimator.temperature"]
    assert left == [*room, *outside, "controller.hold"]
    assert system.wiring.notes == ()
