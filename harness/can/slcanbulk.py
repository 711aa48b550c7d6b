"""`slcanbulk` of python-can: slcan (LAWICEL ASCII) on a serial port or a pty, read in bulk.

Everything that has arrived is taken at once and split at the line ends; what is left of a line is
kept for the next time. A line is a frame only if it is one letter, then hexadecimal digits, as many
as its length digit says, with an identifier in range; all else is counted and dropped. The format
has no checksum: digits that turn into others, or a loss of just so many bytes that two lines make
one of the right length, can only be seen in the frame's own protection.

Lines (LAWICEL CAN232 manual; d, D, b, B as the firmware of CANable has them; s as the Linux driver
reads it):

| line | |
| --- | --- |
| `tIIIL..`, `TIIIIIIIIL..`, `r`, `R` | data and remote frames, standard and extended |
| `d`, `D`, `b`, `B` | FD frames, without and with bit rate switch, L the DLC; only with `fd` |
| `O`, `L`, `C` | open, open without sending, close |
| `S0`..`S8`, `sXXYY`, `Y2`, `Y5` | bit rate, bit timing registers, data bit rate |
| `Z0`, `Z1` | whether frames end in four more digits, the device's milliseconds modulo 60 000 |
| `F`, `V`, `N` | ask for status flags, version, serial number |
| `sbRRRTTT`, also `sa`, `sw`, `sp` | from the device: bus-off, error active, warning, passive |

The error state indicator of FD frames has no place in these lines.
"""

from __future__ import annotations

import contextlib
import enum
import errno
import os
import re
import select
import sys
import time
from binascii import unhexlify
from collections import deque
from pathlib import Path
from typing import Any, Protocol

import can
from can.util import CAN_FD_DLC, len2dlc

from harness.can.transport import (
    BUS_OFF,
    EXTENDED_IDS,
    POLL_PERIOD,
    STANDARD_IDS,
    WAITING_FRAMES,
    Transport,
)

_TTY_ERRORS: tuple[type[Exception], ...] = ()
if sys.platform != "win32":
    import termios

    _TTY_ERRORS = (termios.error,)

# S7 is 800 kbit/s by the manual, 750 in some firmware and in python-can.
BITRATES = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    750_000: "S7",
    800_000: "S7",
    1_000_000: "S8",
}
DATA_BITRATES = {2_000_000: "Y2", 5_000_000: "Y5"}

_KINDS = {
    # letter: extended, remote, FD, bit rate switch
    ord("t"): (False, False, False, False),
    ord("T"): (True, False, False, False),
    ord("r"): (False, True, False, False),
    ord("R"): (True, True, False, False),
    ord("d"): (False, False, True, False),
    ord("D"): (True, False, True, False),
    ord("b"): (False, False, True, True),
    ord("B"): (True, False, True, True),
}
_LETTERS = {kind: chr(letter) for letter, kind in _KINDS.items()}

# What a device takes while its channel is closed. Here only Z makes a difference.
_SETTING = re.compile(rb"S[0-9]|s[0-9A-Fa-f]{4}|Y[25]|Z[01]")
_STATUS = re.compile(rb"F[0-9A-Fa-f]{2}")
_STATE = re.compile(rb"s[abwp][0-9]{6}")

_PTY = "pty:"
_CHUNK = 1 << 16
_LONGEST = 1 + 8 + 1 + 2 * 64 + 4
_WAITING_BYTES = 32 * WAITING_FRAMES
_STAMP_PERIOD = 60.0

# Error frames of SocketCAN (linux/can/error.h): class "controller problem", and its data[1].
_CONTROLLER = 0x04
_STATES = {b"a": 0x40, b"w": 0x04 | 0x08, b"p": 0x10 | 0x20}


class LineStatus(enum.IntFlag):
    """What a device answers to `F`, by the LAWICEL manual."""

    RX_FULL = 0x01
    TX_FULL = 0x02
    ERROR_WARNING = 0x04
    OVERRUN = 0x08
    ERROR_PASSIVE = 0x20
    ARBITRATION_LOST = 0x40
    BUS_ERROR = 0x80


