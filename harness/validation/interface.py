"""The C interface of FMI 2.0 for co-simulation (FMI 2.0.5, 2.1 and 4.2), in ctypes.

Enumerations are C ints, strings `c_char_p`, every pointer that a probe may want to be wrong is a
`c_void_p`.
"""

from ctypes import c_char_p, c_double, c_int, c_size_t, c_void_p
from enum import IntEnum
from typing import Any

__all__ = ["SIGNATURES", "FmiStatus"]

FmiStatus = IntEnum("FmiStatus", ["OK", "Warning", "Discard", "Error", "Fatal", "Pending"], start=0)
"""fmi2Status."""

_ARRAY = (c_void_p, c_size_t, c_void_p)
"""Value references, their number, values."""

_STATUS_CALLS: dict[str, tuple[Any, ...]] = {
    "fmi2SetDebugLogging": (c_int, c_size_t, c_void_p),
    "fmi2SetupExperiment": (c_int, c_double, c_double, c_int, c_double),
    "fmi2EnterInitializationMode": (),
    "fmi2ExitInitializationMode": (),
    "fmi2Terminate": (),
    "fmi2Reset": (),
    **{
        f"fmi2{verb}{kind}": _ARRAY
        for verb in ("Get", "Set")
        for kind in ("Real", "Integer", "Boolean", "String")
    },
    "fmi2GetFMUstate": (c_void_p,),
    "fmi2SetFMUstate": (c_void_p,),
    "fmi2FreeFMUstate": (c_void_p,),
    "fmi2SerializedFMUstateSize": (c_void_p, c_void_p),
    "fmi2SerializeFMUstate": (c_void_p, c_void_p, c_size_t),
    "fmi2DeSerializeFMUstate": (c_void_p, c_size_t, c_void_p),
    "fmi2GetDirectionalDerivative": (
        *(c_void_p, c_size_t, c_void_p, c_size_t, c_void_p, c_void_p),
    ),
    "fmi2SetRealInputDerivatives": (c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2GetRealOutputDerivatives": (c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2DoStep": (c_double, c_double, c_int),
    "fmi2CancelStep": (),
    **{
        f"fmi2Get{kind}Status": (c_int, c_void_p)
        for kind in ("", "Real", "Integer", "Boolean", "String")
    },
}

SIGNATURES: dict[str, tuple[Any, ...]] = {
    "fmi2GetTypesPlatform": (c_char_p,),
    "fmi2GetVersion": (c_char_p,),
    "fmi2Instantiate": (*(c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int),),
    "fmi2FreeInstance": (None, c_void_p),
    **{name: (c_int, c_void_p, *rest) for name, rest in _STATUS_CALLS.items()},
}
"""Result and arguments of the 34 functions that a co-simulation FMU exports."""
