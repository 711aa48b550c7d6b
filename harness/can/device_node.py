"""The board's node: samples out at its own pace, commands in.

It goes on the bus, waits for the loop's heartbeat to say operational, and then sends a sample each
period, whatever comes: status (each 100 ms, before the sample that it counts), the frames of the
sample, feedback (each 10 ms), heartbeat (each 100 ms). A command is applied from the next sample
on. Without a good one for its timeout, or with a command `off`, the drive is on its way to rest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from harness.can.channel import Address, CanChannel, ChannelState, now
from harness.can.controller_node import Outgoing
from harness.can.database import OFF, OPERATIONAL, PRE_OPERATIONAL, STOPPED, Database
from harness.can.fault_injection import FaultInjection, InjectedFault
from harness.can.precise_sleep import sleep_until
from harness.can.reception import ReceivedMessage, Reception
from harness.can.voltage_ramp import VoltageRamp
from harness.common.errors import FaultError

__all__ = ["DeviceNode"]

_BEAT = 100_000  # us
_DESERTED = 10_000_000  # us without the loop's heartbeat after which the board ends


class DeviceNode:
    """The node of an instrument's electronics.

    Attributes:
        reception: what comes in.
        drive: voltages that are applied.
        mode: of the last command that was good; `OFF` without one.
        ended: the loop has said that it stops, or has not been heard for long.
    """

    def __init__(
        self,
        database: Database,
        name: str,
        address: Address,
        step: float,
        drift: float = 0.0,
        faults: Sequence[InjectedFault] = (),
        seed: int = 0,
    ) -> None:
        """Get ready; `open` goes on the bus.

        Args:
            database: of the bus.
            name: of this node in it.
            address: of the bus.
            step: period of the samples, by the board's clock [s].
            drift: by how much the board's clock is fast, relative.
            faults: what is to go wrong.
            seed: of chance in it.
        """
        self.database = database
        self._address = address
        self._step = step
        self._period = step / (1.0 + drift) * 1e9
        self._mischief = (
            FaultInjection(faults, seed, [m.id for m in database.messages]) if faults else None
        )
        self.reception = Reception(database, name, step * 1e6)
        sent = [Outgoing(m, database, step) for m in database.sent_by(name)]
        self._samples = [o for o in sent if o.message.role == "sample"]
        self._status = [o for o in sent if o.message.role == "status"]
        self._feedback = [o for o in sent if o.message.role == "feedback"]
        self._beats = [o for o in sent if o.message.role == "heartbeat"]
        heard = self.reception.heard.values()
        self._command = next((h for h in heard if h.message.role == "command"), None)
        self._loop = next((h for h in heard if h.message.role == "heartbeat"), None)
        stacks = () if self._command is None else self._command.message.ports
        self.drive = VoltageRamp([stack.range for stack in stacks], database.ramp_rate * step)
        self.mode = OFF
        self.index = 0
        self.ended = False
        self._begun = 0
        self._medium: CanChannel | None = None

    def open(self) -> None:
        """Go on the bus.

        Raises:
            FaultError: it does not open.
        """
        self._medium = CanChannel(self._address, self.database)

    def meet(self, stopped: Callable[[], bool]) -> bool:
        """Wait for the loop to be operational.

        Args:
            stopped: asked now and then whether to give up.

        Returns:
            Whether it is.
        """
        loop, beat = self._loop, 0
        while loop is None or not loop.values or loop.values[0] != OPERATIONAL:
            if stopped():
                return False
            there = now()
            if there >= beat:
                self._beat(PRE_OPERATIONAL)
                beat = there + _BEAT
            self._take_one(0.02)
            if loop is None:
                break
        self._begun = time.monotonic_ns()
        return True

    def wait(self, index: int) -> None:
        """Wait for the instant of a sample, then hear what came since the last one.

        Raises:
            FaultError: the bus has failed.
        """
        sleep_until(self._begun + int(index * self._period))
        while self._take_one(0.0):
            pass
        assert self._medium is not None
        if self._medium.state is ChannelState.FAILED:
            raise FaultError(f"the CAN bus ({self._address}) failed: {self._medium.reason}")
        self.index = index
        self._apply(now())

    def _apply(self, there: int) -> None:
        reception, command, loop = self.reception, self._command, self._loop
        reception.tick(there)
        reception.events.clear()
        if loop is not None and loop.last is not None:
            deserted = there - loop.last > _DESERTED
            self.ended = deserted or loop.values[0] == STOPPED
        if command is None:
            return
        wanted, self.mode = self._asked(command)
        self.drive.step(wanted)

    @property
    def is_commanded(self) -> bool:
        """True if there is a good command."""
        return self._command is not None and self._asked(self._command)[0] is not None

    def _asked(self, command: ReceivedMessage) -> tuple[list[float] | None, int]:
        """Voltages that the last good command asks for, None: rest; and its mode."""
        if command.last is None or command.silent or not command.in_sequence:
            return None, OFF
        signals = command.message.signals
        given = dict(zip((s.name for s in signals), command.values, strict=True))
        mode = int(given.get("mode", OFF))
        bad = any(command.runs)
        volts = [given[s.name] for s in command.message.ports]
        return (None if mode == OFF or bad else volts), mode

    def transmit(self, values: Mapping[str, float]) -> None:
        """Send the sample of this instant, and what else is due.

        Args:
            values: of the signals, by name; what is missing is sent as not available.
        """
        index = self.index
        assert self._medium is not None
        if self._mischief is not None:
            self._mischief.begin(self._medium, index, index * self._step)
            values = self._mischief.values(values)
        told = {
            "field_new": 1.0,
            **values,
            "sample": float(index),
            "board_time": (index * self._step) % 4294.967296,
            "applied_mode": float(self.mode),
            **{f"applied_{i}": v for i, v in enumerate(self.drive.volts, start=1)},
        }
        if any(index % max(1, beat.every) == 0 for beat in self._beats):
            self._beat(OPERATIONAL)
        for outgoing in (*self._status, *self._samples, *self._feedback):
            if outgoing.every and index % outgoing.every:
                continue
            content = [told.get(s.name, float("nan")) for s in outgoing.message.signals]
            is_sample = outgoing.message.role == "sample"
            frame = outgoing.numbered(content, index) if is_sample else outgoing.frame(content)
            self._send(outgoing, frame)

    def _beat(self, state: int) -> None:
        for beat in self._beats:
            self._send(beat, beat.frame([float(state)]))

    def _send(self, outgoing: Outgoing, data: bytes) -> None:
        assert self._medium is not None
        m = outgoing.message
        if self._mischief is None or not self._begun:
            self._medium.send(m.id, data, m.is_fd, m.extended)
        else:
            self._mischief(self._medium, m.id, data, m.is_fd, m.extended)

    def _take_one(self, timeout: float) -> bool:
        assert self._medium is not None
        message: Any = self._medium.receive(timeout)
        if message is None:
            return False
        id = message.arbitration_id | message.is_extended_id << 31
        odd = message.is_remote_frame or message.is_error_frame
        self.reception.take(message.timestamp, id, bytes(message.data), odd, message.is_fd)
        return True

    def close(self) -> None:
        """Leave the bus."""
        if self._medium is not None:
            self._beat(STOPPED)
            self._medium.close()
            self._medium = None
