"""Scenario files: merging, overrides, and what is said about mistakes."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.scenario.load import available, load
from harness.system.assembly import assemble, part_seed
from tests.harness.conftest import WriteScenario

HEAD = "seconds = 2.0\nstep_size = 1e-3\n"


def write(folder: Path, text: str, name: str = "case.toml") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def problems(path: Path, **overrides) -> tuple[str, ...]:
    with pytest.raises(ProblemsError) as caught:
        load(path, overrides)
    assert caught.value.where == path.name
    return caught.value.problems


def test_every_shipped_scenario_loads_by_its_bare_name():
    assert "closed_loop" in available()
    for name in available():
        assert load(name).name == name


def test_the_closed_loop_is_wired_with_one_sample_from_command_to_stacks():
    delays = {wire.target: wire.delay for wire in load("closed_loop").wires}
    assert {t for t, delay in delays.items() if delay} == {f"piezo_{i}.volts" for i in (1, 2, 3)}
    assert all(delays[f"piezo_{i}.volts"] == 1 for i in (1, 2, 3))


def test_nothing_sees_the_truth_but_the_plant():
    """Estimator and controller hear of the world through the sensors alone."""
    hears: dict[str, set[str]] = {}
    for wire in load("closed_loop").wires:
        hears.setdefault(wire.target.split(".")[0], set()).add(wire.source.split(".")[0])
    assert hears["estimator"] == {"sensors"}
    assert hears["controller"] == {"estimator"}
    assert hears["piezo_1"] == hears["piezo_2"] == hears["piezo_3"] == {"controller"}


def test_an_unknown_scenario_is_answered_with_the_nearest():
    with pytest.raises(SteadytipError, match=r"'closed_lop'; did you mean 'closed_loop'\?"):
        load("closed_lop")


def test_all_mistakes_are_shown_at_once_with_the_nearest_known_key(tmp_path):
    text = """
secnods = 3.0
seconds = -1.0
step = "1 ms"
[part.a]
fum = "x.fmu"
[part.b]
fmu = "x.fmu"
replay = "y.csv"
[[wire]]
from = "a.x"
too = "b.x"
delay = 1.5
[signals]
tipp = "a.x"
"""
    found = problems(write(tmp_path, text))
    wanted = [
        "part 'a' does not say what it is: add one of",
        "'fum': did you mean 'fmu'?",
        "part 'b' is several things at once (fmu, replay): keep one",
        "unknown key 'secnods'; did you mean 'seconds'?",
        "'seconds' = -1.0: input should be greater than 0",
        "'step_size' = '1 ms': input should be a valid number",
        "unknown key 'wire.0.too'; did you mean 'to'?",
        "'wire.0.to' is missing",
        "'wire.0.delay' = 1.5: input should be a valid integer",
        "unknown key 'signals.tipp'; did you mean 'tip'?",
    ]
    for text in wanted:
        assert any(text in problem for problem in found), text
    assert len(found) == len(wanted) - 1  # the first two stand in one sentence


@pytest.mark.parametrize("value", ["nan", "inf", "-1.0", "0.0", "true"])
def test_seconds_must_be_a_positive_finite_number(value, tmp_path):
    path = write(tmp_path, f'seconds = {value}\nstep_size = 1e-3\n[part.a]\nfmu = "a.fmu"\n')
    assert problems(path)[0].startswith("'seconds' = ")


def test_a_settle_that_leaves_nothing_is_said_before_the_run(write_scenario):
    system = assemble(load(write_scenario("warm_up = 0.5\n[part.a]\nfmu = PROBE\n")))
    text = "no figures of merit: 'warm_up' = 0.5 s leaves less than 1 s of 1 s"
    assert system.notes == (text,)


def test_what_is_not_toml_is_named_with_its_line(tmp_path):
    with pytest.raises(SteadytipError, match=r"case\.toml is not TOML: .*line 2"):
        load(write(tmp_path, "seconds = 1.0\nstep = \n"))


def test_extending_merges_parts_by_key_and_appends_wires(tmp_path):
    base = (
        HEAD
        + """
[part.a]
fmu = "lib/a.fmu"
gain = 1.0
phase = 2.0
[part.b]
fmu = "Named"
[[wire]]
from = "a.x"
to = "b.x"
"""
    )
    write(tmp_path, base, "base/base.toml")
    above = """
