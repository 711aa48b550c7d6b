"""What our own python-can interfaces share: waiting, filters, loss of the medium, bus-off.

A medium that is lost (adapter unplugged, folder removed) is a `can.CanOperationError` out of each
`recv` and `send` until `reconnect` finds it again. Nothing is sent or received by itself: there is
no thread, so a bus works only while it is called.

Bus-off is told as SocketCAN tells it (linux/can/error.h): an error frame whose identifier has the
bit 0x40. Error frames pass all filters, as those of SocketCAN do.
"""

from __future__ import annotations

import contextlib
import threading
from abc import abstractmethod
from time import monotonic, sleep
from typing import Any

import can
from can.util import CAN_FD_DLC

BUS_OFF = 0x40
"""Bit of an error frame's identifier: the controller has left the bus (CAN_ERR_BUSOFF)."""

FD_LENGTHS = frozenset(CAN_FD_DLC)
STANDARD_IDS = 1 << 11
EXTENDED_IDS = 1 << 29

POLL_PERIOD = 0.05
"""Longest stretch [s] of a wait after which medium and waiting frames are looked at again."""

FRAMES_AT_ONCE = 100
"""Frames that no filter passes, or pieces of rubbish, after which `recv` looks at the clock."""

FLUSH_TIMEOUT = 0.2
"""How long [s] `shutdown` waits for frames that have not left yet."""

WAITING_FRAMES = 4096
"""Frames that wait for one reader who does not keep up: 1.3 s of three frames a millisecond."""


def is_bus_off(message: can.Message) -> bool:
    """Return whether a message is the error frame of a controller that has left the bus."""
    return message.is_error_frame and bool(message.arbitration_id & BUS_OFF)


def bus_off_frame() -> can.Message:
    """Return the error frame with which a node says that its controller has left the bus."""
    return can.Message(
        arbitration_id=BUS_OFF, is_extended_id=False, is_error_frame=True, data=bytes(8)
    )


def refuse_impossible(msg: can.Message) -> None:
    """Refuse a message that no CAN bus could carry, which would else arrive as another one.

    Raises:
        ValueError: name, value, range.
    """
    wide = msg.is_extended_id or msg.is_error_frame
    limit = EXTENDED_IDS if wide else STANDARD_IDS
    if not 0 <= msg.arbitration_id < limit:
        kind = "extended" if wide else "standard"
        raise ValueError(
            f"identifier {msg.arbitration_id:#x} of a {kind} frame must be in 0..{limit - 1:#x}"
        )
    if msg.is_fd:
        if msg.dlc not in FD_LENGTHS:
            raise ValueError(f"dlc {msg.dlc} of an FD frame must be one of {sorted(FD_LENGTHS)}")
        if msg.is_remote_frame or msg.is_error_frame:
            raise ValueError(f"{msg.arbitration_id:#x}: no FD frame is a remote or an error frame")
    elif not 0 <= msg.dlc <= 8:
        raise ValueError(f"dlc {msg.dlc} of a classic frame must be in 0..8; or set is_fd")
    elif msg.bitrate_switch or msg.error_state_indicator:
        raise ValueError(f"{msg.arbitration_id:#x}: bit rate switch and ESI need is_fd")
    if msg.is_remote_frame:
        if msg.is_error_frame:
            raise ValueError(f"{msg.arbitration_id:#x}: remote and error frame at once")
    elif len(msg.data) != msg.dlc:
        raise ValueError(
            f"{msg.arbitration_id:#x}: dlc {msg.dlc}, but {len(msg.data)} bytes of data"
        )


