"""Frames on a CAN transport between two processes: time on the way, losses, cost of a `send`."""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.can.precise_sleep import sleep_until
from harness.common.figures import Figure

__all__ = ["NAMES", "figures"]

NAMES = ("virtual", "unixbus", "slcanbulk", "slcan")
_IDENTIFIERS = (0x110, 0x111, 0x112)
_LAST = 0x7FF
_PERIOD = 1_000_000  # ns
_QUIET = 10.0  # s without a frame that a receiver takes for the end


def figures(name: str, folder: Path, seconds: float) -> Iterator[Figure]:
    """Send the frames of samples at 1 kHz, and yield what that costs.

    Args:
        name: of the transport.
        folder: for its sockets and terminals.
        seconds: how long frames are sent [s].

    Raises:
        SteadytipError: there is no such transport here.
    """
    import can

    if sys.platform == "win32":
        raise SteadytipError(f"{name}: there are neither Unix sockets nor terminals here")
    mine, theirs = _ends(name, folder)
    with can.Bus(**mine) as bus, _receiver(name, theirs) as received:
        sent, cost = _send_samples(bus, seconds)
        found = received()
    setting = f"{name}, 3 frames a sample at 1 kHz, {seconds:g} s"
    for quantity, unit, value in (
        ("frame on the way, median", "us", found["p50"]),
        ("frame on the way, 99 %", "us", found["p99"]),
        ("send", "us", cost),
        ("receiver's share of a core", "%", found["share"]),
        ("lost frames", "", sent - found["count"]),
    ):
        yield Figure("steadytip bench bus", quantity, unit, None, value, setting)


def _ends(name: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return options of python-can for sender and receiver."""
    if name in ("virtual", "unixbus"):
        both = {"interface": name, "channel": str(folder)}
        return both, both
    line = str(folder / "tty")
    mine = {"interface": "slcanbulk", "channel": f"pty:{line}", "device": True}
    theirs = {"interface": name, "channel": line, "bitrate": 1_000_000}
    # That of python-can waits two seconds for adapters that begin anew when they are opened.
    return mine, theirs | ({"sleep_after_open": 0} if name == "slcan" else {})


@contextmanager
def _receiver(name: str, options: dict[str, Any]) -> Iterator[Callable[[], dict[str, float]]]:
    """Start a receiver; its result is what it has received."""
    here, there = multiprocessing.Pipe()
    if name == "virtual":  # knows no other process
        runner: Any = threading.Thread(
            target=_listen_on_own_bus, args=(options, there, time.thread_time), daemon=True
        )
    else:
        runner = multiprocessing.get_context("spawn").Process(
            target=_listen_on_own_bus, args=(options, there, time.process_time), daemon=True
        )
    runner.start()
    assert here.recv() == "ready"
    yield here.recv
    runner.join()


def _listen_on_own_bus(options: dict[str, Any], out: Connection, cpu: Callable[[], float]) -> None:
    import can

    with can.Bus(**options) as bus:
        out.send("ready")
        out.send(_listen(bus, cpu))


def _listen(bus: Any, cpu: Callable[[], float]) -> dict[str, float]:
    """Receive until the last frame: count, times on the way [us], share of a core [%]."""
    ways: list[int] = []
    begun, used = time.monotonic_ns(), cpu()
    while (message := bus.recv(_QUIET)) is not None and message.arbitration_id != _LAST:
        now = time.monotonic_ns()
        if not ways:
            begun, used = now, cpu()
        ways.append(now - int.from_bytes(message.data, "little"))
    share = 1e11 * (cpu() - used) / (time.monotonic_ns() - begun)
    p50, p99 = 1e-3 * np.percentile(ways or [0], [50, 99])
    return {"count": len(ways), "p50": float(p50), "p99": float(p99), "share": share}


def _send_samples(bus: Any, seconds: float) -> tuple[int, float]:
    """Send the samples on time; how many frames, and the median cost of a `send` [us]."""
    import can

    costs = []
    begun = time.monotonic_ns()
    for k in range(round(1e3 * seconds)):
        sleep_until(begun + _PERIOD * k)
        for identifier in _IDENTIFIERS:
            now = time.monotonic_ns()
            data = now.to_bytes(8, "little")
            bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
            costs.append(time.monotonic_ns() - now)
        bus.recv(0)
    time.sleep(0.1)
    bus.send(can.Message(arbitration_id=_LAST, is_extended_id=False))
    return len(costs), 1e-3 * float(np.median(costs))