extends = "base/base.toml"
seconds = 5.0
[part.a]
gain = 3.0
parameters = "set.ssv"
[[wire]]
from = "b.y"
to = "a.y"
delay = 1
"""
    scenario = load(write(tmp_path, above))
    assert (scenario.seconds, scenario.step_size) == (5.0, 1e-3)
    a = scenario.parts["a"].settings.table
    assert (a["gain"], a["phase"]) == (3.0, 2.0)
    # Paths belong to the file that they stand in; a bare word is no path.
    assert Path(a["fmu"]) == tmp_path / "base/lib/a.fmu"
    assert Path(a["parameters"]) == tmp_path / "set.ssv"
    assert scenario.parts["b"].settings.fmu == "Named"
    assert [(wire.source, wire.delay) for wire in scenario.wires] == [("a.x", 0), ("b.y", 1)]
    assert [name for name, _ in scenario.texts] == ["base.toml", "case.toml"]


def test_a_part_that_becomes_another_kind_keeps_nothing_of_the_old_one(tmp_path):
    write(tmp_path, HEAD + '[part.a]\nfmu = "a.fmu"\ngain = 1.0\n', "base.toml")
    scenario = load(write(tmp_path, 'extends = "base.toml"\n[part.a]\nreplay = "r.csv"\n'))
    assert scenario.parts["a"].kind == "replay"
    assert set(scenario.parts["a"].settings.table) == {"replay"}


def test_extending_in_a_circle_is_refused_with_the_circle(tmp_path):
    write(tmp_path, 'extends = "b.toml"\n', "a.toml")
    path = write(tmp_path, 'extends = "a.toml"\n', "b.toml")
    with pytest.raises(SteadytipError, match=r"b\.toml -> a\.toml -> b\.toml"):
        load(path)


def test_overrides_win_and_reach_into_parts(tmp_path):
    path = write(tmp_path, HEAD + '[part.a]\nfmu = "a.fmu"\n[part.a.filter]\ngain = 1.0\n')
    scenario = load(path, {"seconds": 9, "part.a.filter.gain": 2.0, "part.a.step_limit": 0.5})
    assert scenario.seconds == 9.0
    assert scenario.parts["a"].settings.table["filter"] == {"gain": 2.0}
    assert scenario.parts["a"].step_limit == 0.5


def test_start_values_are_checked_against_the_fmu_all_at_once(write_scenario: WriteScenario):
    path = write_scenario("""
[part.a]
fmu = PROBE
gian = 1.0
gain = 11.0
mode = 1.5
y = 3.0
at = nan
w = [1.0, 2.0]
[part.b]
fmu = PROBE
gain = "large"
""")
    with pytest.raises(ProblemsError) as caught:
        assemble(load(path))
    wanted = [
        "the FMU has no variable 'gian'; did you mean 'gain'?",
        "'gain' = 11 should be in [-10, 10]",
        "'mode' = 1.5 should be of type Integer",
        "'y' cannot be set: its causality is output",
        "'at' = nan should be a finite number in s",
        "'w' has 3 elements, the scenario gives 2",
        "part 'b' (probe.fmu): 'gain' = 'large' should be of type Real",
    ]
    for text in wanted:
        assert any(text in problem for problem in caught.value.problems), text
    assert len(caught.value.problems) == len(wanted)


SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    version="1.0" name="set"><ssv:Parameters>
  <ssv:Parameter name="gain"><ssv:Real value="2.5"/></ssv:Parameter>
  <ssv:Parameter name="at"><ssv:Real value="0.25" unit="UNIT"/></ssv:Parameter>
  <ssv:Parameter name="mode"><ssv:Integer value="0"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet>
"""


def test_a_parameter_set_gives_start_values_and_keys_win_over_it(write_scenario, tmp_path):
    (tmp_path / "set.ssv").write_text(SSV.replace("UNIT", "s"))
    path = write_scenario('[part.a]\nfmu = PROBE\nparameters = "set.ssv"\nat = 0.75\n')
    values = assemble(load(path)).parts["a"].metadata()["start_values"]
    assert (values["gain"], values["at"], values["mode"]) == (2.5, 0.75, 0)


def test_a_parameter_in_another_unit_is_refused(write_scenario, tmp_path):
    (tmp_path / "set.ssv").write_text(SSV.replace("UNIT", "ms"))
    path = write_scenario('[part.a]\nfmu = PROBE\nparameters = "set.ssv"\n')
    with pytest.raises(ProblemsError, match=r"'at' in set\.ssv is in ms, .* in s: give it in s"):
        assemble(load(path))


@pytest.mark.parametrize("text", ["", "<a/>", SSV.replace('"2.5"', '"much"')])
def test_what_is_no_parameter_set_is_refused(text, write_scenario, tmp_path):
    (tmp_path / "set.ssv").write_text(text)
    path = write_scenario('[part.a]\nfmu = PROBE\nparameters = "set.ssv"\n')
    with pytest.raises(ProblemsError, match=r"set\.ssv"):
        assemble(load(path))


