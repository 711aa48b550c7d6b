"""An FMU in a process of its own: nothing that it does there, not even a crash, ends the run's.

    clock    (2,)  t, h of the step                                [s]
    u, y           inputs and outputs, as in `Part`
    request        what is wanted: STEP, CALL with the call on the connection, or CLOSE
    failed         whether it went wrong; then the words are on the connection

These lie in memory that both processes share. One semaphore says "go", one says "done"; a
connection carries what is rare: the first three calls, and the texts of failures. The memory has no
name that could outlive the processes, and the child ends with its parent, however the parent ended.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np

from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.description import Description
from harness.parts.fmi import Instance, Stepper

__all__ = ["IsolatedInstance", "end_with_parent", "ending"]

_STEP, _CALL, _CLOSE = range(3)
_LOOK = 0.05  # s between two looks whether the other process is alive
_PATIENCE = 1.0  # s that the FMU gets to free itself

# Spawn, on every platform: a forked copy would hold the locks and threads of the run's process.
_context = multiprocessing.get_context("spawn")


def ending(code: int | None) -> str:
    """Describe how a process ended, from its exit code.

    >>> ending(-11), ending(3)
    ('was ended by SIGSEGV', 'ended with exit code 3')
    """
    if code is not None and code < 0:
        try:
            return f"was ended by {signal.Signals(-code).name}"
        except ValueError:
            return f"was ended by signal {-code}"
    # Windows gives the exception's code, an access violation is 0xC0000005.
    shown = f"{code:#x}" if code is not None and code >= 2**30 else code
    return f"ended with exit code {shown}"


class IsolatedInstance:
    """`harness.parts.fmi.Instance` in a process of its own, with the same calls."""

    def __init__(self, description: Description, name: str, workspace: Path) -> None:
        """Start the process, which loads and instantiates; `begin` waits for that."""
        self._name = description.path.name
        self._u = _context.RawArray("d", max(1, len(description.inputs)))
        self._y = _context.RawArray("d", max(1, len(description.outputs)))
        self._clock = _context.RawArray("d", 2)
        self._request = _context.RawValue("i", _CALL)
        self._failed = _context.RawValue("i", False)
        self._go = _context.Semaphore(0)
        self._done = _context.Semaphore(0)
        self._connection, theirs = _context.Pipe()
        self._closing = threading.Lock()
        self._process = _context.Process(
            target=_serve,
            args=(
                *(theirs, self._go, self._done, self._clock, self._request, self._failed),
                *(self._u, self._y, description, name, workspace),
            ),
            name=f"steadytip-{name}",
            daemon=True,
        )
        with _ctrl_c_held():
            self._process.start()
        # With this copy open the end of the child would go unnoticed here.
        theirs.close()

    def begin(
        self,
        stop: float,
        start_values: Mapping[str, Any],
        initialised: Sequence[str],
        preset_values: FloatArray,
    ) -> None:
        """See `harness.parts.fmi.Instance.begin`.

        Raises:
            FaultError: the FMU does not load, refuses something, or its process ended.
        """
        self._wait("its instantiation")
        self._call("begin", stop, dict(start_values), list(initialised), np.array(preset_values))
        self.warnings: tuple[str, ...] = self._connection.recv()

    def stepper(
        self, connected: Sequence[str], u: FloatArray, y: FloatArray, returns: bool = False
    ) -> Stepper:
        """See `harness.parts.fmi.Instance.stepper`; states are not saved out of process."""
        assert not returns
        self._call("stepper", list(connected))
        shared_u = np.frombuffer(self._u)[: len(connected)]
        shared_y = np.frombuffer(self._y)[: len(y)]
        self._request.value = _STEP
        clock, go, acquire = self._clock, self._go.release, self._done.acquire
        failed, wait = self._failed, self._wait

        def advance(t: float, h: float) -> None:
            shared_u[:] = u
            clock[0] = t
            clock[1] = h
            go()
            if not acquire(True, _LOOK):
                wait("its step")
            elif failed.value:
                self._raise()
            y[:] = shared_y

        y[:] = shared_y
        return advance

    def kill(self) -> None:
        """End the process at once; a call that waits for it raises FaultError. From any thread."""
        self._process.kill()

    def close(self) -> None:
        """Let the FMU free itself, then end the process."""
        with self._closing:
            self._request.value = _CLOSE
            self._go.release()
            self._process.join(_PATIENCE)
            if self._process.is_alive():
                self._process.kill()
                self._process.join(_PATIENCE)
            self._connection.close()

    def _call(self, *request: Any) -> None:
        # A process that has ended is noticed by what waits for its answer.
        with contextlib.suppress(OSError):
            self._connection.send(request)
        self._go.release()
        self._wait("its initialisation")

    def _wait(self, doing: str) -> None:
        while not self._done.acquire(True, _LOOK):
            if self._process.is_alive():
                continue
            # The last word may have been said between the two looks.
            if self._done.acquire(False):
                break
            raise FaultError(
                f"the process of {self._name} {ending(self._process.exitcode)} during {doing}; "
                "the run's own process is not harmed"
            )
        if self._failed.value:
            self._raise()

    def _raise(self) -> None:
        raise FaultError(self._connection.recv())


@contextlib.contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Ctrl-C reaches all processes of a terminal; the child inherits that it is not to listen."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---- In the other process ----------------------------------------------------------------------


def _serve(
    parent: connection.Connection,
    go: Any,
    done: Any,
    clock: Any,
    request: Any,
    failed: Any,
    u: Any,
    y: Any,
    description: Description,
    name: str,
    workspace: Path,
) -> None:
    """Life of the child: instantiate, then do what is requested at each "go"."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    inputs, outputs = np.frombuffer(u), np.frombuffer(y)[: len(description.outputs)]

    def attempt(action: Callable[..., Any], *arguments: Any) -> Any:
        # Anything but a FaultError is a mistake in here: it ends the process, which tells.
        result = None
        try:
            result = action(*arguments)
        except FaultError as error:
            failed.value = True
            parent.send(str(error))
        done.release()
        return result

    def begin(*arguments: Any) -> None:
        assert instance is not None
        instance.begin(*arguments)
        parent.send(instance.warnings)

    instance: Instance | None = attempt(Instance, description, name, workspace)
    if instance is None:
        return
    advance: Any = None  # a Stepper once it has been asked for
    while True:
        go.acquire()
        if request.value == _STEP:
            attempt(advance, *clock)
        elif request.value == _CALL:
            verb, *arguments = parent.recv()
            if verb == "begin":
                attempt(begin, *arguments)
            else:
                (connected,) = arguments
                advance = attempt(instance.stepper, connected, inputs[: len(connected)], outputs)
        else:
            instance.close()
            return


def end_with_parent() -> None:
    """Wait for the parent's end, whatever it is, and end this process with it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        # Not sys.exit: the main thread may sit in the FMU for ever.
        os._exit(1)
