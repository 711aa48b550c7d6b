"""A host for one FMU 2.0 binary that can do everything wrong on purpose.

Only the standard library is used: the process starts at once, and nothing else of ours can be to
blame for what happens in it. Before every call into the FMU its name is written to a file, so that
the process that started this one can say in which call it ended.
"""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Sequence
from ctypes import CFUNCTYPE, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from functools import cached_property
from pathlib import Path
from typing import Any

from harness.validation.checks import Failure, Skip
from harness.validation.interface import SIGNATURES, FmiStatus

CO_SIMULATION = 1
STEPS = 40
"""Steps of a run that results are compared over."""
_WIDTH = 200
"""Characters of what is being done."""
_AMPLITUDE = 1e-3
"""Of the motion of an input, relative to its start value or nominal value."""

Bits = tuple[bytes, ...]
"""Values of variables as they lie in memory, so that equal means bit for bit equal."""

_LOGGER = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_void_p)
_ALLOCATE = CFUNCTYPE(c_void_p, c_size_t, c_size_t)
_FREE = CFUNCTYPE(None, c_void_p)
_FINISHED = CFUNCTYPE(None, c_void_p, c_int)


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", c_void_p),
        ("allocateMemory", c_void_p),
        ("freeMemory", c_void_p),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    )


class Host:
    """Knowledge of the FMU, and tools that all probes share.

    Attributes:
        facts: of the description, and paths, as made by `harness.validation.running`.
        messages: (environment, instance name, status, category, text) of the logger, in order.
    """

    def __init__(self, facts: dict[str, Any], doing: Path) -> None:
        self.facts = facts
        self.messages: list[tuple[int, bytes | None, int, bytes | None, bytes | None]] = []
        # Text at the start of a file: what is being done, for the other process.
        self._doing = doing.open("wb", buffering=0)
        self._said = ""
        self._library: Library | None = None
        self._alive = (_LOGGER(self._log), _libc().calloc, _libc().free)
        self._proxy: Any = None

    def _log(
        self,
        environment: int | None,
        name: bytes | None,
        status: int,
        category: bytes | None,
        message: bytes | None,
        _: Any,
    ) -> None:
        self.messages.append((environment or 0, name, status, category, message))

    def said(self) -> str:
        """Return the last message, for the end of a sentence."""
        texts = [
            text for *_, status, _, text in self.messages if text and status >= FmiStatus.Warning
        ]
        return f" ({texts[-1].decode('utf-8', 'replace').strip()})" if texts else ""

    def doing(self, text: str) -> None:
        """Write what is being done, in case this process does not live to tell.

        What begins with the name of a function stays until another one is called.
        """
        self._said = text
        self._doing.seek(0)
        self._doing.write(text.encode()[:_WIDTH].ljust(_WIDTH))

    def calling(self, name: str) -> None:
        """Write the call of a function, unless more is known about it."""
        if not self._said.startswith(name):
            self.doing(name)

    @property
    def library(self) -> Library:
        """Binary of the FMU, loaded once."""
        if self._library is None:
            self._library = Library(self, self.facts["library"])
        return self._library

    def callbacks(self, environment: int = 0, logger: bool = True) -> Callbacks:
        """Return callback functions; fmpy's native proxy puts in the logger's arguments."""
        callbacks = Callbacks()
        log, allocate, release = self._alive
        callbacks.logger = ctypes.cast(log, c_void_p).value if logger else None
        callbacks.allocateMemory = ctypes.cast(allocate, c_void_p).value
        callbacks.freeMemory = ctypes.cast(release, c_void_p).value
        callbacks.componentEnvironment = environment or None
        if logger and self.facts["proxy"]:
            self._proxy = self._proxy or ctypes.CDLL(self.facts["proxy"]).addLoggerProxy
            self._proxy.argtypes = [c_void_p]
            self._proxy.restype = None
            self._proxy(ctypes.byref(callbacks))
        return callbacks

    def variables(self, *types: str, **wanted: str) -> list[dict[str, Any]]:
        """Return variables of some types whose attributes are as wanted."""
        return [
            v
            for v in self.facts["variables"]
            if (not types or v["type"] in types)
            and all(v[key] == value for key, value in wanted.items())
        ]

    @cached_property
    def inputs(self) -> list[dict[str, Any]]:
        """Real inputs."""
        return self.variables("Real", causality="input")

    @cached_property
    def readable(self) -> dict[str, list[int]]:
        """Value references that are compared after each step, by type."""
        computed = ("output", "local", "calculatedParameter")
        return {
            kind: [v["reference"] for v in self.variables(kind) if v["causality"] in computed]
            for kind in ("Real", "Integer", "Boolean")
        }

    @property
    def step(self) -> float:
        """Communication step [s]."""
        return float(self.facts["step"])

    @property
    def begin(self) -> float:
        """Start time of a run [s]."""
        return float(self.facts["start"])

    def reference_run(self, count: int = STEPS) -> list[Bits]:
        """Run a fresh instance, undisturbed, and return its values."""
        slave = stepped(self)
        seen = slave.run(0, count)
        slave.free()
        return seen


