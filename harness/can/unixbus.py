"""`unixbus` of python-can: any number of nodes on one machine, over Unix datagram sockets.

The channel is a folder. Each node binds a socket of its own in it and sends each frame to the
sockets of all others; a node hears every frame that is sent after its constructor has returned.
On the wire a frame is the sender's time of day [ns, uint64], then `struct can_frame` or
`struct canfd_frame` of linux/can.h as SocketCAN lays them out, told apart by their size. The time
is that on the bus: it is the same for all receivers, and becomes `Message.timestamp`.

The system keeps only some ten datagrams for a socket (net.unix.max_dgram_qlen). Frames beyond that
wait, in order, in the sender, up to `WAITING_FRAMES` for each node, and leave as the node reads:
during the sender's `recv`, or at its next `recv` or `send`; `shutdown` waits 0.2 s for them. A
sender that calls neither keeps them. There is no arbitration and no bit rate.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import secrets
import select
import socket
import struct
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import can

from harness.can.transport import (
    EXTENDED_IDS,
    FD_LENGTHS,
    FRAMES_AT_ONCE,
    POLL_PERIOD,
    STANDARD_IDS,
    WAITING_FRAMES,
    Transport,
)

# Stamp; can_id, length, flags, two reserved bytes of which we use one, padding; data.
_CLASSIC = struct.Struct("=QIBBBx8s")
_FD = struct.Struct("=QIBBBx64s")

# linux/can.h
_EXTENDED, _REMOTE, _ERROR = 1 << 31, 1 << 30, 1 << 29
_BIT_RATE_SWITCH, _ERROR_STATE, _FD_FORMAT = 0x01, 0x02, 0x04

_SUFFIX = ".can"
_PATH_LIMIT = 104 if sys.platform == "darwin" else 108  # sun_path, closing zero included

_FULL = {errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOBUFS}
_DEAD = {errno.ECONNREFUSED, errno.ENOENT, errno.ENOTCONN, errno.ECONNRESET, errno.EPIPE}
_MARK = 8  # bytes that change whenever a node joins or leaves


class _Peer:
    """Another node: a socket connected to its, and the frames that it has no room for yet."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.waiting: deque[bytes] = deque()
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self.socket.setblocking(False)
            self.socket.connect(path)
        except OSError:
            self.socket.close()
            raise

    def offer(self, frame: bytes) -> bool:
        """Offer a frame to the node's socket, and return whether it took it."""
        try:
            self.socket.send(frame)
        except OSError as error:
            if error.errno in _FULL:
                return False
            raise
        return True

    def flush(self) -> bool:
        """Send what waits, as far as there is room; whether nothing waits any more."""
        while self.waiting:
            if not self.offer(self.waiting[0]):
                return False
            self.waiting.popleft()
        return True


