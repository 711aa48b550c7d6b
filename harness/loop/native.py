"""Many ticks of the loop in one native call, where all parts allow it.

`native.c` does what `Loop` does in Python, to the same bits: gathers the inputs of each part from
the history, calls the FMU through its function pointers, checks that outputs are finite and the
step was in time, records a row. It comes back when the room for rows is full, at the end, when the
user wants that, or when something is wrong; then the part that was called says what, in its own
words. Meanwhile the interpreter is free, and the watching thread reads here what is being called.

The library is compiled once and kept under a name that its source determines. Where it cannot be
had, without the compiler or on a disk that is read-only, the loop goes tick by tick in Python.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.c_struct import MirroredStruct, check_layout
from harness.common.types import FloatArray
from harness.parts.protocols import FmuCalls, NativelySteppable, OutputTable, TypedAccess
from harness.system.tick_plan import PartStep, TickBuffers, TickPlan

if TYPE_CHECKING:
    from fmu_src.pack.compiler import ZigTarget

__all__ = [
    "ACCESS",
    "NativeLoop",
    "NativeStatus",
    "accesses",
    "compiled",
    "library",
    "native_steps",
]

_SOURCE = Path(__file__).with_name("native.c")
ACCESS = Path(__file__).with_name("access.h")
"""What `accesses` lays out, in C."""
_FLAGS = ("-std=c99", "-O2", "-shared", "-nostdlib", "-ffreestanding", "-fno-builtin")


class NativeStatus(IntEnum):
    """Why the native call came back."""

    FULL, DONE, STOPPED, FAILED, NOT_FINITE, LATE = range(6)


class _Access(MirroredStruct):
    _fields_ = (
        ("call", ctypes.c_void_p),
        ("references", ctypes.c_void_p),
        ("count", ctypes.c_size_t),
        ("values", ctypes.c_void_p),
        ("integers", ctypes.c_void_p),
    )


def accesses(calls: Sequence[TypedAccess]) -> Any:
    """Return calls that pass values as an array for C, which lives as long as somebody holds it."""
    return (_Access * len(calls))(
        *(_Access(a.function, a.references, a.count, a.values, a.integers) for a in calls)
    )


class _Part(MirroredStruct):
    _fields_ = (
        ("inputs", ctypes.c_size_t),
        ("sources", ctypes.c_void_p),
        ("u", ctypes.c_void_p),
        ("outputs", ctypes.c_size_t),
        ("y", ctypes.c_void_p),
        ("limit", ctypes.c_double),
        ("do_step", ctypes.c_void_p),
        ("component", ctypes.c_void_p),
        ("never_returns", ctypes.c_int),
        ("setters", ctypes.c_size_t),
        ("getters", ctypes.c_size_t),
        ("set", ctypes.c_void_p),
        ("get", ctypes.c_void_p),
        ("table", ctypes.c_void_p),
        ("rows", ctypes.c_int64),
    )


class _Loop(MirroredStruct):
    _fields_ = (
        ("count", ctypes.c_size_t),
        ("parts", ctypes.c_void_p),
        ("history", ctypes.c_void_p),
        ("width", ctypes.c_size_t),
        ("length", ctypes.c_size_t),
        ("step", ctypes.c_double),
        ("tick", ctypes.c_int64),
        ("last", ctypes.c_int64),
        ("row", ctypes.c_void_p),
        ("room", ctypes.c_int64),
        ("clock", ctypes.c_void_p),
        ("clock_id", ctypes.c_int),
        ("clock_period", ctypes.c_double),
        ("begun", ctypes.c_int64),
        ("stop", ctypes.c_int),
        ("part", ctypes.c_int64),
        ("call", ctypes.c_int64),
        ("status", ctypes.c_int64),
        ("took", ctypes.c_double),
    )


@cache
def library() -> Any:
    """Return the compiled `native.c`; None where it cannot be compiled or loaded."""
    try:
        found = ctypes.CDLL(str(compiled()))
    except (OSError, SteadytipError):
        return None
    check_layout(found, {"access": _Access, "part": _Part, "loop": _Loop})
    return found


def compiled(target: ZigTarget | None = None, *warnings: str) -> Path:
    """Return the library for a platform.

    Args:
        target: platform; this one by default.
        warnings: flags of the compiler for the warnings that are wanted.

    Raises:
        SteadytipError: the compiler is missing or refuses the source.
    """
    from fmu_src.pack.compiler import compile_library, host_target

    target = target or host_target()
    target = replace(target, flags=tuple(flag for flag in target.flags if flag != "-lm"))
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ACCESS, _SOURCE)}
    return compile_library("native", texts, target, (*_FLAGS, *warnings), _SOURCE.name)


def native_steps(plan: TickPlan) -> list[FmuCalls | OutputTable] | None:
    """Return how each part that has been started is called natively; None if one is not."""
    if library() is None:
        return None
    parts = [step.part for step in plan.steps]
    found = [part.native_step() if isinstance(part, NativelySteppable) else None for part in parts]
    return None if None in found else found  # type: ignore[return-value]


class NativeLoop:
    """A tick plan laid out for `native.c`, and where it is in the run."""

    def __init__(
        self,
        plan: TickPlan,
        buffers: TickBuffers,
        calls: Sequence[FmuCalls | OutputTable],
        period: float,
        first: int,
        last: int,
    ) -> None:
        """Lay out; all arrays of the buffers are used where they are.

        Args:
            plan: what a tick does.
            buffers: memory that it is executed on.
            calls: of each step, see `native_steps`.
            period: of the ticks [s].
            first: tick to begin with.
            last: tick to stop before.
        """
        self._calls = calls
        self._alive: list[Any] = [plan, buffers]
        self._parts = (_Part * len(calls))(
            *(
                self._part(each, step, u, y)
                for each, step, u, y in zip(
                    calls, plan.steps, buffers.inputs, buffers.outputs, strict=True
                )
            )
        )
        call, which, counter = _clock()
        self._alive.append(call)
        self._now = _Loop(
            count=len(calls),
            parts=ctypes.addressof(self._parts),
            history=buffers.history.ctypes.data,
            width=plan.width,
            length=len(buffers.history),
            step=period,
            tick=first,
            last=last,
            clock=ctypes.cast(call, ctypes.c_void_p),
            clock_id=which,
            clock_period=counter,
        )
        self._function = library().run_ticks
        self._running = False
        self._seen, self._since = 0, 0.0

    def go(self, buffer: FloatArray) -> NativeStatus:
        """Run until something has to be done about it, and say what.

        Args:
            buffer: (n, width) for rows of signals; n ticks at most are run.
        """
        assert len(buffer) > 0
        assert buffer.flags.c_contiguous
        self._now.row, self._now.room = buffer.ctypes.data, len(buffer)
        self._running = True
        try:
            return NativeStatus(self._function(ctypes.byref(self._now)))
        finally:
            self._running = False

    def stop(self) -> None:
        """Have it come back after the tick that it is in; from any thread."""
        self._now.stop = 1

    @property
    def tick(self) -> int:
        """Number of ticks that are done."""
        return int(self._now.tick)

    @property
    def part(self) -> int:
        """Index of the part that something is wrong with."""
        return int(self._now.part)

    @property
    def took(self) -> float:
        """Its step, when that was late [s]."""
        return float(self._now.took)

    def blame(self) -> None:
        """Say what failed, as the part's own `advance` would.

        Raises:
            FaultError: that.
        """
        calls = self._calls[self.part]
        assert isinstance(calls, FmuCalls)
        calls.blame(self._now.call, self._now.status)

    def called(self) -> tuple[int, int, float] | None:
        """For a thread that looks now and then: what is being called.

        Returns:
            Index of the part, tick, and since when a look has seen it [s, `time.perf_counter`];
            None when nothing is.
        """
        if not self._running:
            return None
        begun = self._now.begun
        if begun != self._seen:
            self._seen, self._since = begun, time.perf_counter()
        tick, index = divmod(begun - 1, len(self._calls))
        return (index, tick, self._since) if begun else None

    def _part(
        self, calls: FmuCalls | OutputTable, step: PartStep, u: FloatArray, y: FloatArray
    ) -> _Part:
        part = _Part(
            inputs=len(step.sources),
            sources=step.sources.ctypes.data,
            u=u.ctypes.data,
            outputs=len(y),
            y=y.ctypes.data,
            limit=step.limit,
        )
        if isinstance(calls, OutputTable):
            table = np.ascontiguousarray(calls.values, dtype=float)
            self._alive.append(table)
            part.table, part.rows = table.ctypes.data, len(table)
            return part
        part.do_step, part.component = calls.do_step, calls.component
        part.never_returns = calls.never_returns
        part.setters, part.set = len(calls.set), self._accesses(calls.set)
        part.getters, part.get = len(calls.get), self._accesses(calls.get)
        return part

    def _accesses(self, calls: Sequence[TypedAccess]) -> int:
        array = accesses(calls)
        self._alive.append(array)
        return ctypes.addressof(array)


def _clock() -> tuple[Any, int, float]:
    """Return a monotonic clock's function, its argument, and the period of a counter [s]."""
    if sys.platform == "win32":
        kernel = ctypes.WinDLL("kernel32")
        frequency = ctypes.c_int64()
        kernel.QueryPerformanceFrequency(ctypes.byref(frequency))
        return kernel.QueryPerformanceCounter, 0, 1.0 / frequency.value
    return ctypes.CDLL(None).clock_gettime, time.CLOCK_MONOTONIC, 0.0
