"""What cannot work in a scenario is said before anything runs."""

import os

import pytest

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.scenario.load import load
from harness.system.assembly import assemble

HEAD = "seconds = 3.0\nstep_size = 1e-3\n"
PART = '[part.a]\nfmu = "Hand"\n'


def _write(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "case.toml"
    path.write_text(text, encoding=encoding)
    return path


def test_a_byte_order_mark_is_read(tmp_path):
    assert load(_write(tmp_path, HEAD + PART, "utf-8-sig")).seconds == 3.0


@pytest.mark.parametrize("text", [r"C:\Users\me\hand.csv", r"data\hand.csv"])
def test_a_backslash_in_double_quotes_says_how_to_write_the_path(tmp_path, text):
    path = _write(tmp_path, f'{HEAD}{PART}motion = "{text}"\n')
    with pytest.raises(SteadytipError) as caught:
        load(path)
    assert "line 5" in str(caught.value)
    assert f"single quotes, '{text}'" in str(caught.value)
    assert text.replace("\\", "/") in str(caught.value)


def test_an_escape_that_toml_knows_is_found_in_the_path(tmp_path):
    path = _write(tmp_path, HEAD + PART + 'motion = "recordings\\tremor.csv"\n')
    with pytest.raises(SteadytipError, match=r"control character.*single quotes"):
        load(path)


@pytest.mark.skipif(os.sep != "/", reason="a backslash separates folders here")
def test_backslashes_in_single_quotes_are_slashes_elsewhere(tmp_path):
    scenario = load(_write(tmp_path, HEAD + PART + "motion = 'recordings\\hand.csv'\n"))
    assert scenario.parts["a"].motion == tmp_path / "recordings" / "hand.csv"


def test_a_run_without_a_step_is_refused(tmp_path):
    with pytest.raises(ProblemsError, match=r"'seconds' = 0\.0001 holds no step of 0\.001 s"):
        load(_write(tmp_path, "seconds = 0.0001\nstep_size = 1e-3\n" + PART))


@pytest.mark.parametrize(
    "text",
    [
        '[[change]]\nat = 50.0\nset = { "a.seed" = 1.0 }\n',
        '[[fault]]\nwire = "a.tip_x"\nkind = "stuck"\nat = 50.0\n',
    ],
)
def test_what_never_happens_is_refused(tmp_path, text):
    with pytest.raises(ProblemsError, match="at 50 s never happens: the run ends at 3 s"):
        load(_write(tmp_path, HEAD + PART + text))


@pytest.mark.parametrize("step", [0.3e-3, 1.5e-3])
def test_a_step_that_is_no_multiple_of_the_sample_period_is_said(tmp_path, step):
    scenario = load(_write(tmp_path, f"seconds = 3.0\nstep_size = {step}\n" + PART))
    (note,) = (n for n in assemble(scenario).notes if "multiple" in n)
    assert "sample period of a, 0.001 s" in note


@pytest.mark.parametrize("step", [1e-3, 2e-3, 5e-3])
def test_a_multiple_of_the_sample_period_is_well(tmp_path, step):
    scenario = load(_write(tmp_path, f"seconds = 3.0\nstep_size = {step}\n" + PART))
    assert not [note for note in assemble(scenario).notes if "multiple" in note]


def test_a_part_that_nothing_is_wired_to_is_said(tmp_path):
    other = '[part.b]\nfmu = "Hand"\n[signals]\ntip_uncompensated = "a.tip_*"\n'
    notes = assemble(load(_write(tmp_path, HEAD + PART + other))).notes
    assert [note for note in notes if "part 'b' is wired to nothing" in note]
    assert not [note for note in notes if "part 'a' is wired" in note]