class UnixBus(Transport):
    """One node of a bus in a folder."""

    def __init__(
        self, channel: str | os.PathLike[str], receive_own_messages: bool = False, **kwargs: Any
    ) -> None:
        """Join the bus.

        Args:
            channel: folder of the bus, made if it is missing. With the name of a socket in it the
                path must fit into 107 bytes.
            receive_own_messages: also hear what this node sends, with `is_rx` false.
            kwargs: `can_filters`.

        Raises:
            can.CanInitializationError: the folder cannot be used.
            can.CanInterfaceNotImplementedError: the system has no Unix sockets.
        """
        if not hasattr(socket, "AF_UNIX"):
            raise can.CanInterfaceNotImplementedError(
                "unixbus needs Unix datagram sockets, which this system does not have. Use the"
                " interface 'virtual' within one process, or a CAN adapter"
            )
        self._own = receive_own_messages
        folder = Path(channel)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise can.CanInitializationError(
                f"UnixBus {folder}: cannot make the folder: {error.strerror}. Name a folder that"
                " can be written"
            ) from error
        super().__init__(str(folder), **kwargs)

    # The medium.

    def _open(self) -> None:
        self._peers: dict[str, _Peer] = {}
        self._has_waiting = False  # whether a frame waits anywhere
        self._known = b""
        self._next_check = 0.0
        name = f"{os.getpid()}-{secrets.token_hex(3)}{_SUFFIX}"
        self._path = str(Path(self.channel) / name)
        size = len(os.fsencode(self._path))
        if size >= _PATH_LIMIT:
            raise can.CanInitializationError(
                f"UnixBus {self.channel}: the path of a socket in it has {size} bytes, and the"
                f" system takes {_PATH_LIMIT - 1}. Choose a folder whose path is shorter by"
                f" {size - _PATH_LIMIT + 1} bytes, or a relative one"
            )
        self._joined = self._map_mark()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(self._path)
        except OSError:
            self._socket.close()
            self._joined.close()
            raise
        self._readable = select.poll()
        self._readable.register(self._socket, select.POLLIN)
        self._joined[:] = secrets.token_bytes(_MARK)

    def _map_mark(self) -> mmap.mmap:
        """Map the few bytes, shared by all nodes, that each node changes when it joins or leaves.

        Looking at them at each `send` costs less than 0.1 us; looking at the folder 2 us or more.
        """
        handle = os.open(Path(self.channel) / "joined", os.O_RDWR | os.O_CREAT, 0o666)
        try:
            os.ftruncate(handle, _MARK)
            return mmap.mmap(handle, _MARK)
        finally:
            os.close(handle)

    def _close(self) -> None:
        self._socket.close()
        for peer in self._peers.values():
            peer.socket.close()
        self._peers = {}
        self._has_waiting = False
        with contextlib.suppress(OSError):
            Path(self._path).unlink()
        self._joined[:] = secrets.token_bytes(_MARK)
        self._joined.close()

    def _check_folder(self) -> None:
        """Now and then: whether the folder is still there, and this node's socket in it."""
        now = time.monotonic()
        if now >= self._next_check:
            self._next_check = now + POLL_PERIOD
            Path(self._path).stat()

    def _find_peers(self) -> None:
        """Find nodes that are new, forget those that left."""
        self._known = self._joined[:]
        present = set()
        with os.scandir(self.channel) as entries:
            for entry in entries:
                if entry.name.endswith(_SUFFIX) and (self._own or entry.path != self._path):
                    present.add(entry.path)
        for path in self._peers.keys() - present:
            self._remove_peer(path)
        for path in present - self._peers.keys():
            try:
                self._peers[path] = _Peer(path)
            except OSError as error:
                if error.errno not in _DEAD:
                    raise
                self._remove_peer(path)

    def _remove_peer(self, path: str) -> None:
        """Remove the socket of a node that is dead or has left, and ours to it."""
        peer = self._peers.pop(path, None)
        if peer is not None:
            peer.socket.close()
        if Path(path).is_socket():  # somebody's file may have a name like ours
            Path(path).unlink(missing_ok=True)

    # Frames.

    def _put(self, msg: can.Message, deadline: float) -> None:
        self._check_folder()
        if self._joined[:] != self._known:
            self._find_peers()
        frame = _encode(msg)
        full = []
        dead = []
        for peer in self._peers.values():
            mine = frame if peer.path != self._path else _own_copy(frame)
            try:
                if (not peer.waiting or peer.flush()) and peer.offer(mine):
                    continue
                self._has_waiting = True
                if len(peer.waiting) < WAITING_FRAMES or self._make_room(peer, deadline):
                    peer.waiting.append(mine)
                else:
                    full.append(peer.path)
            except OSError as error:
                if error.errno not in _DEAD:
                    raise
                dead.append(peer.path)
        for path in dead:
            self._remove_peer(path)
        if full:
            names = ", ".join(Path(path).name for path in full)
            raise can.CanOperationError(
                f"UnixBus {self.channel}: {names} does not read, {WAITING_FRAMES} frames wait for"
                f" it; frame {msg.arbitration_id:#x} is lost for it. Let it read, or end it (the"
                " name begins with the number of its process)"
            )

    def _make_room(self, peer: _Peer, deadline: float) -> bool:
        """Wait until the node has read something; whether it has."""
        writable = select.poll()
        writable.register(peer.socket, select.POLLOUT)
        while (left := deadline - time.monotonic()) > 0:
            writable.poll(1e3 * left)
            peer.flush()
            if len(peer.waiting) < WAITING_FRAMES:
                return True
        return False

    def _flush(self) -> bool:
        for path, peer in list(self._peers.items()):
            try:
                peer.flush()
            except OSError as error:
                if error.errno not in _DEAD:
                    raise
                self._remove_peer(path)
        self._has_waiting = any(peer.waiting for peer in self._peers.values())
        return self._has_waiting

    def _take(self) -> can.Message | None:
        self._check_folder()
        if self._has_waiting:
            self._flush()
        for _ in range(FRAMES_AT_ONCE):
            try:
                datagram = self._socket.recv(_FD.size + 1)
            except BlockingIOError:
                return None
            message = _decode(datagram, self.channel)
            if message is not None:
                return message
            self.malformed += 1
        return None

    def _wait(self, seconds: float) -> None:
        ready = self._readable
        if self._has_waiting:
            ready = select.poll()
            ready.register(self._socket, select.POLLIN)
            with self._lock:
                for peer in self._peers.values():
                    if peer.waiting:
                        ready.register(peer.socket, select.POLLOUT)
        ready.poll(1e3 * seconds)

    def reconnect(self) -> bool:
        """Try once to join again after the folder was removed; it is not made anew.

        Frames that wait for nodes which do not read are given up.

        Returns:
            Whether this node is on the bus now.
        """
        with self._lock:
            for peer in self._peers.values():
                peer.waiting.clear()
        return super().reconnect()

    def fileno(self) -> int:
        """Handle that is readable when a frame is there; -1 while the medium is gone."""
        return self._socket.fileno()


