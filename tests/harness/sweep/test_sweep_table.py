"""What a scenario may say of a sweep, and what is told when it is wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from harness.common.errors import ProblemsError
from harness.scenario import load as scenarios
from harness.scenario.sweep import Sweep, SweepVariable

inside = st.floats(min_value=1e-9, max_value=1.0 - 1e-9)


@given(inside, st.floats(1e-6, 1.0), st.floats(1.001, 1e3), st.sampled_from(["linear", "log"]))
def test_a_range_stays_in_its_range_and_rises(u, low, ratio, scale):
    variable = SweepVariable(min=low, max=low * ratio, scale=scale)
    value = variable.at(u)
    assert low <= value <= low * ratio
    assert variable.at(u / 2) <= value
    middle = variable.at(0.5)
    wanted = np.sqrt(low * low * ratio) if scale == "log" else (low + low * ratio) / 2
    assert middle == pytest.approx(wanted)


@given(inside)
def test_a_normal_variable_is_cut_off_where_it_says(u):
    variable = SweepVariable(mean=1.0, sigma=0.5, min=0.9, max=1.3)
    assert 0.9 <= variable.at(u) <= 1.3
    far = SweepVariable(mean=0.0, sigma=1.0, min=6.0, max=9.0)
    assert far.at(u) == pytest.approx(stats.truncnorm(6.0, 9.0).ppf(u), rel=1e-6)
    free = SweepVariable(mean=1.0, sigma=0.5)
    assert free.at(u) == pytest.approx(stats.norm(1.0, 0.5).ppf(u), rel=1e-6, abs=1e-6)


@given(inside)
def test_a_distribution_is_that_of_scipy(u):
    variable = SweepVariable.model_validate({"distribution": "gamma", "a": 2.0, "scale": 3.0})
    assert variable.at(u) == pytest.approx(stats.gamma(2.0, scale=3.0).ppf(u))


@given(inside, st.integers(1, 7))
def test_every_listed_value_is_equally_likely(u, count):
    variable = SweepVariable(values=list(range(count)))
    assert variable.at(u) == int(u * count)


def test_points_of_a_grid_are_even_and_have_both_ends():
    assert SweepVariable(min=1.0, max=2.0, points=3).listed() == [1.0, 1.5, 2.0]
    assert SweepVariable(min=1e-3, max=0.1, points=3, scale="log").listed() == [
        1e-3,
        pytest.approx(1e-2),
        0.1,
    ]
    assert SweepVariable(min=1, max=4, points=4, integer=True).listed() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"min": 1.0}, "'min' and 'max' go together"),
        ({"min": 2.0, "max": 1.0}, "not below"),
        ({"min": 0.0, "max": 1.0, "scale": "log"}, "positive"),
        ({"mean": 1.0}, "needs a 'sigma'"),
        ({"mean": 1.0, "sigma": -1.0}, "greater than 0"),
        ({"values": [1], "sigma": 1.0}, "does not go with 'values'"),
        ({"sgima": 1.0, "mean": 0.0}, "did you mean 'sigma'?"),
        ({"distribution": "nrom"}, "did you mean 'norm'?"),
        ({"distribution": "gamma"}, "'a'"),
        ({"distribution": "uniform", "scale": "log"}, "scale"),
        ({"values": []}, "at least 1"),
        ({}, "say 'values'"),
    ],
)
def test_each_mistake_is_told_with_the_variable(said, told):
    problems = Sweep(runs=3, vary={"part.x.y": said}).problems()
    assert len(problems) >= 1
    assert all("'part.x.y'" in problem for problem in problems)
    assert any(told in problem for problem in problems), problems


def test_a_grid_wants_points_and_no_runs():
    table = Sweep(method="grid", runs=3, vary={"a": {"mean": 0.0, "sigma": 1.0}})
    assert len(table.problems()) == 2
    assert Sweep(vary={"a": [1, 2]}).design == "grid"
    assert Sweep(runs=3, vary={"a": [1, 2]}).design == "monte-carlo"


def test_all_problems_of_the_table_come_at_once(small):
    path = small(
        """
[sweep]
runs  = 0
metod = "grid"
[sweep.vary]
"part.sensor.noise" = { min = 1.0 }
[[sweep.fault]]
wire = "sensor.measured"
knid = "stuck"
"""
    )
    with pytest.raises(ProblemsError) as caught:
        scenarios.load(path)
    text = str(caught.value)
    for told in ("sweep.runs", "did you mean 'method'?", "did you mean 'kind'?"):
        assert told in text


def test_a_variable_may_be_written_as_nested_tables_and_replaced_as_a_whole(small):
    path = small(
        "[sweep]\nruns = 2\n[sweep.vary.part.sensor]\nnoise = { min = 1e-7, max = 1e-6 }\n"
    )
    assert scenarios.load(path).sweep.variables.keys() == {"part.sensor.noise"}
    text = "[sweep]\nruns = 2\n[sweep.vary]\n'part.sensor.noise' = { min = 1e-7, max = 1e-6 }\n"
    other = {"sweep.vary": {"part.sensor.noise": {"mean": 1e-6, "sigma": 1e-7}}}
    variable = scenarios.load(small(text), other).sweep.variables["part.sensor.noise"]
    assert (variable.form, variable.min) == ("mean", None)


def test_faults_are_every_combination_and_need_what_their_kind_needs():
    table = Sweep.model_validate(
        {"fault": [{"wire": "a.b", "kind": "offset", "value": [1, 2], "at": [3.0, 4.0]}]}
    )
    assert [(f.value, f.at) for f in table.faults] == [(1, 3), (1, 4), (2, 3), (2, 4)]
    for wrong in (
        {"wire": "a.b", "kind": "offset"},
        {"wire": "a.b", "kind": "stuck", "value": 1.0},
        {"wire": "a.b", "kind": "broken"},
        {"wire": "a.b", "kind": "stuck", "at": 2.0, "until": 1.0},
    ):
        assert len(Sweep.model_validate({"fault": [wrong]}).problems()) == 1
