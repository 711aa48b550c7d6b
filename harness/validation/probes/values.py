"""Values: items C10, D6, D7, D10."""

from __future__ import annotations

import math
from collections.abc import Iterator
from ctypes import c_double, c_size_t, c_uint
from functools import partial
from typing import Any

from harness.validation.checks import PROBES, Failure, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import (
    STEPS,
    FmuInstance,
    Host,
    compare,
    initialising,
    number,
    stepped,
)


@PROBES.check("C10.starts", "error", "start values of the XML are those of the binary")
def _starts(host: Host) -> Iterator[str]:
    slave = initialising(host)
    for variable in host.variables("Real", "Integer", "Boolean"):
        if variable["start"] is None or variable["initial"] == "approx":
            continue
        found, wanted = slave.get(variable), variable["start"]
        if variable["type"] == "Boolean":
            found, wanted = bool(found), bool(wanted)
        if found != wanted and not (found != found and wanted != wanted):
            name = variable["name"]
            yield f"'{name}' starts at {wanted!r} in the XML, at {found!r} in the binary"


@PROBES.check("D6.nothing", "error", "get and set of no variables, with NULL arrays, are OK")
def _nothing(host: Host) -> Iterator[str]:
    slave = stepped(host)
    for kind in ("Real", "Integer", "Boolean"):
        for verb in ("Get", "Set"):
            status = slave.call(f"fmi2{verb}{kind}", None, c_size_t(0), None)
            if status > FmiStatus.Warning:
                yield f"fmi2{verb}{kind} of no variables returned {status.name}"


@PROBES.check("D6.unknown", "error", "unknown value references are refused")
def _unknown(host: Host) -> Iterator[str]:
    known = {v["reference"] for v in host.facts["variables"]}
    reference = next(r for r in (4294967295, 4294967294, 4294967293) if r not in known)
    for verb in ("Get", "Set"):
        for kind in ("Real", "Integer", "Boolean"):
            slave = stepped(host)
            references, values = (c_uint * 1)(reference), (c_double * 1)(0.0)
            status = slave.call(f"fmi2{verb}{kind}", references, c_size_t(1), values)
            if status < FmiStatus.Discard:
                yield (
                    f"fmi2{verb}{kind} with the unknown value reference {reference} "
                    f"returned {status.name}"
                )


@PROBES.check("D6.computed", "warning", "what the FMU computes cannot be set")
def _computed(host: Host) -> Iterator[str]:
    for causality in ("output", "calculatedParameter"):
        for variable in host.variables("Real", causality=causality)[:1]:
            slave = stepped(host)
            status = slave.set_to(variable, slave.get(variable))
            if status < FmiStatus.Discard:
                yield f"{causality} '{variable['name']}' can be set between steps"


@PROBES.check("D6.atomic", "warning", "a set that is refused in part changes nothing")
def _atomic(host: Host) -> Iterator[str]:
    inputs = host.inputs
    if not inputs:
        raise Skip("there is no Real input")
    slave = stepped(host)
    slave.stimulate(3)
    before = slave.get(inputs[0])
    references = (c_uint * 2)(inputs[0]["reference"], inputs[-1]["reference"])
    values = (c_double * 2)(_other(inputs[0], before), math.nan)
    status = slave.call("fmi2SetReal", references, c_size_t(2), values)
    if status < FmiStatus.Discard:
        raise Skip("no value is refused")
    after = slave.get(inputs[0])
    if after != before:
        yield (
            f"'{inputs[-1]['name']}' = nan was refused, yet '{inputs[0]['name']}' in the same call "
            f"went from {before!r} to {after!r}"
        )


def _other(variable: dict[str, Any], value: float) -> float:
    """Return another legal value."""
    near = min(max(value + 1e-6 * (abs(value) or 1.0), variable["low"]), variable["high"])
    return near if near != value else value - 1e-6 * (abs(value) or 1.0)


# ---- Bad values at inputs -----------------------------------------------------------------------