def _encode(msg: can.Message) -> bytes:
    """Encode a message as it is on the wire, stamped now."""
    can_id = msg.arbitration_id
    if msg.is_extended_id:
        can_id |= _EXTENDED
    if msg.is_remote_frame:
        can_id |= _REMOTE
    if msg.is_error_frame:
        can_id |= _ERROR
    if not msg.is_fd:
        return _CLASSIC.pack(time.time_ns(), can_id, msg.dlc, 0, 0, msg.data)
    flags = _FD_FORMAT
    if msg.bitrate_switch:
        flags |= _BIT_RATE_SWITCH
    if msg.error_state_indicator:
        flags |= _ERROR_STATE
    return _FD.pack(time.time_ns(), can_id, msg.dlc, flags, 0, msg.data)


def _own_copy(frame: bytes) -> bytes:
    """Return the copy that a node sends to itself, marked by the first reserved byte."""
    return frame[:14] + b"\1" + frame[15:]


def _decode(datagram: bytes, channel: str) -> can.Message | None:
    """Return the message of a datagram; None where it is no frame."""
    is_fd = len(datagram) == _FD.size
    if is_fd:
        stamp, can_id, length, flags, own, data = _FD.unpack(datagram)
        if length not in FD_LENGTHS:
            return None
    elif len(datagram) == _CLASSIC.size:
        stamp, can_id, length, flags, own, data = _CLASSIC.unpack(datagram)
        if length > 8:
            return None
    else:
        return None
    arbitration_id = can_id & (EXTENDED_IDS - 1)
    extended, remote, error = can_id & _EXTENDED, can_id & _REMOTE, can_id & _ERROR
    if arbitration_id >= STANDARD_IDS and not extended and not error:
        return None
    if (remote != 0) + (error != 0) + is_fd > 1:
        return None
    return can.Message(
        timestamp=stamp * 1e-9,
        arbitration_id=arbitration_id,
        is_extended_id=extended != 0,
        is_remote_frame=remote != 0,
        is_error_frame=error != 0,
        channel=channel,
        dlc=length,
        data=None if remote else data[:length],
        is_fd=is_fd,
        is_rx=not own,
        bitrate_switch=is_fd and flags & _BIT_RATE_SWITCH != 0,
        error_state_indicator=is_fd and flags & _ERROR_STATE != 0,
    )
