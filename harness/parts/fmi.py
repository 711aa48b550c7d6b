"""One running FMI 2.0 co-simulation instance, driven through preallocated buffers.

fmpy loads the library and knows the signatures; the calls of the tick go through function pointers
of our own with fixed pointers, because building lists costs more than most models' step.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import math
import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import fmpy.fmi1
import numpy as np
from fmpy import calloc, free
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2FMUstate,
)

from fmu_src.errors import range_text
from harness.common.archives import ArchiveError, extract
from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.description import Description, Variable
from harness.parts.protocols import FmuCalls, TypedAccess

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
_STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
_KEPT_MESSAGES = 20
_QUOTED_MESSAGES = 3
_TYPES = ("Real", "Integer", "Boolean")
_NOT_RUN = ("documentation", "sources")

Stepper = Callable[[float, float], None]


@dataclass(frozen=True)
class _Message:
    status: int
    text: str


_logs: dict[int, deque[_Message]] = {}
_next_log = itertools.count(1)


def _log(environment: int, _name: bytes, status: int, _category: bytes, message: bytes) -> None:
    # One callback for all instances, told apart by the environment pointer: fmpy's native proxy,
    # which formats the variadic arguments, can forward to one function only.
    log = _logs.get(environment or 0)
    if log is not None and message:
        log.append(_Message(status, message.decode("utf-8", "replace").strip()))


_callbacks_alive = (
    fmi2CallbackLoggerTYPE(_log),
    fmi2CallbackAllocateMemoryTYPE(calloc),
    fmi2CallbackFreeMemoryTYPE(free),
)


def _callbacks(environment: int) -> fmi2CallbackFunctions:
    functions = fmi2CallbackFunctions()
    functions.logger, functions.allocateMemory, functions.freeMemory = _callbacks_alive
    functions.componentEnvironment = environment
    with contextlib.suppress(ImportError, OSError):  # no proxy binary for this machine
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(ctypes.byref(functions))
    return functions


def unpack(description: Description, workspace: Path) -> Path:
    """Extract an FMU below the workspace, once per content, without what no run needs.

    That is documentation, sources and binaries for other machines: most of an FMU.

    Raises:
        FaultError: the archive is damaged or hostile, or the disk is full.
    """
    folder = workspace / description.sha256[:16]
    if folder.exists():
        return folder
    ours = f"{description.binary().rpartition('/')[0]}/"

    def wanted(member: str) -> bool:
        top = member.partition("/")[0]
        return member.startswith(ours) if top == "binaries" else top not in _NOT_RUN

    try:
        extract(description.path, folder, wanted=wanted)
    except ArchiveError as error:
        raise FaultError(str(error)) from None
    return folder


class _StayingOs(ModuleType):
    """The module `os` for fmpy, which does not leave the working directory.

    fmpy goes to the folder of a binary to load it. All threads share the working directory: another
    run would write its files there. A library that is loaded by its whole path does not need it.
    """

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    @staticmethod
    def chdir(path: str) -> None:
        """Stay."""


if os.name == "posix":
    fmpy.fmi1.os = _StayingOs("os")


class Instance:
    """An FMU that has been loaded and instantiated."""

    def __init__(self, description: Description, name: str, workspace: Path) -> None:
        """Load the binary and instantiate.

        Raises:
            FaultError: the binary does not load or the FMU refuses to be instantiated.
        """
        self._description = description
        self._environment = next(_next_log)
        self._messages = _logs.setdefault(self._environment, deque(maxlen=_KEPT_MESSAGES))
        self._status = OK
        self.warnings: tuple[str, ...] = ()
        self.calls: FmuCalls | None = None
        self._alive: list[Any] = []
        folder = unpack(description, workspace)
        try:
            # fmpy changes the working directory, and stays there when loading fails.
            with contextlib.chdir(Path.cwd()):
                self._fmu = FMU2Slave(
                    guid=description.model.guid,
                    unzipDirectory=str(folder),
                    modelIdentifier=description.identifier,
                    instanceName=name,
                    libraryPath=str(folder / description.binary()),
                )
        except Exception as error:
            raise FaultError(f"{description.path.name} does not load: {error}") from None
        try:
            self._fmu.instantiate(callbacks=_callbacks(self._environment), loggingOn=True)
        except Exception:
            self._fmu.freeLibrary()
            _logs.pop(self._environment)
            raise FaultError(
                f"{description.path.name} refuses to be instantiated{self._said()}"
            ) from None

    def begin(
        self,
        stop: float,
        start_values: Mapping[str, Any],
        initialised: Sequence[str],
        preset_values: FloatArray,
    ) -> None:
        """Set start values, go through initialisation mode with the inputs that are known.

        Args:
            stop: end of the run [s].
            start_values: by variable name.
            initialised: inputs whose value is known before the first step.
            preset_values: (len(preset),) those values.

        Raises:
            FaultError: the FMU refuses a value or the mode.
        """
        fmu = self._fmu
        for name, value in start_values.items():
            self._set_one(self._description.variables[name], value)
        self._call("SetupExperiment", fmu.setupExperiment, startTime=0.0, stopTime=stop)
        self._call("EnterInitializationMode", fmu.enterInitializationMode)
        for name, value in zip(initialised, preset_values, strict=True):
            self._set_one(self._description.variables[name], value)
        self._call("ExitInitializationMode", fmu.exitInitializationMode)
        texts = [message.text for message in self._messages if message.status == WARNING]
        self.warnings = tuple(dict.fromkeys(texts))

    def stepper(
        self,
        connected: Sequence[str],
        u: FloatArray,
        y: FloatArray,
        returns: bool = False,
        outputs: Sequence[str] | None = None,
    ) -> Stepper:
        """Make the function of one tick, and read the outputs once into `y`.

        What that function does is in `calls` for those who do the same without Python.

        Args:
            connected: names of inputs, Real ones first, then Integer, then Boolean.
            u: (len(driven),) where their values will be.
            y: (outputs,) where the outputs go.
            returns: whether a saved state may be restored later; the standard has this told to
                the FMU with every step.
            outputs: names of those that are read, in the order of `Description.outputs`, which
                are all if left out.

        Returns:
            `advance(t, h)`; it raises FaultError.
        """
        self._alive.clear()  # of an earlier stepper, which is not called any more
        setters = self._accessors("Set", [self._description.variables[n] for n in connected], u)
        read_names = outputs or [port.name for port in self._description.outputs]
        getters = self._accessors("Get", [self._description.variables[n] for n in read_names], y)
        component = self._fmu.component
        do_step = self._fmu.dll["fmi2DoStep"]
        do_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        refused, failed = self._refused, self._failed
        never_returns = int(not returns)

        def blame(call: int, status: int) -> None:
            if call < len(setters):
                refused(connected, u, status)
            names = ["DoStep", *(g[0].__name__.removeprefix("fmi2") for g in getters)]
            failed(names[call - len(setters)], status)

        self.calls = FmuCalls(
            component=component,
            set=_addresses(setters),
            do_step=_address(do_step),
            never_returns=never_returns,
            get=_addresses(getters),
            blame=blame,
        )

        def read() -> None:
            for function, references, count, pointer, values, buffer in getters:
                status = function(component, references, count, pointer)
                if status > WARNING:
                    failed(function.__name__.removeprefix("fmi2"), status)
                if buffer is not None:
                    values[:] = buffer

        def advance(t: float, h: float) -> None:
            for function, references, count, pointer, values, buffer in setters:
                if buffer is not None:
                    buffer[:] = values
                status = function(component, references, count, pointer)
                if status > WARNING:
                    refused(connected, u, status)
            status = do_step(component, t, h, never_returns)
            if status > WARNING:
                failed("DoStep", status)
            read()

        read()
        return advance

    @property
    def worn(self) -> bool:
        """True if an error has left it in a state that nobody should go on from."""
        return self._status >= ERROR

    def reset(self) -> None:
        """Go back to how it was after instantiation; `begin` is to come again.

        Raises:
            FaultError: the FMU does not do it.
        """
        self._call("Reset", self._fmu.reset)
        self._messages.clear()
        self._status = OK

    def adjust(self, values: Mapping[str, Any]) -> None:
        """Set tunable parameters and inputs, between two steps.

        Raises:
            FaultError: the FMU refuses a value.
        """
        for name, value in values.items():
            self._set_one(self._description.variables[name], value)

    def save(self) -> fmi2FMUstate:
        """Ask the FMU for a copy of its state; `free` gives it back.

        Raises:
            FaultError: the FMU does not give it.
        """
        state = fmi2FMUstate()
        self._call(
            "GetFMUstate",
            self._fmu.fmi2GetFMUstate,
            c=self._fmu.component,
            FMUstate=ctypes.byref(state),
        )
        return state

    def restore(self, state: fmi2FMUstate) -> None:
        """Put the FMU back into a state that `save` gave.

        Raises:
            FaultError: the FMU does not take it.
        """
        component = self._fmu.component
        self._call("SetFMUstate", self._fmu.fmi2SetFMUstate, c=component, FMUstate=state)

    def free(self, state: fmi2FMUstate) -> None:
        """Give a saved state back to the FMU."""
        with contextlib.suppress(FMICallException):
            self._fmu.fmi2FreeFMUstate(self._fmu.component, ctypes.byref(state))

    def close(self) -> None:
        """Leave the FMU as the standard asks: nothing after Fatal, no Terminate after Error."""
        _logs.pop(self._environment, None)
        if self._status >= FATAL:
            return
        with contextlib.suppress(FMICallException):
            if self._status <= WARNING:
                self._fmu.terminate()
        self._fmu.freeInstance()

    def _accessors(
        self, verb: str, variables: Sequence[Variable], values: FloatArray
    ) -> list[tuple[Any, ...]]:
        """For each type: function, references, count, pointer, slice of `values`, int buffer.

        Real values pass straight from and to `values`; the others through a buffer of C ints.
        """
        accessors: list[tuple[Any, ...]] = []
        at = 0
        for kind in _TYPES:
            references = [v.reference for v in variables if v.type == kind]
            count = len(references)
            if not count:
                continue
            part = values[at : at + count]
            at += count
            buffer = None if kind == "Real" else np.zeros(count, dtype=np.intc)
            held = part if buffer is None else buffer
            function = self._fmu.dll[f"fmi2{verb}{kind}"]
            function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
            array = (ctypes.c_uint * count)(*references)
            self._alive.append(array)
            address = ctypes.addressof(array)
            accessors.append((function, address, count, held.ctypes.data, part, buffer))
        return accessors

    def _set_one(self, variable: Variable, value: Any) -> None:
        fmu = self._fmu
        typed: Any = value
        if variable.type == "Integer":
            typed = int(value)
        elif variable.type == "Boolean":
            typed = bool(value)
        setter = getattr(fmu, f"set{variable.type}")
        try:
            setter([variable.reference], [typed])
        except FMICallException as error:
            self._status = max(self._status, error.status)
            raise FaultError(self._refusal(variable, value, error.status)) from None

    def _call(self, name: str, function: Callable[..., Any], **arguments: Any) -> None:
        try:
            function(**arguments)
        except FMICallException as error:
            self._failed(name, error.status)

    def _failed(self, name: str, status: int) -> None:
        self._status = max(self._status, status)
        raise FaultError(f"fmi2{name} returned {_status_name(status)}{self._said()}")

    def _refused(self, connected: Sequence[str], u: FloatArray, status: int) -> None:
        """Say which input was refused: the first that is out of its range, or refused alone."""
        self._status = max(self._status, status)
        for name, value in zip(connected, u.tolist(), strict=True):
            variable = self._description.variables[name]
            if not math.isfinite(value) or not variable.low <= value <= variable.high:
                raise FaultError(self._refusal(variable, value, status))
        # After Discard the standard lets one go on calling; after Error it does not.
        if status == DISCARD:
            for name, value in zip(connected, u.tolist(), strict=True):
                self._set_one(self._description.variables[name], value)
        raise FaultError(f"an input was refused with {_status_name(status)}{self._said()}")

    def _refusal(self, variable: Variable, value: Any, status: int) -> str:
        unit = f" {variable.unit}" if variable.unit else ""
        shown = f"{value:.9g}" if isinstance(value, float) else repr(value)
        limits = ""
        if math.isfinite(variable.low) or math.isfinite(variable.high):
            limits = f" (it should be {range_text(variable.low, variable.high)}{unit})"
        return (
            f"{variable.causality} '{variable.name}' = {shown}{unit} was refused with "
            f"{_status_name(status)}{limits}{self._said()}"
        )

    def _said(self) -> str:
        """Return the FMU's own last words, for the end of an error text."""
        texts = [message.text for message in self._messages if message.status >= WARNING]
        said = list(dict.fromkeys(texts))
        return f". The FMU says: {' | '.join(said[-_QUOTED_MESSAGES:])}" if said else ""


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def _addresses(accessors: Sequence[tuple[Any, ...]]) -> tuple[TypedAccess, ...]:
    return tuple(
        TypedAccess(
            function=_address(function),
            references=references,
            count=count,
            values=values.ctypes.data,
            integers=0 if buffer is None else buffer.ctypes.data,
        )
        for function, references, count, _, values, buffer in accessors
    )


def _status_name(status: int) -> str:
    return _STATUS[status] if 0 <= status < len(_STATUS) else f"the illegal status {status}"
