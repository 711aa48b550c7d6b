"""The state machine of FMI 2.0.5, 4.2.4: items D5, D12."""

from __future__ import annotations

import ctypes
import math
import random
from collections.abc import Callable, Iterator
from ctypes import c_double, c_int, c_size_t

from harness.validation.checks import PROBES, Failure, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import (
    STEPS,
    Bits,
    FmuInstance,
    Host,
    compare,
    initialising,
    reals,
    stepped,
)

_CALLS_OF_A_WALK = 400
_WALKS = 5


def _stepping(host: Host) -> FmuInstance:
    return stepped(host, 2)


def _terminated(host: Host) -> FmuInstance:
    slave = _stepping(host)
    slave.need("fmi2Terminate")
    return slave


_STATES: dict[str, Callable[[Host], FmuInstance]] = {
    "instantiated": FmuInstance,
    "initialisation mode": initialising,
    "step mode": _stepping,
    "terminated": _terminated,
}
_ALL = frozenset(_STATES)


class _Calls:
    """Every function that needs no state handle, with arguments that are right as such."""

    def __init__(self, host: Host) -> None:
        self._host = host
        inputs = host.inputs
        outputs = host.variables("Real", causality="output")
        self.input = inputs[0] if inputs else None
        self.output = outputs[0] if outputs else None
        self.time = host.begin + 2 * host.step
        self.legal: dict[str, frozenset[str]] = {
            "fmi2SetDebugLogging": _ALL,
            "fmi2SetupExperiment": frozenset({"instantiated"}),
            "fmi2EnterInitializationMode": frozenset({"instantiated"}),
            "fmi2ExitInitializationMode": frozenset({"initialisation mode"}),
            "fmi2Terminate": frozenset({"step mode"}),
            "fmi2Reset": _ALL,
            "fmi2DoStep": frozenset({"step mode"}),
            "fmi2CancelStep": frozenset(),
        }
        if self.output:
            self.legal["fmi2GetReal"] = _ALL - {"instantiated"}
        if self.input:
            self.legal["fmi2SetReal"] = _ALL - {"terminated"}

    def make(self, slave: FmuInstance, name: str) -> FmiStatus:
        host = self._host
        if name == "fmi2SetDebugLogging":
            return slave.call(name, 0, c_size_t(0), None)
        if name == "fmi2SetupExperiment":
            return slave.call(name, 0, 0.0, host.begin, 0, 0.0)
        if name == "fmi2DoStep":
            return slave.call(name, self.time, host.step, 1)
        if name == "fmi2SetReal":
            assert self.input is not None
            return slave.call(name, *reals(self.input, float(self.input["start"] or 0.0)))
        if name == "fmi2GetReal":
            assert self.output is not None
            return slave.call(name, *reals(self.output, 0.0))
        return slave.call(name)


@PROBES.check("D5.legal", "error", "every call that a state allows is OK")
def _legal(host: Host) -> Iterator[str]:
    calls = _Calls(host)
    for name, states in calls.legal.items():
        for state in _STATES:
            if state not in states or name == "fmi2ExitInitializationMode":
                continue
            slave = _STATES[state](host)
            status = calls.make(slave, name)
            if status > FmiStatus.Warning:
                yield f"{name} when {state} returned {status.name}{host.said()}"
            slave.free()


@PROBES.check("D5.illegal", "warning", "every call that a state forbids is refused")
def _illegal(host: Host) -> Iterator[str]:
    calls = _Calls(host)
    changed = 0
    for name, states in calls.legal.items():
        for state, make in _STATES.items():
            if state in states:
                continue
            slave = make(host)
            host.doing(f"{name} when {state}")
            status = calls.make(slave, name)
            if status < FmiStatus.Discard:
                yield f"{name} when {state} returned {status.name}"
            elif status == FmiStatus.Fatal:
                yield f"{name} when {state} returned Fatal"
                continue
            elif state == "step mode":
                try:
                    changed += slave.run(2, 3) != host.reference_run(5)[2:]
                except Failure:
                    changed += 1
            slave.free()
    if changed:
        yield Note(f"{changed} refused calls did not leave the state as it was")


@PROBES.check("D5.null", "warning", "a NULL component or NULL arrays are refused")
def _null(host: Host) -> Iterator[str]:
    slave = _stepping(host)
    for verb in ("Get", "Set"):
        host.doing(f"fmi2{verb}Real with NULL arrays")
        if slave.call(f"fmi2{verb}Real", None, c_size_t(1), None) < FmiStatus.Discard:
            yield f"fmi2{verb}Real of one variable with NULL arrays is OK"
    slave.free()
    for name, arguments in (
        ("fmi2Terminate", ()),
        ("fmi2Reset", ()),
        ("fmi2DoStep", (host.begin, host.step, 1)),
        ("fmi2GetReal", (None, c_size_t(0), None)),
    ):
        host.doing(f"{name} with a NULL component")
        if getattr(host.library, name)(None, *arguments) < FmiStatus.Discard:
            yield f"{name} with a NULL component is OK"


