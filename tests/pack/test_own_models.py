"""Models of a user's own: files outside the project, and objects; known by their content."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import steadytip as st
from fmu_src.pack.own_models import load_models, load_own_model, recorded_digest
from steadytip.kit import Model, Runner

TEXT = '''"""A gain."""

from gains import GAIN

from steadytip.kit import Inputs, Model, Outputs, Parameters, State, real


class Params(Parameters):
    trim = real(None, "factor", start=1.0)


class In(Inputs):
    a = real("m", "position")


class X(State):
    a = real("m", "position a sample ago")


class Out(Outputs):
    b = real("m", "position, times the gain")


def step(p, u, x, T):
    return X(a=u.a), Out(b=GAIN * p.trim * u.a)


MODEL = Model("Gain", step, Params, In, X, Out, sample_period=1e-3)
'''
OTHER = 'FAST = Model("FastGain", step, Params, In, X, Out, sample_period=1e-4)\n'


@pytest.fixture
def file(tmp_path) -> Path:
    path = tmp_path / "gain.py"
    path.write_text(TEXT, "utf-8")
    (tmp_path / "gains.py").write_text("GAIN = 2.0\n", "utf-8")
    return path


def changed(file: Path, old: str, new: str) -> str:
    assert old in TEXT
    file.write_text(TEXT.replace(old, new), "utf-8")
    return str(file)


def test_a_file_with_its_neighbours_is_a_model(file) -> None:
    model = load_own_model(str(file))
    assert Runner(model).run(1, {"a": 3.0})["b"][0] == 6.0
    assert model.summary == "A gain"


def test_what_a_neighbour_says_now_counts_and_no_namesake_of_it(file, tmp_path) -> None:
    first = recorded_digest(load_own_model(str(file)))
    other = tmp_path / "other"
    other.mkdir()
    (other / "gain.py").write_text(TEXT, "utf-8")
    (other / "gains.py").write_text("GAIN = 5.0\n", "utf-8")
    assert Runner(load_own_model(str(other / "gain.py"))).run(1, {"a": 1.0})["b"][0] == 5.0
    assert recorded_digest(load_own_model(str(file))) == first
    (tmp_path / "gains.py").write_text("GAIN = 30.0\n", "utf-8")
    assert recorded_digest(load_own_model(str(file))) != first
    assert "gains" not in sys.modules


def test_the_digest_is_the_same_in_every_process(file) -> None:
    code = (
        "import sys; from fmu_src.pack.own_models import *\n"
        "print(recorded_digest(load_own_model(sys.argv[1])))"
    )
    command = [sys.executable, "-c", code, str(file)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert said == recorded_digest(load_own_model(str(file)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("GAIN *", "1.5 *"),
        ("start=1.0", "start=1.5"),
        ("factor", "another factor"),
        ('"""A gain."""', '"""A gain, told otherwise."""'),
        ("sample_period=1e-3", "sample_period=2e-3"),
    ],
)
def test_the_digest_follows_all_that_the_fmu_says(file, old, new) -> None:
    before = recorded_digest(load_own_model(str(file)))
    assert recorded_digest(load_own_model(changed(file, old, new))) != before


def test_of_several_models_all_are_built_or_the_one_that_is_named(file) -> None:
    file.write_text(TEXT + OTHER, "utf-8")
    assert [m.name for m in load_models(str(file))] == ["Gain", "FastGain"]
    assert load_own_model(f"{file}:FastGain").sample_period == 1e-4
    with pytest.raises(st.SteadytipError, match=r"defines the models Gain, FastGain: say which"):
        load_own_model(str(file))
    with pytest.raises(st.SteadytipError, match=r"no model 'Gian'. There are: Gain, FastGain"):
        load_models(f"{file}:Gian")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("GAIN *", "GAIN * p.trin *", r"gain.py, line 25 `return .*`: .*trin"),
        ("b=GAIN", "c=GAIN", r"gain.py, line 25 .*Out has the fields b; missing or unknown: b, c"),
        ("b=GAIN", "b=1 if u.a > 0 else GAIN", r"line 25 .*truth value.*`casadi.if_else`"),
        ("X(a=u.a), Out(b=GAIN * p.trim * u.a)", "X(a=u.a)", r"line 24: .*must return \(X\(...\)"),
        ("X(a=u.a), Out", "Out(b=u.a), Out", r"line 24: gives Out in the place of X\(...\)"),
        ("a=u.a)", "a='far')", r"line 24: X\(...\): "),
        ("GAIN *", "__import__('math').sin(u.a) *", r"computes with nan.*casadi"),
        ("import GAIN", "import LOSS", r"gain.py, line 3 `from gains import LOSS`: ImportError"),
        ("class X(State):", "class X(State:", r"gain.py, line \d+: "),
        ("MODEL =", "raise SystemExit(3)\nMODEL =", r"ends the program \(exit 3\)"),
        ("MODEL =", "NONE = lambda:", "gain.py defines no model"),
        ('"Gain"', '"my gain"', "model 'my gain' .*must begin with a letter"),
        ("trim = real(None", "a = real(None", "several of its variables are called a;"),
        ("sample_period=1e-3", "sample_period=0", "must be finite and above 0"),
    ],
)
def test_mistakes_name_the_users_file_and_line(file, old, new, words) -> None:
    with pytest.raises(st.SteadytipError, match=words) as caught:
        load_own_model(changed(file, old, new))
    assert "\n" not in str(caught.value)


def test_an_object_and_a_file_give_the_same_fmu(file, tmp_path) -> None:
    model = load_own_model(str(file))
    paths = [
        st.build(each, out=tmp_path / str(n))["Gain"]
        for n, each in enumerate([model, [file], str(file)])
    ]
    assert len({path.read_bytes() for path in paths}) == 1


def test_versions_do_not_take_each_others_place(file, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    model: Model = load_own_model(str(file))
    told: list[str] = []
    one = st.build(model, progress=told.append)["Gain"]
    two = st.build(replace(model, sample_period=2e-3), progress=told.append)["Gain"]
    assert one != two
    assert one.is_file()
    st.build([str(file)], progress=told.append)
    assert told == ["Gain", "Gain"]
    with pytest.raises(st.SteadytipError, match="two models are called 'Gain'"):
        st.build([model, replace(model, sample_period=2e-3)])
    with pytest.raises(st.SteadytipError, match="must be a Python file"):
        st.build(tmp_path / "gain.txt")
