import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, integer, real
from fmu_src.kit.runner import Runner


class Inner(Parameters):
    w = real("m", "weights", shape=3, start=(1, 2, 3))


class Params(Parameters):
    gain = real("1/s", "gain", start=2.0, min=0.0)
    matrix = real(None, "matrix", shape=(2, 3), start=[[1, 2, 3], [4, 5, 6]])
    inner = Inner.starting(w=(7, 8, 9))
    choice = integer("choice", min=0, max=3, start=1)


class In(Inputs):
    position = real("m", "position", shape=3, axes="xyz")
    on = boolean("switch")


class X(State):
    count = real(None, "samples so far")


class Out(Outputs):
    scaled = real("m/s", "scaled position", shape=3, axes="xyz")
    matrix = real(None, "the matrix", shape=(2, 3))
    count = real(None, "samples so far")


def step(p, u, x, T):
    scaled = ca.if_else(u.on, p.gain * u.position, 0)
    return X(count=x.count + 1), Out(scaled=scaled, matrix=p.matrix, count=x.count)


MODEL = Model("Probe", step, Params, In, X, Out, sample_period=1e-3)


def test_the_records_of_a_model_are_those_of_the_signature_of_its_step() -> None:
    def annotated(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
        return step(p, u, x, T)

    model = Model.of_step("Probe", annotated, sample_period=1e-3)
    assert model == Model("Probe", annotated, Params, In, X, Out, sample_period=1e-3)
    with pytest.raises(SteadytipError, match="model 'Probe': annotate p, u, x, return of its step"):
        Model.of_step("Probe", step, sample_period=1e-3)


def test_names_are_structured_inside_and_plain_on_ports() -> None:
    names = {group: [s.name for s in scalars] for group, scalars in MODEL.variables.items()}
    assert names["parameter"][:3] == ["gain", "matrix[1,1]", "matrix[2,1]"]
    assert names["parameter"][-2:] == ["inner.w[3]", "choice"]
    assert names["input"] == ["position_x", "position_y", "position_z", "on"]
    assert names["output"][-1] == "count"
    assert names["local"] == ["state.count"]


def test_nested_record_can_start_elsewhere_without_touching_the_original() -> None:
    assert [s.start for s in Params.scalars() if s.name.startswith("inner")] == [7, 8, 9]
    assert list(Inner.starts()) == [1, 2, 3]


@given(st.lists(st.floats(-1e6, 1e6), min_size=11, max_size=11))
def test_pack_is_the_inverse_of_unpack(values) -> None:
    record = Params.unpack(ca.SX(ca.DM(values)))
    np.testing.assert_array_equal(np.array(ca.DM(record.pack())).ravel(), values)


def test_wrong_shapes_and_names_are_refused() -> None:
    with pytest.raises(SteadytipError, match=r"X.count: got the shape \(3, 1\)"):
        X(count=ca.SX.zeros(3)).pack()
    with pytest.raises(SteadytipError, match="missing or unknown: count"):
        X()
    with pytest.raises(SteadytipError, match="no field 'v'"):
        Inner.starting(v=1)


def test_start_outside_its_range_is_refused() -> None:
    with pytest.raises(SteadytipError, match="start -1 must be at least 0"):
        real("m", "length", start=-1.0, min=0.0)


def test_runner_takes_fields_elements_and_tables() -> None:
    position = np.arange(12.0).reshape(4, 3)
    runner = Runner(MODEL, {"gain": 3.0, "matrix[2,1]": 40.0})
    out = runner.run(4, {"position": position, "on": True})
    np.testing.assert_array_equal(out["scaled"], 3 * position)
    np.testing.assert_array_equal(out["matrix"][0], [[1, 2, 3], [40, 5, 6]])
    np.testing.assert_array_equal(runner.run(2)["count"], [4, 5])


def test_runner_names_the_nearest_variable() -> None:
    with pytest.raises(SteadytipError, match="the nearest is 'gain'"):
        Runner(MODEL, {"gian": 1.0})
    with pytest.raises(SteadytipError, match="shape"):
        Runner(MODEL).run(3, {"position": np.zeros((4, 3))})
