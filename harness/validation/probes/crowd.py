"""Many instances and many loads: items B4, D14, D15."""

from __future__ import annotations

import _ctypes
import os
import shutil
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from harness.validation.checks import PROBES, Note, Skip
from harness.validation.probes.host import (
    STEPS,
    Bits,
    FmuInstance,
    Host,
    Library,
    compare,
    stepped,
)
from harness.validation.probes.process import resident

_INSTANCES, _THREADS = 100, 8
_RELOADS = 1000
_LIVES = 10_000
_LIFE_SECONDS = 10.0
"""After which no further life begins [s]."""
_GROWTH = 2 * 2**20
"""What all those loads may leave behind [byte]."""
_LEFT = 16
"""What a life may leave behind on average [byte]; the smallest block of an allocator is larger."""
_NOISE = 2**18
"""What a process takes for itself meanwhile [byte]."""


def _several(host: Host) -> None:
    if host.facts["only_once"]:
        raise Skip("canBeInstantiatedOnlyOncePerProcess is true")


@PROBES.check("D14.interleaved", "error", "two instances do not see each other")
def _interleaved(host: Host) -> Iterator[str]:
    _several(host)
    reference = host.reference_run()
    one, other = FmuInstance(host, name=b"one"), FmuInstance(host, name=b"other")
    one.initialise()
    other.initialise()
    seen: tuple[list[Bits], list[Bits]] = ([], [])
    for k in range(STEPS):
        seen[0].extend(one.run(k, 1))
        # The second lives later, so that the two never hold the same values.
        if k >= 2:
            seen[1].extend(other.run(k - 2, 1))
    yield from compare(seen[0], reference, "the first of two interleaved instances")
    yield from compare(seen[1], reference[: STEPS - 2], "the second of two interleaved instances")


@PROBES.check(
    "D14.threads", "error", f"{_INSTANCES} instances in {_THREADS} threads equal one alone"
)
def _threads(host: Host) -> Iterator[str]:
    _several(host)
    reference = host.reference_run(STEPS // 2)

    def life(n: int) -> list[Bits]:
        slave = stepped(host, name=b"number %d" % n)
        seen = slave.run(0, STEPS // 2)
        slave.free()
        return seen

    with ThreadPoolExecutor(_THREADS) as pool:
        for n, seen in enumerate(pool.map(life, range(_INSTANCES))):
            yield from compare(seen, reference, f"instance {n} of {_INSTANCES} in threads")


@PROBES.check(
    "D15.lives", "warning", "thousands of instances one after another take no more memory"
)
def _lives(host: Host) -> Iterator[str]:
    def live(times: int) -> int:
        end = time.monotonic() + _LIFE_SECONDS
        for n in range(times):
            slave = stepped(host, 1)
            slave.free()
            if time.monotonic() > end:
                return n + 1
        return times

    live(_LIVES // 100)
    before = resident()
    lives = live(_LIVES)
    grown = resident() - before
    yield Note(f"{lives} lives: {grown / 1024:.0f} KiB")
    if grown > _NOISE + _LEFT * lives:
        yield f"{lives} instances, each freed again, left {grown / 1024:.0f} KiB behind"


@PROBES.check("B4.reload", "warning", f"can be loaded and unloaded {_RELOADS} times")
def _reload(host: Host) -> Iterator[str]:
    def load(times: int) -> None:
        for _ in range(times):
            library = Library(host, host.facts["library"])
            slave = stepped(host, library=library)
            slave.free()
            host.doing("unloading the binary")
            handle = library.handle._handle
            if sys.platform == "win32":
                _ctypes.FreeLibrary(handle)
            else:
                _ctypes.dlclose(handle)

    load(_RELOADS // 10)
    before = resident()
    load(_RELOADS)
    grown = resident() - before
    yield Note(f"{grown / 1024:.0f} KiB")
    if grown > _GROWTH:
        yield f"{_RELOADS} times loaded and unloaded left {grown / 1024:.0f} KiB behind"


@PROBES.check(
    "B4.two_copies", "error", "two copies of the FMU in one process do not see each other"
)
def _two_copies(host: Host) -> Iterator[str]:
    _several(host)
    reference = host.reference_run()
    folder = Path.cwd() / "copy"
    shutil.copytree(host.facts["folder"], folder)
    path = folder / os.path.relpath(host.facts["library"], host.facts["folder"])
    copy = Library(host, str(path))
    uri = (folder / "resources").as_uri().encode()
    one, other = FmuInstance(host), FmuInstance(host, copy, resources=uri)
    one.initialise()
    other.initialise()
    seen: tuple[list[Bits], list[Bits]] = ([], [])
    for k in range(STEPS):
        seen[0].extend(one.run(k, 1))
        seen[1].extend(other.run(k, 1))
    yield from compare(seen[0], reference, "beside a copy of itself")
    yield from compare(seen[1], reference, "the copy")