class _Port(Protocol):
    """Bytes in and out, never waiting but in `wait`. OSError: the other end is gone."""

    def read(self) -> bytes:
        """Return the bytes that are there; empty: nothing."""

    def write(self, data: bytes) -> int:
        """Write as many bytes as the port takes, and return how many."""

    def wait(self, seconds: float, to_write: bool) -> None:
        """Until there is something to read, perhaps room to write, or the time is over."""

    def close(self) -> None:
        """Let go."""


class _File:
    """A port that is a file handle: ttys, ptys, sockets."""

    def __init__(self, handle: int) -> None:
        self.handle = handle
        os.set_blocking(handle, False)

    def read(self) -> bytes:
        try:
            data = os.read(self.handle, _CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(errno.EIO, "the other end has closed")
        return data

    def write(self, data: bytes) -> int:
        try:
            return os.write(self.handle, data)
        except BlockingIOError:
            return 0

    def wait(self, seconds: float, to_write: bool) -> None:
        self._poll(seconds, to_write)

    def _poll(self, seconds: float, to_write: bool) -> int:
        """Wait as `wait` does, and return the events of the handle."""
        ready = select.poll()
        ready.register(self.handle, select.POLLIN | (select.POLLOUT if to_write else 0))
        return sum(events for _, events in ready.poll(1e3 * seconds))

    def close(self) -> None:
        os.close(self.handle)


class _Serial(_File):
    """A port of pyserial, by its handle."""

    def __init__(self, serial: Any) -> None:
        super().__init__(serial.fileno())
        self.serial = serial
        if os.isatty(self.handle):
            # pyserial sets VMIN = 0, with which "nothing there" looks like "unplugged".
            try:
                settings = termios.tcgetattr(self.handle)
                settings[6][termios.VMIN] = 1
                termios.tcsetattr(self.handle, termios.TCSANOW, settings)
            except _TTY_ERRORS:
                serial.close()
                raise

    def close(self) -> None:
        self.serial.close()


class _SlowSerial:
    """A port of pyserial without a handle (COM3, loop://). Writing waits, for 1 s at most."""

    def __init__(self, serial: Any) -> None:
        self.serial = serial
        self.ahead = b""
        serial.write_timeout = 1.0

    def read(self) -> bytes:
        data = self.ahead + bytes(self.serial.read(self.serial.in_waiting))
        self.ahead = b""
        return data

    def write(self, data: bytes) -> int:
        self.serial.write(data)
        return len(data)

    def wait(self, seconds: float, to_write: bool) -> None:
        if self.serial.timeout != seconds:
            self.serial.timeout = seconds
        self.ahead += bytes(self.serial.read(1))

    def close(self) -> None:
        self.serial.close()


class Pty(_File):
    """A serial cable in software: this is one end, and a link to the other is made at a path.

    While nobody has the other end open there is nothing to read, `connected` is false, and
    bytes written are lost.
    """

    def __init__(self, link: str | os.PathLike[str]) -> None:
        """Make the pty and the link, whose folder must be there.

        A link left by a process that was killed is replaced. That nobody else has it is known by a
        lock on a file beside it: the number of a pty is soon given to somebody else, so that a
        link which leads somewhere tells nothing.

        Raises:
            OSError: another process has the link, or there is something else at the path.
        """
        import fcntl
        import tty

        self.link = Path(link)
        self._lock_path = self.link.with_name(f".{self.link.name}.lock")
        self._lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                text = f"another device uses {self.link}. End it, or choose another path"
                raise OSError(error.errno, text) from error
            if self.link.exists() and not self.link.is_symlink():
                text = f"{self.link} is no link to a pty. Remove it, or choose another path"
                raise OSError(errno.EEXIST, text)
            self.link.unlink(missing_ok=True)
            master, slave = os.openpty()
            tty.setraw(slave)
            self.link.symlink_to(os.ttyname(slave))
            os.close(slave)  # else nobody could see when the other end closes
        except OSError:
            os.close(self._lock)
            raise
        super().__init__(master)
        self.connected = False

    def read(self) -> bytes:
        """Return the bytes that are there; empty: nothing, or nobody at the other end."""
        try:
            data = super().read()
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self.connected = False
            return b""
        self.connected = self.connected or bool(data)
        return data

    def wait(self, seconds: float, to_write: bool) -> None:
        """Until there is something to read, perhaps room to write, or the time is over."""
        events = self._poll(seconds, to_write)
        if events & (select.POLLHUP | select.POLLIN) == select.POLLHUP:
            time.sleep(min(seconds, 2e-3))  # with nobody there a poll comes back at once

    def close(self) -> None:
        """Close this end, which the other one sees, and remove the link."""
        super().close()
        self.link.unlink(missing_ok=True)
        self._lock_path.unlink(missing_ok=True)
        os.close(self._lock)


class SlcanBulkBus(Transport):
    """One end of an slcan line: the computer's, or with `device` the adapter's.

    As a device it answers the computer's commands while `recv` is called, and while `send` is
    called with the channel closed. What it sends with the channel closed nobody hears.

    Attributes:
        malformed: lines that were neither a frame nor an answer or a command.
        refused: BELs from the device, its word for "error".
        status: the device's last answer to `ask_status`, or, at the device, its answer to be.
        version: the device's answer to `ask_version`, as it is.
        opened: at the device, whether the computer has opened the channel.
        unheard: at the device, frames sent while it was closed.
    """

    def __init__(
        self,
        channel: str,
        bitrate: int | None = None,
        *,
        btr: str | None = None,
        listen_only: bool = False,
        timestamps: bool = False,
        fd: bool = False,
        data_bitrate: int | None = None,
        device: bool | None = None,
        tty_baudrate: int = 115200,
        rtscts: bool = False,
        sleep_after_open: float = 0.0,
        **kwargs: Any,
    ) -> None:
        """Open the port, and at the computer's end the channel.

        Args:
            channel: a serial port (`/dev/ttyACM0`, `COM3`), a URL of pyserial, or `pty:PATH`,
                which makes a pty whose other end is linked at PATH.
            bitrate: of the CAN bus [bit/s]; None: the device keeps its own.
            btr: bit timing registers instead, four hexadecimal digits, `"001C"`.
            listen_only: do not send, not even acknowledge.
            timestamps: have the device stamp frames; its clock counts on from the arrival of the
                first. Otherwise `Message.timestamp` is the time of the read.
            fd: take FD frames, too. Their letters are hexadecimal digits, so that part of a cut
                line can look like one; take them only where they are used.
            data_bitrate: of FD frames [bit/s].
            device: be the adapter instead of the computer; None: where `channel` makes a pty.
            tty_baudrate: of the serial port; USB devices ignore it.
            rtscts: hardware handshake.
            sleep_after_open: how long a device needs after its port was opened [s], before it
                is sent anything; boards that are reset by that need some 2 s. Nobody waits for
                it: commands and frames do, and leave at a later call.
            kwargs: `can_filters`.

        Raises:
            ValueError: a bit rate that slcan has no command for.
            can.CanInitializationError: the port cannot be opened.
        """
        if device is None:
            device = _makes_pty(channel)
        if bitrate is not None and btr is not None:
            raise ValueError(f"bitrate {bitrate} and btr {btr!r} exclude each other, give one")
        commands = ["C"]
        if bitrate is not None:
            commands.append(_command("bitrate", bitrate, BITRATES))
        if btr is not None:
            if not _SETTING.fullmatch(f"s{btr}".encode()):
                raise ValueError(f"btr {btr!r} must be four hexadecimal digits, such as '001C'")
            commands.append(f"s{btr}")
        if data_bitrate is not None:
            commands.append(_command("data_bitrate", data_bitrate, DATA_BITRATES))
        if timestamps:
            commands.append("Z1")
        commands.append("L" if listen_only else "O")
        self._open_commands = "".join(f"{command}\r" for command in commands).encode()
        self._device = device
        self._stamps = timestamps and not device
        self._fd = fd
        self._settings = {"baudrate": tty_baudrate, "rtscts": rtscts}
        self._sleep = sleep_after_open
        self.refused = 0
        self.status = LineStatus(0)
        self.version: str | None = None
        self.opened = False
        self.unheard = 0
        super().__init__(channel, **kwargs)
        if not fd:
            self._can_protocol = can.CanProtocol.CAN_20
        if listen_only and not device:
            self._normal_state = can.BusState.PASSIVE

    def ask_status(self) -> None:
        """Ask the device for its status flags; the answer is in `status` after a later `recv`."""
        self._ask(b"F\r")

    def ask_version(self) -> None:
        """Ask the device for its version; the answer is in `version` after a later `recv`."""
        self._ask(b"V\r")

    # The medium.

    def _open(self) -> None:
        self._frames: deque[can.Message] = deque()
        self._incomplete = b""
        self._out = bytearray()
        self._awaited: set[bytes] = set()
        self._last_stamp: tuple[float, float, float] | None = None
        self.opened = False
        self._stamping = False  # whether this device stamps what it sends
        self._is_listen_only = False  # opened by a computer that only listens
        self._port = self._open_port()
        self._ready = time.monotonic() + self._sleep
        if not self._device:
            try:
                self._write(self._open_commands)
            except OSError:
                self._port.close()
                raise

    def _open_port(self) -> _Port:
        if _makes_pty(self.channel):
            if not hasattr(os, "openpty"):
                raise can.CanInterfaceNotImplementedError(
                    f"{self.channel}: this system has no ptys. Use a serial port"
                )
            return Pty(self.channel.removeprefix(_PTY))
        try:
            import serial
        except ImportError:
            raise can.CanInterfaceNotImplementedError(
                "slcanbulk needs pyserial: pip install steadytip[hil]"
            ) from None
        if sys.platform != "win32" and "://" not in self.channel:
            self._settings["exclusive"] = True  # two readers would get half of the lines each
        try:
            port = serial.serial_for_url(self.channel, timeout=0, **self._settings)
            return _Serial(port) if _has_handle(port) else _SlowSerial(port)
        except serial.SerialException as error:
            if error.errno == errno.EAGAIN:
                text = "another program uses it. End that, or choose another port"
                raise OSError(error.errno, text) from error
            raise
        except _TTY_ERRORS as error:  # unplugged while it was being opened
            raise OSError(*error.args) from error

    def _close(self) -> None:
        self._out.clear()
        self._port.close()

    def shutdown(self) -> None:
        """Close the channel at the device, send what waits for 0.2 s at most, close the port."""
        if not self._is_shutdown and not self._device and self._lost is None:
            with contextlib.suppress(can.CanError):  # gone is as good as closed
                self._ask(b"C\r")
        super().shutdown()

    # Out.

    def _ask(self, command: bytes) -> None:
        try:
            with self._lock:
                self._refuse_if_lost()
                self._awaited.add(command[:1])
                self._write(command)
        except OSError as error:
            raise self._lose("is gone", error) from error

    def _write(self, data: bytes) -> None:
        """Send as much as goes, keep the rest."""
        if self._out or time.monotonic() < self._ready:
            self._out += data
            self._flush()
        else:
            sent = self._port.write(data)
            if sent < len(data):
                self._out += data[sent:]

    def _flush(self) -> bool:
        if self._out and time.monotonic() >= self._ready:
            del self._out[: self._port.write(bytes(self._out[:_CHUNK]))]
        return bool(self._out)

    def _put(self, msg: can.Message, deadline: float) -> None:
        if self._device and not self.opened:
            self._read_port()
        line = self._line(msg)
        if not self._has_room(len(line), deadline):
            raise can.CanOperationError(
                f"{self.channel_info}: the other end does not read, {len(self._out)} bytes wait"
                f" for it; frame {msg.arbitration_id:#x} is lost. Let it read, or end it"
            )
        if self._device and not self.opened:
            self.unheard += 1
        else:
            self._write(line)

    def _has_room(self, size: int, deadline: float) -> bool:
        """Return whether so many bytes more may wait, at the latest at `deadline`."""
        while len(self._out) + size > _WAITING_BYTES:
            self._read_port()  # a device may learn here that nobody is there any more
            self._flush()
            left = deadline - time.monotonic()
            if left <= 0:
                return len(self._out) + size <= _WAITING_BYTES
            self._wait(min(POLL_PERIOD, left))
        return True

    def _line(self, msg: can.Message) -> bytes:
        if msg.is_error_frame:
            return self._state_line(msg)
        if msg.is_fd and not self._fd:
            raise ValueError(f"{msg.arbitration_id:#x}: for FD frames make the bus with fd=True")
        kind = (msg.is_extended_id, msg.is_remote_frame, msg.is_fd, msg.bitrate_switch)
        digits = 8 if msg.is_extended_id else 3
        length = len2dlc(msg.dlc) if msg.is_fd else msg.dlc
        data = msg.data.hex().upper()
        stamp = f"{int(1e3 * time.monotonic()) % 60_000:04X}" if self._stamping else ""
        return f"{_LETTERS[kind]}{msg.arbitration_id:0{digits}X}{length:X}{data}{stamp}\r".encode()

    def _state_line(self, msg: can.Message) -> bytes:
        if not self._device:
            raise ValueError(f"{self.channel_info}: only a device can tell of an error frame")
        data = bytes(msg.data).ljust(8, b"\0")
        if msg.arbitration_id & BUS_OFF:
            letter = "b"
        else:
            found = [name for name, bits in _STATES.items() if data[1] & bits]
            if not msg.arbitration_id & _CONTROLLER or not found:
                raise ValueError(
                    f"error frame {msg.arbitration_id:#x}: slcan can tell bus-off (0x40) and the"
                    " controller's state (0x4) only"
                )
            letter = found[-1].decode()
        return f"s{letter}{data[7]:03d}{data[6]:03d}\r".encode()

    # In.

    def _take(self) -> can.Message | None:
        if not self._frames:
            if self._out:
                self._flush()
            self._read_port()
        return self._frames.popleft() if self._frames else None

    def _wait(self, seconds: float) -> None:
        pause = self._ready - time.monotonic()
        if pause > 0:
            self._port.wait(min(seconds, pause), False)
        else:
            self._port.wait(seconds, bool(self._out))

    def _read_port(self) -> None:
        """Read what is there."""
        chunk = self._port.read()
        if chunk:
            self._consume(chunk)
        elif self._device and isinstance(self._port, Pty) and not self._port.connected:
            self.opened = False
            self._incomplete = b""
            self._out.clear()

    def _consume(self, chunk: bytes) -> None:
        text = self._incomplete + chunk
        if b"\a" in text:  # ends whatever came before, as a line end does
            text = text.replace(b"\a", b"\a\r")
        *lines, rest = text.split(b"\r")
        self._incomplete = rest[: _LONGEST + 1]
        now = time.time()
        for line in lines:
            if not line:
                continue  # "done" from a device; from a computer, nothing to do
            message = self._message(line, now)
            if message is not None and (
                not self._device or (self.opened and not self._is_listen_only)
            ):
                self._frames.append(message)
            elif self._device:
                self._handle_command(line, message is not None)
            else:
                self._handle_answer(line, now)

    def _message(self, line: bytes, now: float) -> can.Message | None:
        """Return the frame of a line without its end; None where it is none."""
        kind = _KINDS.get(line[0])
        if kind is None:
            return None
        extended, remote, is_fd, bit_rate_switch = kind
        stamped = self._stamps
        try:
            # Identifier and length make 4 digits, or 9, which one more zero makes 10.
            raw = unhexlify(b"0" + line[1:] if extended else line[1:])
        except ValueError:
            return None
        head = 5 if extended else 2
        word = int.from_bytes(raw[:head], "big")
        identifier, code = word >> 4, word & 15
        if identifier >= (EXTENDED_IDS if extended else STANDARD_IDS):
            return None
        if is_fd:
            if not self._fd:
                return None
            length = CAN_FD_DLC[code]
        elif code <= 8:
            length = code
        else:
            return None
        end = head if remote else head + length
        if len(raw) != (end + 2 if stamped else end):
            return None
        if stamped:
            milliseconds = int.from_bytes(raw[end:], "big")
            if milliseconds >= 60_000:
                return None
            now = self._unwrap(1e-3 * milliseconds, now)
        return can.Message(
            timestamp=now,
            arbitration_id=identifier,
            is_extended_id=extended,
            is_remote_frame=remote,
            channel=self.channel,
            dlc=length,
            data=None if remote else raw[head:end],
            is_fd=is_fd,
            bitrate_switch=bit_rate_switch,
        )

    def _unwrap(self, stamp: float, now: float) -> float:
        """Time of day [s] of a stamp modulo 60 s: the device's time since the first one."""
        if self._last_stamp is None:
            self._last_stamp = stamp, now, now
            return now
        last, arrived, time_of_day = self._last_stamp
        passed = (stamp - last) % _STAMP_PERIOD
        passed += _STAMP_PERIOD * max(0, round((now - arrived - passed) / _STAMP_PERIOD))
        self._last_stamp = stamp, now, time_of_day + passed
        return time_of_day + passed

    def _handle_answer(self, line: bytes, now: float) -> None:
        """Interpret a device's line that is no frame."""
        letter, text = line[:1], line[1:]
        if line.endswith(b"\a"):
            self.refused += 1
            if len(line) > 1:
                self.malformed += 1
        elif line in (b"z", b"Z"):
            pass  # a frame has gone out
        elif letter in self._awaited and _STATUS.fullmatch(line):
            self.status = LineStatus(int(text, 16))
            self._awaited.discard(letter)
        elif letter in self._awaited and letter == b"V" and text.isalnum():
            self.version = text.decode("ascii")
            self._awaited.discard(letter)
        elif _STATE.fullmatch(line):
            self._frames.append(_state_frame(text, now, self.channel))
        else:
            self.malformed += 1

    def _handle_command(self, line: bytes, is_frame: bool) -> None:
        """Answer a computer's line that is no frame, or a frame that this device may not send."""
        letter, text = line[:1], line[1:]
        answer = b""
        known = True
        if letter == b"C" and not text:
            self.opened = self._stamping = False
        elif letter in (b"O", b"L") and not text:
            known = not self.opened
            if known:
                self.opened, self._is_listen_only = True, letter == b"L"
        elif _SETTING.fullmatch(line):
            known = not self.opened
            if known and letter == b"Z":
                self._stamping = text == b"1"
        elif letter == b"F" and not text:
            answer = b"F%02X" % self.status
        elif letter == b"V" and not text:
            answer = b"V1013"
        elif letter == b"N" and not text:
            answer = b"N0001"
        else:
            known = False
            self.malformed += not is_frame
        self._write(answer + b"\r" if known else b"\a")


def _has_handle(port: Any) -> bool:
    """Return whether a port of pyserial is a file to the system; loop:// is none, nor is COM3."""
    try:
        return os.name == "posix" and port.fileno() >= 0
    except OSError:
        return False


def _makes_pty(channel: str) -> bool:
    return channel.startswith(_PTY)


def _command(name: str, value: int, commands: dict[int, str]) -> str:
    if value not in commands:
        raise ValueError(f"{name} {value} must be one of {', '.join(map(str, commands))} bit/s")
    return commands[value]


def _state_frame(text: bytes, now: float, channel: str) -> can.Message:
    """Return the error frame of SocketCAN for `bRRRTTT`: state and both error counters."""
    data = bytearray(8)
    data[6], data[7] = min(255, int(text[4:])), min(255, int(text[1:4]))
    if text[:1] == b"b":
        identifier = BUS_OFF
    else:
        identifier = _CONTROLLER
        data[1] = _STATES[text[:1]]
    return can.Message(
        timestamp=now,
        arbitration_id=identifier,
        is_extended_id=False,
        is_error_frame=True,
        channel=channel,
        data=data,
    )
