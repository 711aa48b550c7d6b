"""Which runs a sweep has, and who gets which."""

import itertools
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from harness.scenario import load as scenarios
from harness.scenario.sweep import Sweep
from harness.sweep.plan import Group, Queue, SweepPlan, groups_of

CLOSED = scenarios.load("closed_loop")
TWO = {"a": {"min": 0.0, "max": 1.0}, "b": {"mean": 0.0, "sigma": 1.0}}


def plan(**said) -> SweepPlan:
    return SweepPlan(CLOSED, Sweep.model_validate(said))


@given(st.integers(0, 500), st.integers(0, 2**32), st.integers(501, 900))
def test_a_run_of_a_monte_carlo_follows_from_seed_and_number_alone(number, seed, runs):
    one = plan(runs=501, seed=seed, vary=TWO).case(number)
    assert one == plan(runs=runs, seed=seed, vary=TWO).case(number)
    assert one != plan(runs=501, seed=seed + 1, vary=TWO).case(number)
    assert 0 <= one.seed < 2**31


def test_runs_differ_in_seed_and_values():
    cases = list(plan(runs=300, vary=TWO).cases())
    assert len({case.seed for case in cases}) == 300
    assert len({case.drawn["a"] for case in cases}) == 300


def test_a_grid_is_the_product_of_everything_listed():
    table = plan(
        method="grid",
        vary={"a": [1, 2, 3], "b": ["x", "y"]},
        seeds=2,
        fault=[{"wire": "s.y", "kind": "stuck", "at": [1.0, 2.0]}],
    )
    cases = list(table.cases())
    assert len(cases) == len(table) == 3 * 2 * 2 * 3
    seen = {(c.drawn["a"], c.drawn["b"], c.seed, c.fault and c.fault.at) for c in cases}
    assert len(seen) == len(cases)
    assert table.axes == ["a", "b", "fault"]


def test_without_seeds_a_grid_has_the_scenarios():
    assert {case.seed for case in plan(vary={"a": [1, 2]}).cases()} == {CLOSED.seed}
    assert {c.seed for c in plan(runs=9, seeds=[4, 5], vary=TWO).cases()} == {4, 5}


@given(st.integers(2, 60), st.integers(0, 100))
def test_a_latin_hypercube_has_one_run_in_each_slice_of_each_variable(runs, seed):
    table = plan(
        method="latin-hypercube", runs=runs, seed=seed, vary={"a": TWO["a"], "c": TWO["a"]}
    )
    for name in "ac":
        slices = sorted(int(case.drawn[name] * runs) for case in table.cases())
        assert slices == list(range(runs))


@given(st.integers(1, 40))
def test_recordings_faults_and_seeds_take_turns_evenly(runs):
    table = plan(
        runs=runs, seeds=[1, 2, 3], fault=[{"wire": "s.y", "kind": "dead"}], vary={"a": TWO["a"]}
    )
    both = [(case.seed, case.fault is None) for case in table.cases()]
    counts = [both.count(each) for each in itertools.product([1, 2, 3], [True, False])]
    assert max(counts) - min(counts) <= 1


def test_runs_are_grouped_by_their_beginnings_and_the_first_to_leave_is_in_front():
    table = plan(
        vary={"a": [1, 2], "part.x.y": {"values": [5, 6], "from": 3.0}},
        fault=[{"wire": "s.y", "kind": "stuck", "at": [1.0, 4.0]}],
    )
    groups = groups_of(table, range(len(table)))
    assert sorted(n for g in groups for n in g.numbers) == list(range(len(table)))
    assert len(groups) == 2
    for group in groups:
        firsts = [table.case(n).first for n in group.numbers]
        assert firsts == sorted(firsts)
        assert len({table.case(n).beginning for n in group.numbers}) == 1
        assert group.key is not None
    assert min(table.case(0).first, math.inf) == 3.0


def test_a_fault_from_the_beginning_is_part_of_it():
    table = plan(fault=[{"wire": "s.y", "kind": "gain", "value": [2.0, 3.0]}])
    assert len({case.beginning for case in table.cases()}) == 3


def test_what_has_nothing_in_common_is_alone():
    table = plan(runs=20, vary=TWO)
    assert all(group.key is None for group in groups_of(table, range(20)))


@given(
    st.lists(st.integers(1, 9), max_size=8), st.lists(st.sampled_from("abc"), min_size=1), st.data()
)
def test_each_run_is_handed_out_once_whoever_asks(sizes, askers, data):
    numbers = itertools.count()
    from collections import deque

    keys = [data.draw(st.sampled_from([None, f"key {k}"])) for k in range(len(sizes))]
    groups = [
        Group(deque(itertools.islice(numbers, n)), key) for n, key in zip(sizes, keys, strict=True)
    ]
    queue = Queue(groups)
    total = sum(sizes)
    taken = []
    for k in range(total):
        given_ = queue.next(askers[k % len(askers)])
        assert given_ is not None
        taken.append(given_[0])
    assert sorted(taken) == list(range(total))
    assert queue.left == 0
    assert queue.next("a") is None


def test_workers_keep_to_their_own_beginnings_while_there_are_enough():
    from collections import deque

    queue = Queue([Group(deque(range(0, 10)), "first"), Group(deque(range(10, 20)), "second")])
    keys = {"a": [], "b": []}
    for _ in range(10):
        for worker, seen in keys.items():
            seen.append(queue.next(worker)[1])
    assert len(set(keys["a"])) == len(set(keys["b"])) == 1
    assert keys["a"][0] != keys["b"][0]


def test_values_are_spread_as_they_are_said_to_be():
    cases = list(plan(runs=2000, vary=TWO).cases())
    b = np.array([case.drawn["b"] for case in cases])
    # Four standard deviations of mean and of standard deviation.
    assert abs(b.mean()) < 4 / np.sqrt(2000)
    assert abs(b.std() - 1.0) < 4 / np.sqrt(4000)
