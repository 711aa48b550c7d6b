"""Time: items D8, D9, D17."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Iterator
from ctypes import c_double, c_int
from functools import partial

from harness.validation.checks import PROBES, Failure, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import STEPS, FmuInstance, Host, compare, number, stepped

_LAST_SUCCESSFUL_TIME = 2
_LONG = 8
"""Short steps that a long one is made of."""
_CLOSE = 1e-6
"""Relative difference of one long step from many short ones."""
_COSTED = 2000


def _bad_step(host: Host, h: float) -> Iterator[str]:
    slave = stepped(host)
    seen = slave.run(0, 3)
    t = host.begin + 3 * host.step
    host.doing(f"fmi2DoStep with a step of {h} s")
    status = slave.call("fmi2DoStep", t, h, 1)
    if status <= FmiStatus.Warning:
        yield f"a communication step of {h} s returned {status.name}"
        return
    yield from _goes_on(host, slave, seen, f"after a step of {h} s was refused")


def _goes_on(
    host: Host, slave: FmuInstance, seen: list[tuple[bytes, ...]], what: str
) -> Iterator[str]:
    """Note if a refused step has changed the FMU."""
    try:
        after = slave.run(len(seen), 3)
    except Failure as failure:
        yield Note(f"{what} the FMU does not step on: {failure}")
        return
    for text in compare([*seen, *after], host.reference_run(len(seen) + 3), what):
        yield Note(text)


for _id, _h in (
    *(("nan", math.nan), ("inf", math.inf), ("minus_inf", -math.inf)),
    *(("zero", 0.0), ("negative", -1e-3)),
):
    PROBES.check(f"D8.step_{_id}", "warning", f"refuses a communication step of {_h} s")(
        partial(_bad_step, h=_h)
    )


@PROBES.check("D8.step_huge", "warning", "any finite step ends in bounded time")
def _huge(host: Host) -> Iterator[str]:
    for h in (1e9, 1e300):
        slave = stepped(host)
        host.doing(f"fmi2DoStep with a step of {h:g} s")
        begun = time.monotonic()
        status = slave.call("fmi2DoStep", host.begin, h, 1)
        yield Note(f"{h:g} s: {status.name} after {time.monotonic() - begun:.2g} s")
        if status == FmiStatus.Discard:
            last = c_double(math.nan)
            status = slave.call("fmi2GetRealStatus", _LAST_SUCCESSFUL_TIME, ctypes.byref(last))
            if status != FmiStatus.OK or not math.isfinite(last.value):
                yield "after Discard fmi2GetRealStatus gives no last successful time"


@PROBES.check("D8.wrong_time", "warning", "refuses a step that does not begin where the last ended")
def _wrong_time(host: Host) -> Iterator[str]:
    for what, t in (
        *(("NaN", math.nan), ("in the future", host.begin + 50 * host.step)),
        ("in the past", host.begin - 2 * host.step),
    ):
        slave = stepped(host, 3)
        host.doing(f"fmi2DoStep at t = {t} s")
        if slave.call("fmi2DoStep", t, host.step, 1) <= FmiStatus.Warning:
            yield f"a step at t = {t:g} s ({what}) is taken, the last one ended elsewhere"


@PROBES.check("D8.stop", "error", "refuses to step past the stop time")
def _stop(host: Host) -> Iterator[str]:
    slave = FmuInstance(host)
    slave.initialise(stop=host.begin + 5 * host.step)
    slave.run(0, 5)
    status = slave.call("fmi2DoStep", host.begin + 5 * host.step, host.step, 1)
    if status <= FmiStatus.Warning:
        yield "a step past the stop time of fmi2SetupExperiment is taken"


@PROBES.check("D8.start", "error", "starts at any time, also a negative one")
def _start(host: Host) -> Iterator[str]:
    for start in (-3.25, 17.5, 1e5):
        slave = FmuInstance(host)
        try:
            slave.initialise(start=start)
            slave.run(0, 3, start)
        except Failure as failure:
            yield f"with a start time of {start:g} s: {failure}"


@PROBES.check("D8.rounding", "error", "accepts times that are added up as well as multiplied")
def _rounding(host: Host) -> Iterator[str]:
    for way in ("sum of", "product with"):
        slave = stepped(host)
        t = host.begin
        for k in range(_COSTED):
            status = slave.call("fmi2DoStep", t, host.step, 1)
            if status > FmiStatus.Warning:
                yield (
                    f"step {k + 1} at t = {t!r} s, the {way} {k} steps, "
                    f"returned {status.name}{host.said()}"
                )
                break
            t = t + host.step if way == "sum of" else host.begin + (k + 1) * host.step


@PROBES.check("D8.one_long", "warning", "one long step is as many short ones, inputs held")
def _one_long(host: Host) -> Iterator[str]:
    if not host.facts["variable_step"]:
        raise Skip("canHandleVariableCommunicationStepSize is false")
    short, long = FmuInstance(host), FmuInstance(host)
    for slave in (short, long):
        slave.initialise()
        slave.run(0, 3)
        slave.stimulate(5)
    for k in range(_LONG):
        short.need("fmi2DoStep", host.begin + (3 + k) * host.step, host.step, 1)
    long.need("fmi2DoStep", host.begin + 3 * host.step, _LONG * host.step, 1)
    one, other = number(short.values()), number(long.values())
    scale = max((abs(v) for v in one if math.isfinite(v)), default=1.0)
    worst = max((abs(a - b) for a, b in zip(one, other, strict=True)), default=0.0)
    if worst > _CLOSE * scale:
        yield f"{_LONG} steps of {host.step:g} s and one as long as they part by {worst:g}"
    if one == other:
        yield Note("bit for bit")


@PROBES.check("D8.no_set_state", "error", "noSetFMUStatePriorToCurrentPoint changes no result")
def _no_set_state(host: Host) -> Iterator[str]:
    slave = stepped(host)
    seen = []
    for k in range(STEPS):
        slave.stimulate(k)
        slave.need("fmi2DoStep", host.begin + k * host.step, host.step, 0)
        seen.append(slave.values())
    yield from compare(seen, host.reference_run(), "with noSetFMUStatePriorToCurrentPoint = false")


@PROBES.check("D9.status", "error", "functions that ask for a status answer")
def _status(host: Host) -> Iterator[str]:
    slave = stepped(host, 2)
    value = c_int(-1)
    for name in ("fmi2GetStatus", "fmi2GetIntegerStatus", "fmi2GetBooleanStatus"):
        for kind in range(4):
            host.doing(f"{name}({kind})")
            slave.call(name, kind, ctypes.byref(value))
    last = c_double(math.nan)
    if slave.call("fmi2GetRealStatus", _LAST_SUCCESSFUL_TIME, ctypes.byref(last)) == FmiStatus.OK:
        wanted = host.begin + 2 * host.step
        if not math.isclose(last.value, wanted, rel_tol=1e-9, abs_tol=1e-12):
            yield f"the last successful time is {last.value!r} s, it should be {wanted!r} s"


@PROBES.check("D17.cost", "info", "cost of a step")
def _cost(host: Host) -> Iterator[str]:
    slave = stepped(host)
    step, component, h = host.library.fmi2DoStep, slave.component, host.step
    spent = []
    for k in range(_COSTED):
        t = host.begin + k * h
        since = time.perf_counter()
        status = step(component, t, h, 1)
        spent.append(time.perf_counter() - since)
        if status > FmiStatus.Warning:
            raise Failure(f"step {k + 1} returned {FmiStatus(status).name}{host.said()}")
    spent.sort()
    yield Note(
        f"fmi2DoStep of {h:g} s: median {spent[_COSTED // 2] * 1e6:.2f} us, "
        f"worst of {_COSTED} {spent[-1] * 1e6:.1f} us, the call from Python among it"
    )
