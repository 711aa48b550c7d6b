"""A model that breaks: the FMU says what became of which output when, and can be brought back."""

import casadi as ca
import fmpy
import pytest
from fmpy.fmi1 import FMICallException

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, real
from fmu_src.pack.compiler import host
from fmu_src.pack.fmu import archive, native
from steadytip.testing import FmuUnderTest

pytestmark = pytest.mark.xdist_group("failing_model")  # its tests share what takes long

GUID = "{00000000-0000-0000-0000-000000000000}"


class P(Parameters):
    divisor = real(None, "what 1 is divided by in the derived record", start=1.0)


class D(Derived):
    quotient = real(None, "1 / divisor")


class U(Inputs):
    x = real("m", "under the root")


class X(State):
    count = real(None, "samples")


class Y(Outputs):
    root = real(None, "root of x")
    small = real("m", "x, promised to stay below 5", max=5.0)


def derive(p, T):
    return D(quotient=1 / p.divisor)


def step(p, u, x, T, derived):
    return X(count=x.count + 1), Y(root=ca.sqrt(u.x), small=u.x)


MODEL = Model("Fragile", step, P, U, X, Y, 0.5, derived=D, derive=derive)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fragile")
    files = native.files(MODEL, GUID, [host()])
    archive.write(folder / "Fragile.fmu", files)
    fmpy.extract(str(folder / "Fragile.fmu"), str(folder / "unpacked"))
    return folder / "Fragile.fmu", folder / "unpacked"


@pytest.mark.parametrize(
    ("x", "words"),
    [(-1.0, "root became nan at t = 1 s, it must be finite"), (7.0, "small became 7 at t = 1 s")],
)
def test_outputs_that_break_their_promise_end_the_run_by_name_and_time(fmu, x, words) -> None:
    instance = FmuUnderTest(*fmu)
    instance.step()
    instance.step()
    good = instance.fmu.getFMUState()
    instance.apply({"x": x})
    with pytest.raises(FMICallException):
        instance.step()
    assert words in instance.messages[-1]
    # Nothing broken is handed out, and no further step is made ...
    assert instance.outputs().tolist() == [0.0, 0.0]
    with pytest.raises(FMICallException):
        instance.fmu.doStep(instance.time, 0.5)
    assert "after an error" in instance.messages[-1]
    with pytest.raises(FMICallException):
        instance.fmu.terminate()
    # ... until a state is restored.
    instance.fmu.setFMUState(good)
    instance.apply({"x": 4.0})
    instance.fmu.doStep(1.0, 0.5)
    assert instance.outputs().tolist() == [2.0, 4.0]
    instance.close()


def test_parameters_that_make_no_sense_together_are_named(fmu) -> None:
    with pytest.raises(FMICallException):
        FmuUnderTest(*fmu, divisor=0.0)


def test_instance_can_be_freed_in_every_state(fmu) -> None:
    broken = FmuUnderTest(*fmu)
    broken.apply({"x": -1.0})
    with pytest.raises(FMICallException):
        broken.step()
    broken.fmu.freeInstance()
