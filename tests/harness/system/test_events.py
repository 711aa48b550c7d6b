"""Values that change and wires that go wrong in the middle of a run."""

import numpy as np
import pytest

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.common.errors import PartError, ProblemsError
from harness.scenario import load as scenarios
from harness.system.assembly import assemble

CHAIN = """
[part.first]
fmu  = PROBE
u    = 2.0
[part.second]
fmu  = PROBE
gain = 3.0
[[wire]]
from = "first.y"
to   = "second.u"
"""
CLEAN = np.full(1000, 2.0)

each_tick = pytest.mark.usefixtures("tick")


def run(path, tmp_path, **more) -> st.Result:
    return st.run(path, out=tmp_path / "out", report=False, **more)


def faulty(path, tmp_path, **fault) -> np.ndarray:
    """What arrives at the second part."""
    result = run(path, tmp_path, overrides={"fault": [{"wire": "first.y", **fault}]})
    assert np.array_equal(result.signals("first.y"), CLEAN)
    return result.signals("second.y") / 3.0


@each_tick
def test_a_change_acts_on_the_first_tick_at_its_time_or_later(write_scenario, tmp_path):
    more = '[[change]]\nat = 0.3005\nset = { "first.u" = 5.0 }\n'
    more += '[[change]]\nat = 0.6\nset = { "first.u" = 4.0, "first.add" = 7 }\n'
    result = run(write_scenario(CHAIN + more), tmp_path)
    wanted = np.concatenate([np.full(301, 2.0), np.full(299, 5.0), np.full(400, 4.0)])
    assert np.array_equal(result.signals("first.y"), wanted)
    assert np.array_equal(result.signals("second.y"), 3 * wanted)
    count = np.arange(1, 1001) + np.where(np.arange(1000) < 600, 0, 7)
    assert np.array_equal(result.signals("first.count"), count)


@each_tick
def test_a_run_that_stops_for_changes_is_the_same_bit_by_bit(write_scenario, tmp_path):
    text = CHAIN.replace('to   = "second.u"', 'to   = "second.u"\ndelay = 3')
    plain = run(write_scenario(text), tmp_path).table
    stops = [{"at": at, "set": {"first.u": 2.0}} for at in (0.001, 0.5, 0.5005, 0.999)]
    stopped = run(write_scenario(text), tmp_path, overrides={"change": stops}).table
    assert stopped.equals(plain)
    assert len(plain) == 1000


def test_each_kind_of_fault(write_scenario, tmp_path):
    path = write_scenario(CHAIN)
    first, last = slice(None, 500), slice(500, None)
    for fault, wanted in (
        ({"kind": "gain", "value": 2.5}, 5.0),
        ({"kind": "offset", "value": -0.5}, 1.5),
        ({"kind": "dead"}, 0.0),
        ({"kind": "stuck"}, 2.0),
    ):
        arrives = faulty(path, tmp_path, at=0.5, **fault)
        assert np.array_equal(arrives[first], CLEAN[first])
        assert np.allclose(arrives[last], wanted, rtol=1e-15), fault


def test_a_signal_that_is_stuck_stays_and_comes_back(write_scenario, tmp_path):
    change = '[[change]]\nat = 0.4\nset = { "first.u" = 7.0 }\n'
    change += '[[fault]]\nwire = "second.u"\nkind = "stuck"\nat = 0.2\nuntil = 0.6\n'
    arrives = run(write_scenario(CHAIN + change), tmp_path).signals("second.y") / 3.0
    assert np.array_equal(arrives, np.where(np.arange(1000) < 600, 2.0, 7.0))


def test_noise_and_losses_differ_with_the_seed_and_stop_in_time(write_scenario, tmp_path):
    path = write_scenario(CHAIN)
    one = faulty(path, tmp_path, kind="noise", value=0.1, at=0.5, until=0.7)
    noisy = one[500:700] - 2.0
    assert 0.08 < noisy.std() < 0.12
    assert np.array_equal(one[700:], CLEAN[700:])
    fault = [{"wire": "first.y", "kind": "noise", "value": 0.1, "at": 0.5}]
    other = run(path, tmp_path, overrides={"seed": 2, "fault": fault}).signals("second.y") / 3.0
    assert not np.any(other[500:700] == one[500:700])


def test_two_faults_share_a_wire_and_one_may_last_from_the_beginning(write_scenario, tmp_path):
    faults = [
        {"wire": "first.y", "kind": "gain", "value": 2.0},
        {"wire": "first.y", "kind": "offset", "value": 1.0, "at": 0.5},
    ]
    result = run(write_scenario(CHAIN), tmp_path, overrides={"fault": faults})
    arrives = result.signals("second.y") / 3.0
    assert np.allclose(arrives, np.where(np.arange(1000) < 500, 4.0, 5.0), rtol=1e-15)