@PROBES.check("D5.walk", "error", "random calls end neither in a crash nor in a hang")
def _walk(host: Host) -> Iterator[str]:
    calls = _Calls(host)
    reference = host.reference_run(STEPS)
    status_value, number = c_int(0), c_double(0.0)
    for seed in range(_WALKS):
        dice = random.Random(seed)
        slave = FmuInstance(host)
        past: list[str] = []
        steps = 0
        for _ in range(_CALLS_OF_A_WALK):
            # Often enough the next call of an orderly life, else the walk never leaves its start.
            name = dice.choice(
                [
                    *calls.legal,
                    *("fmi2EnterInitializationMode", "fmi2ExitInitializationMode"),
                    *(["fmi2DoStep"] * 4),
                    *("fmi2GetStatus", "fmi2GetRealStatus"),
                ]
            )
            past.append(name)
            host.doing(f"{name}, walk {seed}, after {' '.join(item[4:] for item in past[-8:-1])}")
            if name in {"fmi2GetStatus", "fmi2GetRealStatus"}:
                place = status_value if name == "fmi2GetStatus" else number
                status = int(
                    getattr(host.library, name)(
                        slave.component, dice.randrange(4), ctypes.byref(place)
                    )
                )
            elif name == "fmi2DoStep":
                t = host.begin + steps * host.step
                status = int(host.library.fmi2DoStep(slave.component, t, host.step, 1))
                steps += status <= FmiStatus.Warning
            else:
                status = int(calls.make(slave, name))
                steps = 0 if name == "fmi2Reset" else steps
            if status == FmiStatus.Fatal:
                yield f"walk {seed}: {name} returned Fatal after {' '.join(past[-4:])}"
                break
        else:
            slave.need("fmi2Reset")
            slave.initialise()
            yield from compare(slave.run(0, STEPS), reference, f"walk {seed}, after fmi2Reset")
            slave.free()


@PROBES.check("D12.reset", "error", "fmi2Reset gives a fresh instance, bit for bit")
def _reset(host: Host) -> Iterator[str]:
    reference = host.reference_run()
    slave = FmuInstance(host)
    for parameter in host.variables("Real", causality="parameter")[:1]:
        slave.set_to(parameter, float(parameter["start"] or 0.0))
    slave.initialise()
    slave.run(0, STEPS // 2)
    yield from _again(slave, reference, "in the midst of a run")
    slave.need("fmi2Terminate")
    yield from _again(slave, reference, "after fmi2Terminate")


@PROBES.check("D12.start_values", "error", "fmi2Reset brings back start values")
def _start_values(host: Host) -> Iterator[str]:
    moved = [
        v
        for v in host.variables("Real", causality="parameter")
        if v["start"] is not None and v["low"] <= 1.001 * v["start"] <= v["high"] and v["start"]
    ]
    if not moved:
        raise Skip("no Real parameter has room to move")
    slave = FmuInstance(host)
    changed = [v for v in moved if slave.set_to(v, 1.001 * v["start"]) <= FmiStatus.Warning]
    slave.need("fmi2Reset")
    slave.setup()
    slave.need("fmi2EnterInitializationMode")
    for variable in changed:
        if slave.get(variable) != variable["start"]:
            yield f"'{variable['name']}' keeps {slave.get(variable)!r} instead of its start value"


@PROBES.check("D12.after_error", "error", "fmi2Reset mends an instance that refused something")
def _reset_after_error(host: Host) -> Iterator[str]:
    reference = host.reference_run()
    slave = stepped(host, 3)
    host.doing("fmi2DoStep with a negative step")
    if slave.call("fmi2DoStep", host.begin + 3 * host.step, -1.0, 1) == FmiStatus.Fatal:
        raise Skip("a negative step is answered by Fatal")
    for variable in host.inputs[:1]:
        slave.set_to(variable, math.inf)
    yield from _again(slave, reference, "after an error")


def _again(slave: FmuInstance, reference: list[Bits], when: str) -> Iterator[str]:
    slave.need("fmi2Reset")
    slave.initialise()
    yield from compare(slave.run(0, len(reference)), reference, f"after fmi2Reset {when}")
