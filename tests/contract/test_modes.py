"""The state machine of FMI 2.0.5, 4.2.4: which call is legal in which state."""

import ctypes

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

STATES = ("instantiated", "initialization", "step complete", "terminated")
EVERY = set(STATES)
READING = {"initialization", "step complete", "terminated"}


def calls(instance, model):
    """Each function as a call that is right but for the state, and the states that allow it."""
    fmu = instance.fmu
    state = fmu.getFMUState()
    blob = fmu.serializeFMUstate(state)
    real = next(v for v in instance.variables if v.type == "Real" and v.causality == "output")
    number, whole = ctypes.c_double(), ctypes.c_int()
    none = ([], [])
    return {
        "fmi2SetDebugLogging": (lambda: fmu.setDebugLogging(True, ["logAll"]), EVERY),
        "fmi2SetupExperiment": (lambda: fmu.setupExperiment(startTime=0.0), {"instantiated"}),
        "fmi2EnterInitializationMode": (fmu.enterInitializationMode, {"instantiated"}),
        "fmi2ExitInitializationMode": (fmu.exitInitializationMode, {"initialization"}),
        "fmi2GetReal": (lambda: fmu.getReal([real.valueReference]), READING),
        "fmi2GetInteger": (lambda: fmu.getInteger([]), READING),
        "fmi2GetBoolean": (lambda: fmu.getBoolean([]), READING),
        "fmi2GetString": (lambda: fmu.getString([]), READING),
        "fmi2SetReal": (lambda: fmu.setReal(*none), EVERY - {"terminated"}),
        "fmi2SetInteger": (lambda: fmu.setInteger(*none), EVERY - {"terminated"}),
        "fmi2SetBoolean": (lambda: fmu.setBoolean(*none), EVERY - {"terminated"}),
        "fmi2SetString": (lambda: fmu.setString(*none), EVERY - {"terminated"}),
        "fmi2GetFMUstate": (lambda: fmu.freeFMUState(fmu.getFMUState()), EVERY),
        "fmi2SerializeFMUstate": (lambda: fmu.serializeFMUstate(state), EVERY),
        "fmi2DeSerializeFMUstate": (
            lambda: fmu.freeFMUState(fmu.deSerializeFMUstate(blob)),
            EVERY,
        ),
        "fmi2GetDirectionalDerivative": (
            lambda: fmu.getDirectionalDerivative([], [], []),
            READING if model.derivatives else set(),
        ),
        "fmi2GetRealStatus": (
            lambda: fmu.fmi2GetRealStatus(fmu.component, 2, ctypes.byref(number)),
            {"step complete", "terminated"},
        ),
        "fmi2GetBooleanStatus": (
            lambda: fmu.fmi2GetBooleanStatus(fmu.component, 3, ctypes.byref(whole)),
            {"step complete", "terminated"},
        ),
        "fmi2CancelStep": (lambda: fmu.fmi2CancelStep(fmu.component), set()),
        "fmi2SetRealInputDerivatives": (
            lambda: fmu.fmi2SetRealInputDerivatives(fmu.component, None, 0, None, None),
            set(),
        ),
        "fmi2GetRealOutputDerivatives": (
            lambda: fmu.fmi2GetRealOutputDerivatives(fmu.component, None, 0, None, None),
            set(),
        ),
        "fmi2DoStep": (lambda: fmu.doStep(0.0, instance.period), {"step complete"}),
        "fmi2Terminate": (fmu.terminate, {"step complete"}),
        "fmi2Reset": (fmu.reset, EVERY),
    }


def bring(instance, state: str) -> None:
    fmu = instance.fmu
    fmu.reset()
    if state == "instantiated":
        return
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    if state != "initialization":
        fmu.exitInitializationMode()
    if state == "terminated":
        fmu.terminate()


@pytest.mark.parametrize("state", STATES)
def test_every_function_in_every_state(model, start, state) -> None:
    """Legal calls succeed, illegal ones return an error, say why, and change nothing."""
    instance = start()
    table = calls(instance, model)
    for name, (call, legal) in table.items():
        bring(instance, state)
        before = instance.fmu.serializeFMUstate(instance.fmu.getFMUState())
        told = len(instance.messages)
        try:
            call()
            allowed = True
        except FMICallException:
            allowed = False
        assert allowed == (state in legal), name
        if not allowed:
            assert len(instance.messages) > told, name
            after = instance.fmu.serializeFMUstate(instance.fmu.getFMUState())
            assert bytes(after) == bytes(before), name


def test_time_of_the_last_step_can_be_asked_for(start) -> None:
    instance = start()
    for _ in range(3):
        instance.step()
    found = ctypes.c_double()
    instance.fmu.fmi2GetRealStatus(instance.fmu.component, 2, ctypes.byref(found))
    assert found.value == pytest.approx(3 * instance.period)


def test_runs_may_start_at_any_time(start, inputs) -> None:
    """A negative and a late start give the same run, sample for sample."""
    runs = []
    for begin in (0.0, -5.0, 1e6):
        instance = start()
        instance.fmu.reset()
        instance.fmu.setupExperiment(startTime=begin)
        instance.fmu.enterInitializationMode()
        instance.fmu.exitInitializationMode()
        rows = []
        for k in range(30):
            instance.apply(inputs(k))
            instance.fmu.doStep(begin + k * instance.period, instance.period)
            rows.append(instance.outputs())
        runs.append(np.array(rows))
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])
