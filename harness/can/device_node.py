"""The board's node: samples out at its own pace, commands in.

It goes on the bus, waits for the loop's heartbeat to say operational, and then sends a sample each
period, whatever comes: status (each 100 ms, before the sample that it counts), the frames of the
sample, feedback (each 10 ms), heartbeat (each 100 ms). A command is applied from the next sample
on. Without a good one for its timeout, or with a command `off`, the drive is on its way to rest.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence

from harness.can.bus_node import BusNode
from harness.can.channel import Address, ChannelState, now
from harness.can.database import OFF, OPERATIONAL, PRE_OPERATIONAL, STOPPED, Database
from harness.can.fault_injection import FaultInjection, InjectedFault
from harness.can.precise_sleep import sleep_until
from harness.can.reception import ReceivedMessage, Reception
from harness.can.transmission import SentMessage, sent_messages
from harness.can.voltage_ramp import VoltageRamp
from harness.common.errors import FaultError

__all__ = ["DeviceNode"]

_ABANDONED = 10_000_000  # us without the loop's heartbeat after which the board ends


class DeviceNode(BusNode):
    """The node of an instrument's electronics.

    Attributes:
        faults: what is to go wrong.
        seed: of chance in it.
        injection: of these faults; None without any.
        ramp: voltages that are applied.
        mode: of the last command that was good; `OFF` without one.
        is_commanded: whether there is a good command.
        index: of the present sample.
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
        super().__init__(database, name, address, step, Reception(database, name, step * 1e6))
        self._step = step
        self._period = step / (1.0 + drift) * 1e9
        self.faults, self.seed = faults, seed
        self.injection = (
            FaultInjection(faults, seed, [m.id for m in database.messages]) if faults else None
        )
        self._messages = sent_messages(database, name, step, "status", "sample", "feedback")
        received = {m.message.role: m for m in reversed(self.reception.messages.values())}
        self._command, self._controller = received.get("command"), received.get("heartbeat")
        stacks = () if self._command is None else self._command.message.ports
        self.ramp = VoltageRamp([stack.range for stack in stacks], database.ramp_rate * step)
        self.mode = OFF
        self.is_commanded = False
        self.index = 0
        self.ended = False
        self._start = 0

    def wait_for_controller(self, stopped: Callable[[], bool]) -> bool:
        """Wait for the loop to be operational.

        Args:
            stopped: asked now and then whether to give up.

        Returns:
            Whether it is.
        """
        controller = self._controller
        while controller is None or not controller.values or controller.values[0] != OPERATIONAL:
            if stopped():
                return False
            self._wait_with_heartbeat(PRE_OPERATIONAL, 0.02)
            if controller is None:
                break
        self._start = time.monotonic_ns()
        return True

    def wait(self, index: int) -> None:
        """Wait for the instant of a sample, then receive what came since the last one.

        Raises:
            FaultError: the bus has failed.
        """
        sleep_until(self._start + int(index * self._period))
        self._receive_all()
        if self.channel.state is ChannelState.FAILED:
            raise FaultError(f"the CAN bus ({self.address}) failed: {self.channel.reason}")
        self.begin_cycle(index, now())

    def begin_cycle(self, index: int, time: int) -> None:
        """Begin a sample at a time [us]: apply the last command.

        A function of what was received and of the time alone.
        """
        self.index = index
        reception, command, controller = self.reception, self._command, self._controller
        reception.tick(time)
        reception.events.clear()
        if controller is not None and controller.last is not None:
            is_abandoned = time - controller.last > _ABANDONED
            self.ended = is_abandoned or controller.values[0] == STOPPED
        if command is None:
            return
        wanted, self.mode = self._commanded(command)
        self.is_commanded = wanted is not None
        self.ramp.step(wanted)

    def _commanded(self, command: ReceivedMessage) -> tuple[list[float] | None, int]:
        """Return the voltages of the last good command, None: rest; and its mode."""
        if command.last is None or command.silent or not command.in_sequence:
            return None, OFF
        signals = command.message.signals
        given = dict(zip((s.name for s in signals), command.values, strict=True))
        mode = int(given.get("mode", OFF))
        bad = any(command.bad_runs)
        volts = [given[s.name] for s in command.message.ports]
        return (None if mode == OFF or bad else volts), mode

    def transmit(self, values: Mapping[str, float]) -> None:
        """Send the sample of this instant, and what else is due.

        Args:
            values: of the signals, by name; what is missing is sent as not available.
        """
        index = self.index
        if self.injection is not None:
            self.injection.begin(self.channel, index, index * self._step)
            values = self.injection.values(values)
        content = {
            "field_new": 1.0,
            **values,
            "sample": float(index),
            "board_time": (index * self._step) % 4294.967296,
            "applied_mode": float(self.mode),
            **{f"applied_{i}": v for i, v in enumerate(self.ramp.volts, start=1)},
        }
        if any(index % max(1, heartbeat.every) == 0 for heartbeat in self._heartbeats):
            self._send_heartbeat(OPERATIONAL)
        for sent in self._messages:
            if sent.every and index % sent.every:
                continue
            data = [content.get(s.name, math.nan) for s in sent.message.signals]
            is_sample = sent.message.role == "sample"
            self._send(sent, sent.numbered(data, index) if is_sample else sent.frame(data))

    def _send(self, sent: SentMessage, data: bytes) -> None:
        m = sent.message
        if self.injection is None or not self._start:
            self.channel.send(m.id, data, m.is_fd, m.extended)
        else:
            self.injection(self.channel, m.id, data, m.is_fd, m.extended)

    def close(self) -> None:
        """Leave the bus."""
        if self._channel is not None:
            self._send_heartbeat(STOPPED)
            self._channel.close()
            self._channel = None