class Library:
    """The functions of a binary."""

    def __init__(self, host: Host, path: str) -> None:
        host.doing("loading the binary")
        try:
            self.handle = ctypes.CDLL(path)
        except OSError as error:
            raise Failure(f"the binary does not load: {error}") from None
        self._functions: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        """Return a function of the standard.

        Raises:
            Skip: the binary does not export it.
        """
        if name not in SIGNATURES:
            raise AttributeError(name)
        if name not in self._functions:
            try:
                function = self.handle[name]
            except AttributeError:
                raise Skip(f"{name} is not exported") from None
            result, *arguments = SIGNATURES[name]
            function.restype, function.argtypes = result, arguments
            self._functions[name] = function
        return self._functions[name]


class FmuInstance:
    """One instance."""

    def __init__(
        self,
        host: Host,
        library: Library | None = None,
        name: Any = b"probe",
        environment: int = 0,
        logging: bool = False,
        resources: bytes | None = None,
        **more: Any,
    ) -> None:
        """Instantiate.

        Args:
            host: knows the FMU.
            library: a copy of the binary other than the host's.
            name: of the instance.
            environment: passed to the logger.
            logging: whether debug logging is on.
            resources: URI instead of the right one.
            **more: `guid`, `type`, `logger`.

        Raises:
            Failure: the FMU refuses.
        """
        self.host = host
        self.library = library or host.library
        self.callbacks = host.callbacks(environment, more.pop("logger", True))
        uri = host.facts["resources"].encode() if resources is None else resources
        self.component = self.attempt(
            host, self.library, name, self.callbacks, uri, logging, **more
        )
        if not self.component:
            raise Failure(f"fmi2Instantiate returned NULL{host.said()}")
        self._readable = {
            kind: _Buffer(kind, references) for kind, references in host.readable.items()
        }

    @staticmethod
    def attempt(
        host: Host,
        library: Library,
        name: Any,
        callbacks: Callbacks | None,
        resources: bytes | None = None,
        logging: bool = False,
        **more: Any,
    ) -> int | None:
        """Call fmi2Instantiate and return the component, or None."""
        host.calling("fmi2Instantiate")
        guid = more.pop("guid", host.facts["guid"].encode())
        kind = more.pop("type", CO_SIMULATION)
        assert not more, more
        pointer = ctypes.byref(callbacks) if callbacks is not None else None
        result: int | None = library.fmi2Instantiate(
            name, kind, guid, resources, pointer, 0, int(logging)
        )
        return result

    def call(self, name: str, *arguments: Any) -> FmiStatus:
        """Call a function with this component and return the status."""
        self.host.calling(name)
        status = int(getattr(self.library, name)(self.component, *arguments))
        if not FmiStatus.OK <= status <= FmiStatus.Pending:
            raise Failure(f"{name} returned {status}, which is no status")
        return FmiStatus(status)

    def need(self, name: str, *arguments: Any) -> None:
        """Call a function that has to succeed.

        Raises:
            Failure: it did not.
        """
        status = self.call(name, *arguments)
        if status > FmiStatus.Warning:
            raise Failure(f"{name} returned {status.name}{self.host.said()}")

    def setup(self, start: float | None = None, stop: float | None = None) -> None:
        """Call fmi2SetupExperiment."""
        start = self.host.begin if start is None else start
        self.need("fmi2SetupExperiment", 0, 0.0, start, int(stop is not None), stop or 0.0)

    def initialise(self, start: float | None = None, stop: float | None = None) -> None:
        """Bring a new instance to where it is ready to step."""
        self.setup(start, stop)
        self.need("fmi2EnterInitializationMode")
        self.need("fmi2ExitInitializationMode")

    def stimulate(self, k: int) -> None:
        """Give every Real input its value of step `k`: close to its start, within its limits."""
        for i, v in enumerate(self.host.inputs):
            self.need("fmi2SetReal", *reals(v, near_start(v, math.sin(0.1 * k + i))))

    def run(self, first: int, count: int, start: float | None = None) -> list[Bits]:
        """Step from step `first` on, the inputs in motion; values after each step."""
        start = self.host.begin if start is None else start
        seen = []
        for k in range(first, first + count):
            self.stimulate(k)
            self.need("fmi2DoStep", start + k * self.host.step, self.host.step, 1)
            seen.append(self.values())
        return seen

    def values(self) -> Bits:
        """Return all variables that can be read, as bits."""
        for kind, buffer in self._readable.items():
            if buffer.count:
                self.need(f"fmi2Get{kind}", *buffer.arguments)
        return tuple(bytes(buffer.values) for buffer in self._readable.values())

    def get(self, variable: dict[str, Any]) -> Any:
        """Return value of one Real, Integer or Boolean variable."""
        buffer = _Buffer(variable["type"], [variable["reference"]])
        self.need(f"fmi2Get{variable['type']}", *buffer.arguments)
        return buffer.values[0]

    def set_to(self, variable: dict[str, Any], value: Any) -> FmiStatus:
        """Set one variable; returns the status."""
        buffer = _Buffer(variable["type"], [variable["reference"]])
        buffer.values[0] = value
        return self.call(f"fmi2Set{variable['type']}", *buffer.arguments)

    def state(self) -> c_void_p:
        """Get the state of the instance now."""
        state = c_void_p()
        self.need("fmi2GetFMUstate", ctypes.byref(state))
        if not state:
            raise Failure("fmi2GetFMUstate returned OK and no state")
        return state

    def restore(self, state: c_void_p) -> None:
        """Set the instance back to a state."""
        self.need("fmi2SetFMUstate", state)

    def forget(self, state: c_void_p) -> None:
        """Free a state."""
        self.need("fmi2FreeFMUstate", ctypes.byref(state))

    def free(self) -> None:
        """Call fmi2FreeInstance."""
        self.host.doing("fmi2FreeInstance")
        self.library.fmi2FreeInstance(self.component)
        self.component = None


