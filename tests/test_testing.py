"""`steadytip.testing`: a model of a user's own held against the laws."""

import pytest

import steadytip as st
from steadytip.kit import Inputs, Model, Outputs, Parameters, State, real
from steadytip.testing import check_model

pytestmark = pytest.mark.xdist_group("testing")


class Params(Parameters):
    gain = real(None, "factor", start=2.0, min=0.0, max=10.0)


class In(Inputs):
    a = real("m", "position", within=1.0)
    b = real("m", "another position", within=1.0)


class X(State):
    a = real("m", "position a sample ago")


class Out(Outputs):
    c = real("m", "difference, times the factor")


def step(p, u, x, T):
    return X(a=u.a), Out(c=p.gain * (u.a - x.a + u.b))


def quotient(p, u, x, T):
    return X(a=u.a), Out(c=1 / (1 - u.a))


def sound(name: str = "Sound", **changed) -> Model:
    return Model(name, changed.get("step", step), Params, In, X, Out, sample_period=1e-3)


def test_a_sound_model_keeps_them_in_the_native_flavour(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    check_model(sound())


def test_and_in_the_python_flavour(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    st.testing.check_model(sound(), "python")


def test_a_pole_inside_the_declared_range_is_found_and_named(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match=r"'Pole' breaks \d+ laws(.|\n)*extreme inputs inside"):
        check_model(sound("Pole", step=quotient))