def test_an_output_is_all_wires_from_it_and_an_input_that_wire_alone(write_scenario, tmp_path):
    third = '[part.third]\nfmu = PROBE\n[[wire]]\nfrom = "first.y"\nto = "third.u"\n'
    path = write_scenario(CHAIN + third)
    for wire, both in (("first.y", True), ("second.u", False)):
        fault = [{"wire": wire, "kind": "dead"}]
        result = run(path, tmp_path, overrides={"fault": fault})
        assert not result.signals("second.y").any()
        assert result.signals("third.y").any() != both


def test_the_wires_delay_stays(write_scenario, tmp_path):
    text = CHAIN.replace('to   = "second.u"', 'to   = "second.u"\ndelay = 5')
    text += '[[change]]\nat = 0.4\nset = { "first.u" = 7.0 }\n'
    plain = run(write_scenario(text), tmp_path).signals("second.y")
    fault = [{"wire": "second.u", "kind": "gain", "value": 2.0}]
    doubled = run(write_scenario(text), tmp_path, overrides={"fault": fault}).signals("second.y")
    assert np.flatnonzero(plain == 21.0)[0] == 405
    assert np.array_equal(doubled, 2 * plain)


def test_all_that_is_wrong_is_told_at_once_with_its_name(write_scenario):
    path = write_scenario(
        CHAIN
        + """
[[change]]
at = 0.5
set = { "first.gain" = 2.0, "frist.u" = 1.0, "second.u" = 1.0, "first.uu" = 1.0, "first.u" = true }
[[fault]]
wire = "first.z"
kind = "dead"
[[fault]]
wire = "first.y"
kind = "offset"
value = 1.0
"""
    )
    with pytest.raises(ProblemsError) as caught:
        assemble(scenarios.load(path))
    told = "\n".join(caught.value.problems)
    assert len(caught.value.problems) == 6
    for text in (
        "'gain' cannot change in a run",
        "'frist.u': write part.variable",
        "'u' is driven by a wire",
        "no variable 'uu'",
        "'u' = True should be of type Real",
        "no wire begins or ends at 'first.z'; did you mean",
    ):
        assert text in told


def test_only_real_signals_go_wrong(write_scenario):
    text = (
        '[part.a]\nfmu = PROBE\n[part.b]\nfmu = PROBE\n[[wire]]\nfrom = "a.count"\nto = "b.add"\n'
    )
    fault = {"fault": [{"wire": "a.count", "kind": "dead"}]}
    with pytest.raises(ProblemsError, match=r"'a\.count' is Integer; only Real signals"):
        assemble(scenarios.load(write_scenario(text), fault))


def test_a_value_out_of_range_is_refused_before_the_run(write_scenario):
    change = {"change": [{"at": 0.5, "set": {"first.u": float("nan")}}]}
    with pytest.raises(ProblemsError, match="finite"):
        assemble(scenarios.load(write_scenario(CHAIN), change))


def test_a_part_that_refuses_a_change_ends_the_run_in_order(write_scenario, tmp_path):
    # The probe's own limit of u, which its description does not tell.
    change = {"change": [{"at": 0.5, "set": {"first.u": 1e3}}]}
    with pytest.raises(PartError, match=r"'first' ended the run at t = 0\.5 s: input 'u' = 1000"):
        run(write_scenario(CHAIN), tmp_path, overrides=change)
    assert len(st.read(tmp_path / "out").time) == 500


def test_an_isolated_part_cannot_stop_in_the_middle(write_scenario):
    text = CHAIN.replace("u    = 2.0", "u    = 2.0\nisolate = true")
    change = {"change": [{"at": 0.5, "set": {"second.add": 1}}]}
    with pytest.raises(ProblemsError, match="'first' cannot stop in the middle of a run"):
        assemble(scenarios.load(write_scenario(text), change))


def test_what_cannot_hold_events_says_so(write_scenario, tmp_path):
    from harness.ssp.export import export
    from harness.system import container as fused

    change = {"change": [{"at": 0.5, "set": {"first.u": 1.0}}]}
    path = write_scenario(CHAIN)
    with pytest.raises(ProblemsError, match="does not hold what happens in a run"):
        export(path, tmp_path / "out.ssp", change)
    with pytest.raises(SteadytipError, match="does not hold what happens in the middle"):
        fused.build(assemble(scenarios.load(path, change)))