@given(st.integers(0, 2**63), st.text(min_size=1, max_size=20))
def test_a_parts_seed_follows_from_seed_and_name_alone(seed, name):
    assert part_seed(seed, name) == part_seed(seed, name)
    assert 0 <= part_seed(seed, name) < 2**32
    assert part_seed(seed, name) != part_seed(seed + 1, name)
    assert part_seed(seed, name) != part_seed(seed, name + "'")


VARIED = (
    HEAD
    + """
[part.a]
fmu = "a.fmu"
gain = 1.0
[part.b]
fmu = "b.fmu"
[[wire]]
from = "a.y"
to   = "b.u"
[variant.loud.part.a]
gain = 9.0
[[variant.crossed.wire]]
from = "a.z"
to   = "b.u"
"""
)


def test_a_variant_changes_what_it_names_and_nothing_else(tmp_path):
    path = write(tmp_path, VARIED)
    plain, loud, crossed = (load(path, None, name) for name in (None, "loud", "crossed"))
    assert plain.variants == loud.variants == ("loud", "crossed")
    assert (plain.variant, loud.variant) == (None, "loud")
    assert [s.parts["a"].settings.table["gain"] for s in (plain, loud, crossed)] == [1.0, 9.0, 1.0]
    assert [wire.source for wire in loud.wires] == ["a.y"]
    assert [wire.source for wire in crossed.wires] == ["a.z"]
    assert load(path, {"part.a.gain": 3.0}, "loud").parts["a"].settings.table["gain"] == 3.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (VARIED, r"case.toml has no variant 'lowd'; did you mean 'loud'\?"),
        (HEAD, "case.toml has no variant 'lowd'; it has none"),
        (HEAD + "variant = 3\n", r"'variant' holds tables, as in \[variant.NAME.part.hand\]"),
        ("extends = 3\n", "'extends' names scenarios, not"),
    ],
)
def test_mistakes_about_variants_are_named(text, message, tmp_path):
    with pytest.raises(SteadytipError, match=message):
        load(write(tmp_path, text), None, "lowd")


def test_several_scenarios_are_laid_over_each_other(tmp_path):
    """The later one wins; what both extend counts once."""
    write(tmp_path, VARIED, "base.toml")
    write(tmp_path, 'extends = "base.toml"\n[part.a]\ngain = 2.0\n', "one.toml")
    write(tmp_path, 'extends = "base.toml"\n[part.a]\nseed = 5\n', "other.toml")
    both = load(write(tmp_path, 'extends = ["one.toml", "other.toml"]\ntitle = "both"\n'))
    assert both.parts["a"].settings.table["seed"] == 5
    assert len(both.wires) == 1
    assert [name for name, _ in both.texts] == ["base.toml", "one.toml", "other.toml", "case.toml"]


@pytest.mark.parametrize("name", ["tremor_bench", "tremor_bench_a04_noise"])
def test_every_variant_of_the_bench_is_wired_and_senses_as_the_loop_does(name):
    variants = load(name).variants
    assert {"inertial-forecaster", "thesis-as-printed", "position-known"} <= set(variants)
    noisy = "a04" in name
    for variant in variants:
        scenario = load(name, None, variant)
        ends = [wire.target for wire in scenario.wires]
        assert len(ends) == len(set(ends))
        assert ("accelerometer_noise" in scenario.parts["sensors"].settings.table) == noisy
        hears = {wire.source.split(".")[0] for wire in scenario.wires if "filter." in wire.target}
        assert ("instrument" in hears) == (variant == "position-known")


def test_matrices_are_given_row_by_row(write_scenario) -> None:
    """Of a tracker's four markers; with a row too few, with one too short, of what is none."""
    rows = "[[1e-2, 0, 0], [0, 2e-2, 0], [0, 0, 3e-2], [0, 0, 0]]"
    part = "[part.a]\nfmu = 'OpticalTracker'\n"
    system = assemble(load(write_scenario(f"{part}markers = {rows}\n")))
    values = system.parts["a"].start_values
    assert [values[f"markers[{i},{i}]"] for i in (1, 2, 3)] == [1e-2, 2e-2, 3e-2]
    for key, matrix, text in (
        ("markers", "[[1, 2, 3]]", "'markers' has 4 rows of 3, the scenario gives rows of 3"),
        ("markers", "[[0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]", "gives rows of 2, 3, 3, 3"),
        ("marker", rows, "the FMU has no matrix 'marker'; did you mean 'markers'?"),
    ):
        with pytest.raises(ProblemsError, match=re.escape(text)):
            assemble(load(write_scenario(f"{part}{key} = {matrix}\n")))