def stepped(host: Host, steps: int = 0, **more: Any) -> FmuInstance:
    """Return an instance that is initialised and has made some steps; see `FmuInstance`."""
    slave = FmuInstance(host, **more)
    slave.initialise()
    slave.run(0, steps)
    return slave


def initialising(host: Host, start: float | None = None) -> FmuInstance:
    """Return an instance in initialisation mode."""
    slave = FmuInstance(host)
    slave.setup(start)
    slave.need("fmi2EnterInitializationMode")
    return slave


class _Buffer:
    """Arguments of a get or set of several variables."""

    def __init__(self, kind: str, references: Sequence[int]) -> None:
        self.count = len(references)
        self.references = (c_uint * self.count)(*references)
        self.values: Any = ((c_double if kind == "Real" else c_int) * self.count)()
        self.arguments = (self.references, c_size_t(self.count), self.values)


def reals(variable: dict[str, Any], value: float) -> tuple[Any, ...]:
    """Return arguments of a set of one Real variable."""
    buffer = _Buffer("Real", [variable["reference"]])
    buffer.values[0] = value
    return buffer.arguments


def near_start(variable: dict[str, Any], share: float) -> float:
    """Return a value of an input close to its start; `share`, -1 to 1, is how far to go."""
    start = float(variable["start"] or 0.0)
    reach = _AMPLITUDE * float(variable["nominal"] or abs(start) or 1.0)
    return min(max(start + share * reach, variable["low"]), variable["high"])


def number(bits: Bits) -> list[float]:
    """Return the Real values."""
    return list(struct.unpack(f"{len(bits[0]) // 8}d", bits[0]))


def compare(left: Sequence[Bits], right: Sequence[Bits], what: str) -> list[str]:
    """Return a list of no sentence, or of one that says where two runs part."""
    for k, (one, other) in enumerate(zip(left, right, strict=True)):
        if one != other:
            return [f"{what}: not the same from step {k + 1} of {len(left)} on"]
    return []


def _libc() -> Any:
    libc = ctypes.CDLL(None) if not hasattr(ctypes, "WinDLL") else ctypes.CDLL("msvcrt")
    libc.calloc.restype = c_void_p
    libc.calloc.argtypes = [c_size_t, c_size_t]
    libc.free.argtypes = [c_void_p]
    libc.free.restype = None
    return libc
