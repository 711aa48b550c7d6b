"""States that are saved, restored and serialised: item D11."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from ctypes import c_size_t, c_void_p

from harness.validation.checks import PROBES, Failure, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import STEPS, FmuInstance, Host, compare, stepped
from harness.validation.probes.process import resident

_FLIPS = 4000
"""Bits of a serialised state that are flipped one at a time; spread over it evenly."""
_ENOUGH = 20
"""Flipped bits that are accepted, after which no more are tried."""
_MANY = 10_000
_GROWTH = 2**20
"""What many gets and sets may leave behind [byte]; a small state leaked each time is more."""


def _under_way(host: Host) -> FmuInstance:
    if not host.facts["has_state"]:
        raise Skip("canGetAndSetFMUstate is false")
    return stepped(host, STEPS)


@PROBES.check("D11.replay", "error", "a run from a restored state is the same bit for bit")
def _replay(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    state = slave.state()
    first = slave.run(STEPS, STEPS)
    slave.restore(state)
    yield from compare(slave.run(STEPS, STEPS), first, "from a restored state")
    slave.restore(state)
    yield from compare(slave.run(STEPS, STEPS), first, "from a state restored twice")


@PROBES.check("D11.freed", "error", "a state that is freed has NULL as its handle")
def _freed(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    state = slave.state()
    slave.forget(state)
    if state:
        yield "fmi2FreeFMUstate does not set the handle to NULL"


@PROBES.check("D11.values", "error", "restoring a state brings back what is read, without a step")
def _values(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    before = slave.values()
    state = slave.state()
    slave.run(STEPS, 3)
    slave.restore(state)
    yield from compare([slave.values()], [before], "values right after fmi2SetFMUstate")


@PROBES.check("D11.after_reset", "error", "a state can be restored after fmi2Reset")
def _after_reset(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    state = slave.state()
    first = slave.run(STEPS, STEPS)
    slave.need("fmi2Reset")
    slave.restore(state)
    yield from compare(slave.run(STEPS, STEPS), first, "restored after fmi2Reset")


@PROBES.check("D11.other_instance", "warning", "a state can be restored in another instance")
def _other_instance(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    state = slave.state()
    first = slave.run(STEPS, STEPS)
    other = stepped(host, name=b"other")
    other.restore(state)
    yield from compare(other.run(STEPS, STEPS), first, "restored in another instance")


@PROBES.check("D11.null", "warning", "NULL handles are refused, freeing NULL is OK")
def _null(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    nothing = c_void_p()
    for name, arguments, refused in (
        ("fmi2SetFMUstate", (None,), True),
        ("fmi2GetFMUstate", (None,), True),
        ("fmi2FreeFMUstate", (ctypes.byref(nothing),), False),
        ("fmi2FreeFMUstate", (None,), None),
    ):
        host.doing(f"{name} with NULL")
        status = slave.call(name, *arguments)
        if status == FmiStatus.Fatal or (
            refused is not None and (status >= FmiStatus.Discard) != refused
        ):
            yield f"{name} with NULL returned {status.name}"


@PROBES.check("D11.growth", "warning", "getting and setting states many times takes no more memory")
def _growth(host: Host) -> Iterator[str]:
    slave = _under_way(host)
    kept = slave.state()

    def use(times: int) -> None:
        for _ in range(times):
            slave.need("fmi2GetFMUstate", ctypes.byref(kept))
            slave.restore(kept)
            other = slave.state()
            slave.forget(other)

    use(_MANY // 10)
    before = resident()
    use(_MANY)
    grown = resident() - before
    yield Note(f"{_MANY} times: {grown / 1024:.0f} KiB")
    if grown > _GROWTH:
        yield f"{_MANY} gets, sets and frees of a state left {grown / 1024:.0f} KiB behind"


# ---- Serialised ---------------------------------------------------------------------------------


def _bytes(slave: FmuInstance, state: c_void_p) -> bytes:
    size = c_size_t(0)
    slave.need("fmi2SerializedFMUstateSize", state, ctypes.byref(size))
    buffer = ctypes.create_string_buffer(size.value)
    slave.need("fmi2SerializeFMUstate", state, buffer, size)
    return buffer.raw


def _serialising(host: Host) -> tuple[FmuInstance, bytes]:
    slave = _under_way(host)
    if not host.facts["can_serialise"]:
        raise Skip("canSerializeFMUstate is false")
    return slave, _bytes(slave, slave.state())


def _revive(slave: FmuInstance, content: bytes) -> tuple[FmiStatus, c_void_p]:
    state = c_void_p()
    status = slave.call(
        "fmi2DeSerializeFMUstate", content, c_size_t(len(content)), ctypes.byref(state)
    )
    return status, state


@PROBES.check("D11.serialised", "error", "a serialised state revives in another instance")
def _serialised(host: Host) -> Iterator[str]:
    slave, content = _serialising(host)
    if _bytes(slave, slave.state()) != content:
        yield "the same state serialised twice gives different bytes"
    first = slave.run(STEPS, STEPS)
    other = stepped(host, name=b"other")
    status, state = _revive(other, content)
    if status > FmiStatus.Warning:
        raise Failure(f"fmi2DeSerializeFMUstate returned {status.name}{host.said()}")
    other.restore(state)
    yield from compare(other.run(STEPS, STEPS), first, "from a serialised state")
    yield Note(f"{len(content)} bytes")


@PROBES.check("D11.damaged", "warning", "a damaged serialised state is refused, nothing changes")
def _damaged(host: Host) -> Iterator[str]:
    slave, content = _serialising(host)
    before = slave.values()
    bits = len(content) * 8
    accepted: list[int] = []
    n = 0
    for n in range(min(_FLIPS, bits)):
        # An odd stride through all bits: neighbours differ in their place within the byte.
        at = n if bits <= _FLIPS else n * (bits // _FLIPS | 1) % bits
        damaged = bytearray(content)
        damaged[at // 8] ^= 1 << at % 8
        host.doing(f"fmi2DeSerializeFMUstate with bit {at % 8} of byte {at // 8} flipped")
        status, state = _revive(slave, bytes(damaged))
        if status <= FmiStatus.Warning:
            accepted.append(at // 8)
            host.doing(f"fmi2SetFMUstate of a state with bit {at % 8} of byte {at // 8} flipped")
            if state and slave.call("fmi2SetFMUstate", state) <= FmiStatus.Warning:
                # What a damaged state gives need not be sound, but must not end the process.
                with contextlib.suppress(Failure):
                    slave.values()
            if len(accepted) == _ENOUGH:
                break
            slave, _ = _serialising(host)
    if accepted:
        yield (
            f"{len(accepted)} of {n + 1} flipped bits are accepted, "
            f"the first in byte {accepted[0]} of {len(content)}"
        )
    else:
        yield from compare([slave.values()], [before], "values after refused states")
        slave.run(STEPS, 1)


@PROBES.check("D11.length", "error", "a serialised state of a wrong length is refused")
def _length(host: Host) -> Iterator[str]:
    slave, content = _serialising(host)
    for what, wrong in (
        ("empty", b""),
        ("of one byte", content[:1]),
        ("cut in half", content[: len(content) // 2]),
        ("one byte short", content[:-1]),
        ("one byte long", content + b"\0"),
        ("of zeros", bytes(len(content))),
    ):
        host.doing(f"fmi2DeSerializeFMUstate with a state {what}")
        status, _ = _revive(slave, wrong)
        if status <= FmiStatus.Warning:
            yield f"a serialised state {what} is accepted"