class Transport(can.BusABC):
    """A bus on a medium that can be lost and found again.

    `recv` may be called in one thread and `send` in another.

    Attributes:
        malformed: pieces of input that were no frame, and were dropped.
    """

    def __init__(self, channel: str, **kwargs: Any) -> None:
        """Open the medium at once.

        Args:
            channel: what and where the medium is.
            kwargs: `can_filters`; others, as configuration files hold for all buses, mean nothing.

        Raises:
            can.CanInitializationError: the medium cannot be opened.
        """
        self.malformed = 0
        self.channel = channel
        self.channel_info = f"{type(self).__name__} {channel}"
        self._can_protocol = can.CanProtocol.CAN_FD
        self._lock = threading.RLock()
        self._lost: str | None = None
        self._normal_state = can.BusState.ACTIVE
        try:
            self._open()
        except OSError as error:
            raise can.CanInitializationError(self._text("cannot be opened", error)) from error
        super().__init__(channel, **kwargs)

    # What a medium has to do; an OSError out of these means that it is gone.

    @abstractmethod
    def _open(self) -> None:
        """Open the medium, which may have been open before.

        Raises:
            OSError: it is not there.
        """

    @abstractmethod
    def _close(self) -> None:
        """Let the medium go, whatever state it is in."""

    @abstractmethod
    def _take(self) -> can.Message | None:
        """Next message that is there already, after sending what waits; None: nothing there."""

    @abstractmethod
    def _put(self, msg: can.Message, deadline: float) -> None:
        """Send, keep for later, or refuse after `deadline` (`time.monotonic`) [s]."""

    @abstractmethod
    def _flush(self) -> bool:
        """Send as much as the medium takes now of what waits; whether something still waits."""

    @abstractmethod
    def _wait(self, seconds: float) -> None:
        """Sleep until something can be received, what waits can be sent, or the time is over."""

    # What python-can asks for.

    @property
    def state(self) -> can.BusState:
        """ACTIVE, or PASSIVE where the bus only listens; ERROR while the medium is gone."""
        return self._normal_state if self._lost is None else can.BusState.ERROR

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError(f"{self.channel_info}: the state is what it is, it cannot be set")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else monotonic() + timeout
        passed_over = 0
        while True:
            try:
                with self._lock:
                    self._refuse_if_lost()
                    message = self._take()
                if message is not None:
                    if message.is_error_frame or self._matches_filters(message):
                        return message, True
                    passed_over += 1  # `recv(0)` must not end at a frame that is filtered out
                    if deadline is None or passed_over % FRAMES_AT_ONCE or monotonic() < deadline:
                        continue
                left = POLL_PERIOD if deadline is None else min(POLL_PERIOD, deadline - monotonic())
                if left <= 0:
                    return None, True
                self._wait(left)
            except OSError as error:
                raise self._lose("is gone", error) from error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send, without ever waiting unless asked to.

        Args:
            msg: what to send; its timestamp does not matter.
            timeout: how long to wait for room [s] where too many frames wait already; None: not.

        Raises:
            can.CanOperationError: the medium is gone, or too many frames wait for their reader;
                `state` is ERROR in the first case only.
            ValueError: no CAN bus could carry the message.
        """
        refuse_impossible(msg)
        try:
            with self._lock:
                self._refuse_if_lost()
                self._put(msg, monotonic() + timeout if timeout else 0.0)
        except OSError as error:
            raise self._lose("is gone", error) from error

    def unplug(self) -> None:
        """Leave the medium as if the cable were pulled; `reconnect` puts it back."""
        if self._lost is None:
            self._lose("was unplugged by this node", None)

    def reconnect(self) -> bool:
        """Try once to open the medium again after it was lost.

        Returns:
            Whether the bus is open now; also true where it was never lost.
        """
        if self._is_shutdown:
            return False
        with self._lock:
            if self._lost is not None:
                try:
                    self._open()
                except OSError:
                    return False
                self._lost = None
        return True

    def shutdown(self) -> None:
        """Send what still waits, for 0.2 s at most, and let the medium go. May be called twice."""
        if self._is_shutdown:
            return
        super().shutdown()
        if self._lost is None:
            deadline = monotonic() + FLUSH_TIMEOUT
            with contextlib.suppress(OSError, can.CanError):
                while self._flush_locked() and monotonic() < deadline:
                    sleep(1e-3)
            with self._lock:
                self._close()
        self._lost = self._text("is shut down; make a new bus")

    def _flush_locked(self) -> bool:
        with self._lock:
            return self._flush()

    # What happened, in words.

    def _refuse_if_lost(self) -> None:
        if self._lost is not None:
            raise can.CanOperationError(self._lost)

    def _text(self, what: str, error: OSError | None = None) -> str:
        reason = f": {error.strerror or error}" if error is not None else ""
        return f"{self.channel_info} {what}{reason}"

    def _lose(self, what: str, error: OSError | None) -> can.CanOperationError:
        """Let the medium go and remember why."""
        with self._lock:
            if self._lost is None:
                self._lost = self._text(what, error)
                self._close()
        return can.CanOperationError(self._lost)
