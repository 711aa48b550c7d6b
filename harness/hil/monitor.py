"""The monitor of a running loop: a page on the loopback address, in a process of its own.

    python -m harness.hil.monitor loop.ring board.ring --role tip=instrument.tip_*

reads rings (`harness.hil.ring`), which costs the loop nothing, and prints its address as the first
line of its output. It ends on SIGTERM and SIGINT, and by itself once both the loop and the process
that started it are gone (on Windows only when it is told to).
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.processes import end_process

if TYPE_CHECKING:
    from harness.hil.monitor_view import MonitoredRings

__all__ = ["Monitor", "main", "start_monitor"]

_HOST = "127.0.0.1"
_ROLES = ("tip_uncompensated", "tip", "intent", "actuator_voltage")
_NICE = 10
_END = 5.0  # s that the process gets to end in order
_START = 60.0  # s until it has to have said where it is
_WAIT = 30.0  # s for rings that other processes make


class Monitor:
    """A monitor that runs; as a context manager it is closed at the end.

    Attributes:
        url: of the page.
    """

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        """Take over a process; see `start_monitor`."""
        self.url = url
        self._process = process

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    def close(self) -> None:
        """End the process; a second time does nothing."""
        end_process(self._process, _END)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> Monitor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def start_monitor(
    rings: Sequence[Path], roles: Mapping[str, Sequence[str]], port: int = 0
) -> Monitor:
    """Start a monitor. Best before the loop takes its priority: starting costs some seconds of CPU.

    Args:
        rings: files, the loop's first; they may appear later, within 30 s.
        roles: names or patterns of columns by role, as in a scenario's `signals`; those that are
            not shown may be among them. Without `intent`, as when a recording moves the hand, it
            is made from `tip_uncompensated`.
        port: on 127.0.0.1; 0 for a free one.

    Raises:
        SteadytipError: it does not start, in its own words.
    """
    command = [sys.executable, "-m", "harness.hil.monitor", *map(str, rings)]
    command += ["--port", f"{port}", "--wait", f"{_WAIT:g}", "--parent", f"{os.getpid()}"]
    for role in _ROLES:
        for name in roles.get(role, ()):
            command += ["--role", f"{role}={name}"]
    # A group of its own: Ctrl-C is for the loop, which has to stop in order before this ends.
    group = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # on Windows
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
            creationflags=group,
        )
        assert process.stdout is not None
        timer = threading.Timer(_START, process.kill)
        timer.start()
        url = process.stdout.readline().strip()
        timer.cancel()
        if not url:
            process.wait()
            process.stdout.close()
            errors.seek(0)
            text = errors.read().strip() or f"it said nothing within {_START:g} s"
            raise SteadytipError(f"the monitor does not start: {text}")
    return Monitor(process, url)


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until told to end, or until nobody is left.

    Args:
        arguments: of the command line; those of the process by default.

    Returns:
        Exit code: 2 with a sentence on stderr if something is wrong, else 0.
    """
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    _step_aside()
    options = _parser().parse_args(arguments)
    try:
        _serve(options, stop)
    except SteadytipError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m harness.hil.monitor",
        description="Show a running loop on a page of this machine.",
    )
    parser.add_argument("rings", metavar="RING", nargs="+", type=Path, help="the loop's first")
    parser.add_argument("--port", type=int, default=0, help="on 127.0.0.1; 0: a free one")
    parser.add_argument(
        "--role",
        metavar="ROLE=COLUMN",
        action="append",
        default=[],
        help=f"column, or pattern of columns, that plays a role ({', '.join(_ROLES)}); repeatable",
    )
    parser.add_argument(
        "--wait", type=float, default=0.0, help="how long rings may take to appear [s]"
    )
    parser.add_argument(
        "--parent", type=int, default=os.getppid(), help="process without which this ends"
    )
    return parser


def _step_aside() -> None:
    """Leave the loop its core and its priority, which a child inherits."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    if not hasattr(os, "sched_setaffinity"):
        return
    with contextlib.suppress(OSError):
        if os.sched_getscheduler(0) != os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        pinned = os.sched_getaffinity(0)
        if len(pinned) == 1:
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
            others = os.sched_getaffinity(0) - pinned
            os.sched_setaffinity(0, others or pinned)


def _roles(given: Sequence[str]) -> dict[str, list[str]]:
    roles: dict[str, list[str]] = {}
    for text in given:
        role, equals, name = text.partition("=")
        if not equals or not name:
            raise SteadytipError(f"--role {text}: write ROLE=COLUMN, as tip=instrument.tip_*")
        if role not in _ROLES:
            raise SteadytipError(
                f"--role {text}: there is no role '{role}'; {nearest(role, _ROLES)}"
            )
        roles.setdefault(role, []).append(name)
    return roles


def _listen(port: int) -> socket.socket:
    if not 0 <= port < 2**16:
        raise SteadytipError(f"--port {port}: a port is 1 to 65535, or 0 for a free one")
    listener = socket.socket()
    if os.name == "posix":  # where it means: in spite of connections that are still closing
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((_HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise SteadytipError(
            f"--port {port}: {_HOST} does not give it ({os.strerror(error.errno or 0)}); choose "
            "another, or 0 for a free one"
        ) from None
    return listener


def _serve(options: argparse.Namespace, stop: threading.Event) -> None:
    roles = _roles(options.role)
    # NumPy's library starts as many threads as there are cores, unless told before it is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from harness.hil.monitor_view import MonitoredRings

    rings = MonitoredRings(options.rings, roles)
    end = time.monotonic() + options.wait
    _open(rings, end, options.wait)
    with _listen(options.port) as listener:
        try:
            from werkzeug.serving import make_server

            from harness.hil.page import application
        except ImportError as error:
            raise SteadytipError(
                f"the monitor needs the package '{error.name}': pip install 'steadytip[monitor]'"
            ) from None
        logging.getLogger("werkzeug").setLevel(logging.ERROR)  # else a line for each request
        port = listener.getsockname()[1]
        server = make_server(
            _HOST, port, application(rings).server, threaded=True, fd=listener.fileno()
        )
        threading.Thread(target=server.serve_forever, name="steadytip-page", daemon=True).start()
        print(f"http://{_HOST}:{port}/", flush=True)
        try:
            _watch(rings, stop, end, options)
        finally:
            server.shutdown()
            server.server_close()


def _open(rings: MonitoredRings, end: float, wait: float) -> None:
    from harness.hil.ring import no_ring

    missing = rings.open()
    if missing is not None and time.monotonic() >= end:
        raise no_ring(missing, wait)


def _watch(
    rings: MonitoredRings, stop: threading.Event, end: float, options: argparse.Namespace
) -> None:
    from harness.hil.monitor_view import SILENT, MonitorState
    from harness.hil.page import PERIOD

    alive = time.monotonic()  # the loop, or the parent, which may yet start one
    while not stop.wait(PERIOD):
        _open(rings, end, options.wait)
        (_, state, _), *_ = rings.look()
        if state is MonitorState.RUNNING or os.getppid() == options.parent:
            alive = time.monotonic()
        elif state is MonitorState.STOPPED or time.monotonic() - alive > 2.0 * SILENT:
            return


if __name__ == "__main__":
    sys.exit(main())
