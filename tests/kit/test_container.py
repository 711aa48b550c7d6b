"""A container computes what its members and their wires compute one by one."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.container import Member, MemberLink, contain
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, integer, real
from fmu_src.kit.runner import Runner

TICK = 1e-3


class P(Parameters):
    gain = real(None, "of the input", start=0.7)
    seed = integer("of the noise", start=1, min=0, max=1000)


class U(Inputs):
    a = real("m", "summed up", start=0.25)
    b = real("m", "added to the output", start=-0.5)


class X(State):
    sum = real("m", "of inputs")


class Y(Outputs):
    out = real("m", "sum, input and noise")
    late = real("m", "sum before this sample")


def step(p, u, x, T, normal):
    moved = 0.9 * x.sum + p.gain * u.a
    return X(sum=moved), Y(out=moved + u.b + 0.1 * normal[0], late=x.sum)


SLOW = Model("Slow", step, P, U, X, Y, TICK, draws=1)
QUICK = Model("Quick", step, P, U, X, Y, TICK / 4, draws=1)


def one_by_one(members, links, ticks):
    """Every output of every tick, (ticks + 1, members, 2); row 0 is what initialisation shows."""
    connected = {link.target: link for link in links}
    runners = {m.name: Runner(m.model, dict(m.starts)) for m in members}
    first = {m.name: Runner(m.model, dict(m.starts)) for m in members}
    starts = {"a": 0.25, "b": -0.5}
    now: dict[tuple[str, str], float] = {}
    for m in members:
        taken = dict(starts)
        for name in starts:
            link = connected.get((m.name, name))
            if link is not None and not link.delay:
                taken[name] = now[link.source]
        found = first[m.name].run(1, taken)
        now |= {(m.name, name): float(value[0]) for name, value in found.items()}
    rows = [dict(now)]
    for _ in range(ticks):
        now = {}
        for m in members:
            taken = dict(starts)
            for name in starts:
                link = connected.get((m.name, name))
                if link is not None:
                    row = now if not link.delay else rows[max(0, len(rows) - link.delay)]
                    taken[name] = row[link.source]
            samples = round(TICK / m.model.sample_period)
            found = runners[m.name].run(samples, taken)
            now |= {(m.name, name): float(value[-1]) for name, value in found.items()}
        rows.append(now)
    return rows


@st.composite
def wirings(draw):
    """Two to four members of either rate, wired at random."""
    models = draw(st.lists(st.sampled_from([SLOW, QUICK]), min_size=2, max_size=4))
    members = [
        Member(f"m{i}", model, {"seed": float(i + 1), "gain": 0.2 * (i + 1)})
        for i, model in enumerate(models)
    ]
    links = []
    for i, member in enumerate(members):
        for target in ("a", "b"):
            if draw(st.booleans()):
                source = draw(st.integers(0, len(members) - 1))
                least = 0 if source < i else 1
                output = draw(st.sampled_from(["out", "late"]))
                delay = draw(st.integers(least, 3))
                links.append(MemberLink((f"m{source}", output), (member.name, target), delay))
    return members, links


@settings(max_examples=30)
@given(wirings())
def test_ticks_are_those_of_the_members_one_by_one(wiring) -> None:
    members, links = wiring
    container = contain("Whole", members, links, TICK)
    runner = Runner(container)
    found = runner.run(6)
    expected = one_by_one(members, links, 6)
    names = [scalar.name for scalar in container.outputs.scalars()]
    assert names == [f"{m.name}_{out}" for m in members for out in ("out", "late")]
    for k, name in enumerate(names):
        member, _, out = name.partition("_")
        assert runner.initial[k] == pytest.approx(expected[0][member, out], abs=1e-14)
        got = found[f"{member}.{out}"]
        wanted = [row[member, out] for row in expected[1:]]
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-13, err_msg=name)


def test_what_nothing_drives_is_an_input_under_both_names() -> None:
    members = [Member("one", SLOW, {}), Member("two", SLOW, {})]
    container = contain("Pair", members, [MemberLink(("one", "out"), ("two", "a"))], TICK)
    groups = {k: [s.name for s in v] for k, v in container.variables.items()}
    assert groups["input"] == ["one_a", "one_b", "two_b"]
    assert groups["parameter"] == ["one.gain", "one.seed", "two.gain", "two.seed"]
    assert [s.start for s in container.variables["input"]] == [0.25, -0.5, -0.5]


def test_an_output_keeps_to_the_limits_of_what_it_drives() -> None:
    class Narrow(Inputs):
        a = real("m", "between", min=-1.0, max=2.0)

    target = Model("Narrow", lambda p, u, x, T: (State(), Y(out=u.a, late=0)), Parameters, Narrow,
                   State, Y, TICK)  # fmt: skip
    members = [Member("one", SLOW, {}), Member("two", target, {})]
    container = contain("Pair", members, [MemberLink(("one", "out"), ("two", "a"))], TICK)
    limits = {s.name: (s.field.min, s.field.max) for s in container.variables["output"]}
    assert limits["one_out"] == (-1.0, 2.0)
    assert limits["one_late"] == (-np.inf, np.inf)


def test_dependencies_go_through_wires_of_the_same_tick_only() -> None:
    members = [Member("one", SLOW, {}), Member("two", SLOW, {}), Member("three", SLOW, {})]
    links = [
        MemberLink(("one", "out"), ("two", "a")),
        MemberLink(("two", "out"), ("three", "b"), 1),
    ]
    container = contain("Chain", members, links, TICK)
    sparsity = np.array(ca.DM(container.step_function.jac_sparsity(1, 2), 1).full(), dtype=bool)
    inputs = [s.name for s in container.variables["input"]]
    outputs = [s.name for s in container.variables["output"]]
    depends = {
        name: {inputs[j] for j in np.flatnonzero(sparsity[i])} for i, name in enumerate(outputs)
    }
    assert depends["two_out"] == {"one_a", "one_b", "two_b"}
    assert depends["three_out"] == {"three_a"}


@pytest.mark.parametrize(
    ("members", "links", "tick", "words"),
    [
        ([("1st", SLOW)], [], TICK, "container Whole: '1st' must be a C identifier"),
        ([("wires", SLOW)], [], TICK, "'wires' must be a C identifier other than 'wires'"),
        ([("one", SLOW)], [], 1.5e-3, "must be a whole multiple of the sample period of 'one'"),
        ([("one", SLOW)], [], 2.5e-4, "sample period of 'one' .Slow., 0.001 s"),
        (
            [("one", SLOW), ("two", SLOW)],
            [MemberLink(("two", "out"), ("one", "a"))],
            TICK,
            "'one.a' needs 'two.out' of the same tick, which is computed after it",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_contained_is_refused(members, links, tick, words) -> None:
    with pytest.raises(SteadytipError, match=words):
        contain("Whole", [Member(n, m, {}) for n, m in members], links, tick)


def test_two_ports_that_would_have_one_name_are_refused() -> None:
    class Other(Outputs):
        b_out = real("m", "clashes with the output out of a_b")

    other = Model("Other", lambda p, u, x, T: (State(), Other(b_out=0)), Parameters, Inputs, State,
                  Other, TICK)  # fmt: skip
    with pytest.raises(SteadytipError, match="two variables would be called 'a_b_out'; rename"):
        contain("Whole", [Member("a", other, {}), Member("a_b", SLOW, {})], [], TICK)