def _bad_input(host: Host, bad: float) -> Iterator[str]:
    """Give each input in turn the bad value; the outputs have to stay sound."""
    inputs = host.inputs
    if not inputs:
        raise Skip("there is no Real input")
    reference = host.reference_run()
    refused = 0
    for variable in inputs:
        slave = stepped(host)
        seen = slave.run(0, STEPS // 2)
        host.doing(f"fmi2SetReal of '{variable['name']}' = {bad}")
        status = slave.set_to(variable, bad)
        if status == FmiStatus.Fatal:
            yield f"'{variable['name']}' = {bad} is answered by Fatal"
            continue
        if status >= FmiStatus.Discard:
            refused += 1
            if status == FmiStatus.Discard:
                seen += slave.run(STEPS // 2, STEPS - STEPS // 2)
                yield from compare(
                    seen, reference, f"after '{variable['name']}' = {bad} was refused"
                )
        else:
            yield from _swallowed(host, slave, variable, bad)
        slave.free()
    yield Note(f"{refused} of {len(inputs)} inputs refuse {bad}")


def _swallowed(
    host: Host, slave: FmuInstance, variable: dict[str, Any], bad: float
) -> Iterator[str]:
    what = f"'{variable['name']}' = {bad}"
    host.doing(f"fmi2DoStep after {what} was accepted")
    if (
        slave.call("fmi2DoStep", host.begin + STEPS // 2 * host.step, host.step, 1)
        > FmiStatus.Warning
    ):
        yield f"{what} is accepted, and fails only in the step after"
        return
    unsound = [
        v["name"]
        for v in host.variables("Real", causality="output")
        if not math.isfinite(slave.get(v))
    ]
    if unsound:
        yield f"{what} goes through to the outputs {', '.join(unsound[:4])}"


for _id, _bad in (("nan", math.nan), ("inf", math.inf), ("huge", 1e300)):
    PROBES.check(f"D7.{_id}", "warning", f"an input of {_bad} is refused or held, not passed on")(
        partial(_bad_input, bad=_bad)
    )


@PROBES.check("D7.range", "warning", "inputs and parameters outside their limits are refused")
def _range(host: Host) -> Iterator[str]:
    limited = [
        v
        for v in host.variables("Real", "Integer")
        if v["causality"] in {"input", "parameter"}
        and v["variability"] != "constant"
        and (math.isfinite(v["low"]) or math.isfinite(v["high"]))
    ]
    if not limited:
        raise Skip("nothing has limits")
    slave = FmuInstance(host)
    for variable in limited:
        for limit, away in ((variable["low"], -1), (variable["high"], 1)):
            bad = limit + away * (abs(limit) * 1e-6 + 1e-9 if variable["type"] == "Real" else 1)
            if not math.isfinite(limit) or (
                variable["type"] == "Integer" and not -(2**31) <= bad < 2**31
            ):
                continue
            value = bad if variable["type"] == "Real" else int(bad)
            status = slave.set_to(variable, value)
            if status < FmiStatus.Discard:
                yield (
                    f"'{variable['name']}' = {value!r} is accepted, its limits are "
                    f"[{variable['low']:g}, {variable['high']:g}]"
                )
            if status >= FmiStatus.Error:
                slave.free()
                slave = FmuInstance(host)


@PROBES.check("D7.outputs", "error", "outputs are finite and within their declared limits")
def _outputs(host: Host) -> Iterator[str]:
    slave = stepped(host)
    outputs = host.variables("Real", causality="output")
    found: set[str] = set()
    for k in range(5 * STEPS):
        bits = slave.run(k, 1)[0]
        if all(map(math.isfinite, number(bits))) and k % STEPS:
            continue
        for variable in outputs:
            value = slave.get(variable)
            if not variable["low"] <= value <= variable["high"] or not math.isfinite(value):
                if variable["name"] in found:
                    continue
                found.add(variable["name"])
                yield (
                    f"output '{variable['name']}' = {value!r} after step {k + 1}, its limits are "
                    f"[{variable['low']:g}, {variable['high']:g}]"
                )


# ---- Parameters ---------------------------------------------------------------------------------


@PROBES.check("D10.fixed", "error", "fixed parameters cannot be changed between steps")
def _fixed(host: Host) -> Iterator[str]:
    for variable in host.variables(
        "Real", "Integer", "Boolean", causality="parameter", variability="fixed"
    ):
        slave = stepped(host)
        status = slave.set_to(variable, slave.get(variable))
        slave.free()
        if status < FmiStatus.Discard:
            yield f"fixed parameter '{variable['name']}' can be set between steps"


@PROBES.check("D10.tunable", "error", "tunable parameters can be set between steps")
def _tunable(host: Host) -> Iterator[str]:
    tunable = host.variables(
        "Real", "Integer", "Boolean", causality="parameter", variability="tunable"
    )
    if not tunable:
        raise Skip("there is no tunable parameter")
    slave = stepped(host)
    for variable in tunable:
        status = slave.set_to(variable, slave.get(variable))
        if status != FmiStatus.OK:
            yield f"tunable parameter '{variable['name']}' is refused with {status.name}"


@PROBES.check("D6.settable", "error", "parameters and inputs can be set before initialisation")
def _settable(host: Host) -> Iterator[str]:
    slave = FmuInstance(host)
    for variable in host.variables("Real", "Integer", "Boolean"):
        if variable["causality"] not in {"parameter", "input"} or variable["start"] is None:
            continue
        status = slave.set_to(variable, variable["start"])
        if status > FmiStatus.Warning:
            yield f"'{variable['name']}' refuses its own start value with {status.name}"
    try:
        slave.initialise()
    except Failure as failure:
        yield f"initialisation with all start values set: {failure}"
