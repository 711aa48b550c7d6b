"""Calls out of order and with odd arguments: refused with a reason, the instance unharmed."""

import ctypes
import math
import struct
import zlib

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException


@pytest.mark.parametrize("h", [0.0, -1e-3, math.nan, math.inf])
def test_step_sizes_that_make_no_sense_are_refused(start, h) -> None:
    instance = start()
    before = instance.values()
    with pytest.raises(FMICallException):
        instance.fmu.doStep(0.0, h)
    assert "communicationStepSize" in instance.messages[-1]
    np.testing.assert_array_equal(instance.values(), before)
    instance.step()


@pytest.mark.parametrize("t", [1.0, -1e-3, math.nan, math.inf, -math.inf])
def test_times_that_do_not_continue_are_refused(start, t) -> None:
    instance = start()
    with pytest.raises(FMICallException):
        instance.fmu.doStep(t, instance.period)
    assert "currentCommunicationPoint" in instance.messages[-1]


def test_a_step_past_the_stop_time_is_refused(start) -> None:
    instance = start()
    instance.fmu.reset()
    instance.fmu.setupExperiment(startTime=0.0, stopTime=instance.period)
    instance.fmu.enterInitializationMode()
    instance.fmu.exitInitializationMode()
    instance.fmu.doStep(0.0, instance.period)
    with pytest.raises(FMICallException):
        instance.fmu.doStep(instance.period, instance.period)
    assert "stop time" in instance.messages[-1]


def test_functions_out_of_order_say_so(start) -> None:
    instance = start()
    for call in (instance.fmu.enterInitializationMode, instance.fmu.exitInitializationMode):
        with pytest.raises(FMICallException):
            call()
        assert "not allowed between steps" in instance.messages[-1]
    instance.step()


def test_fixed_parameters_and_outputs_cannot_be_set_while_stepping(model, start) -> None:
    instance = start()
    fixed = [v for v in instance.variables if v.variability == "fixed"][:1]
    for variable in [*fixed, next(v for v in instance.variables if v.causality == "output")]:
        with pytest.raises(FMICallException):
            instance.set(variable, 0.0)
        assert variable.name in instance.messages[-1]


def test_wrong_guid_and_missing_name_give_no_instance(paths, folders) -> None:
    from steadytip.testing import FmuUnderTest

    instance = FmuUnderTest(paths["native"], folders["native"])
    fmu = instance.fmu
    guid = fmu.guid.encode()
    for name, text in ((b"x", b"{0}"), (b"", guid), (None, guid), (b"x", None)):
        found = fmu.fmi2Instantiate(name, 1, text, b"", ctypes.byref(fmu.callbacks), 0, 0)
        assert not found
    # Model exchange
    assert not fmu.fmi2Instantiate(b"x", 0, guid, b"", ctypes.byref(fmu.callbacks), 0, 0)
    assert len(instance.messages) >= 4
    instance.close()


def test_damaged_states_are_refused_and_change_nothing(start, inputs) -> None:
    """Any flipped bit, any other length."""
    instance = start()
    instance.apply(inputs(0))
    instance.step()
    state = instance.fmu.getFMUState()
    blob = bytearray(instance.fmu.serializeFMUstate(state))
    before = instance.values()
    rng = np.random.default_rng(2)
    for at in rng.integers(0, 8 * len(blob), 40):
        damaged = bytearray(blob)
        damaged[at // 8] ^= 1 << at % 8
        with pytest.raises(FMICallException):
            instance.fmu.deSerializeFMUstate(bytes(damaged))
    for cut in (b"", bytes(blob[:-1]), bytes(blob) + b"\0"):
        with pytest.raises(FMICallException):
            instance.fmu.deSerializeFMUstate(cut)
    np.testing.assert_array_equal(instance.values(), before)
    instance.fmu.freeFMUState(state)


def test_made_up_states_with_a_right_checksum_are_refused(start) -> None:
    """A value that is not finite, and a mode that does not exist."""
    instance = start()
    instance.step()
    state = instance.fmu.getFMUState()
    blob = bytes(instance.fmu.serializeFMUstate(state))
    instance.fmu.freeFMUState(state)
    before = instance.values()
    # Behind magic, version, GUID and count lie the values; the mode is 16 bytes before the end.
    first = 4 + 4 + len(instance.description.guid) + 4
    for at, piece in ((first, struct.pack("<d", math.nan)), (len(blob) - 16, b"\3\0\0\0")):
        forged = blob[:at] + piece + blob[at + len(piece) : -4]
        forged += struct.pack("<I", zlib.crc32(forged))
        with pytest.raises(FMICallException):
            instance.fmu.deSerializeFMUstate(forged)
        assert "state" in instance.messages[-1]
    np.testing.assert_array_equal(instance.values(), before)
