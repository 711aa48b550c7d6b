"""An FMU stepped from C, sample by sample with recorded inputs: what it costs a host in C.

The FMU is loaded and initialised by the harness; then `stepper.c`, compiled by zig, calls it
through its function pointers. Beside the FMU's own code that is a clock's reading for each sample.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiler import compile_library
from harness.bench.samples import StepCase
from harness.common.c_struct import MirroredStruct, check_layout
from harness.common.types import FloatArray
from harness.loop.native import ACCESS, accesses
from harness.parts.fmi import WARNING, Instance, Stepper

__all__ = ["SteppedFmu"]

_SOURCE = Path(__file__).with_name("stepper.c")


class _Fmu(MirroredStruct):
    _fields_ = (
        ("component", ctypes.c_void_p),
        ("do_step", ctypes.c_void_p),
        ("step", ctypes.c_double),
        ("setters", ctypes.c_size_t),
        ("getters", ctypes.c_size_t),
        ("set", ctypes.c_void_p),
        ("get", ctypes.c_void_p),
        ("inputs", ctypes.c_void_p),
        ("width", ctypes.c_size_t),
    )


@cache
def _samples() -> Any:
    """Return the function of `stepper.c`."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in (_SOURCE, ACCESS)}
    library = compile_library("stepper", texts, entry=_SOURCE.name)
    loaded = ctypes.CDLL(str(library))
    check_layout(loaded, {"fmu": _Fmu})
    function = loaded.samples
    function.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p]
    return function


class SteppedFmu:
    """An FMU at its first sample, until it is closed.

    Attributes:
        u: (inputs,) where the inputs of `advance` go.
        advance: one sample from Python, as the harness makes it.
    """

    def __init__(self, case: StepCase, folder: Path) -> None:
        """Load and initialise.

        Args:
            case: the FMU and what it gets.
            folder: to unpack in.

        Raises:
            FaultError: it does not load or start.
        """
        self.case = case
        self._instance = Instance(case.description, "measured", folder)
        self.u = case.table[0].copy() if len(case.connected) else np.empty(0)
        self._y = np.zeros(len(case.description.outputs))
        end = len(case.table) * case.period
        self._instance.begin(end, case.starts, case.connected, self.u)
        self.advance: Stepper = self._instance.stepper(case.connected, self.u, self._y)
        calls = self._instance.calls
        assert calls is not None
        self._set, self._get = accesses(calls.set), accesses(calls.get)
        self._fmu = _Fmu(
            component=calls.component,
            do_step=calls.do_step,
            step=case.period,
            setters=len(self._set),
            getters=len(self._get),
            set=ctypes.addressof(self._set),
            get=ctypes.addressof(self._get),
            inputs=case.table.ctypes.data,
            width=len(case.connected),
        )

    def samples(self, first: int, last: int, spent: FloatArray | None = None) -> None:
        """Step samples in C, of `first` before `last`.

        Args:
            first: number of the first.
            last: number of the one after the last.
            spent: (last - first,) gets the time of each [s].

        Raises:
            SteadytipError: the FMU does not take them.
        """
        room = None if spent is None else spent.ctypes.data
        status = _samples()(ctypes.byref(self._fmu), first, last, room)
        if status > WARNING:
            raise SteadytipError(f"{self.case.name}: a sample ended with FMI's status {status}")

    def outputs(self) -> FloatArray:
        """Return the outputs of the last sample, Real ones first; others only from Python."""
        return self._y.copy()

    def close(self) -> None:
        """Free it."""
        self._instance.close()

    def __enter__(self) -> SteppedFmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
