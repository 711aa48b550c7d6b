"""The loop's node on the bus: sockets, clocks and waiting around `harness.can.cycle`.

    deadline     when sample n should arrive, plus the sample deadline

A tick begins when sample n or a later one is complete, or at the deadline. Frames are decoded as
they arrive, so that nothing is left to decode when the last one does.

Where nobody sends samples, as with a board that only drives, ticks keep to this machine's clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from harness.can.bus_node import BusNode
from harness.can.channel import Address, ChannelState, now
from harness.can.cycle import Command, ControllerCycle, CycleInput, Tick
from harness.can.database import OFF, OPERATIONAL, STOPPED, Database
from harness.can.frame_log import FrameLog
from harness.can.precise_sleep import sleep_until
from harness.can.timing import Timing
from harness.can.transmission import SentMessage
from harness.common.errors import FaultError

__all__ = ["ControllerNode"]

_SHUTDOWN_FRAMES = 3
"""Frames that say `off`: one may be lost."""


class ControllerNode(BusNode):
    """The node of estimator and controller.

    Attributes:
        cycle: decodes and checks what comes in, makes the commands.
        input: what the present tick has taken from the bus; None before the first.
        log: where all frames and ticks go, in their order; None: nowhere.
    """

    def __init__(
        self,
        database: Database,
        name: str,
        address: Address,
        timing: Timing,
        step: float,
        log: FrameLog | None = None,
    ) -> None:
        """Get ready; `open` goes on the bus.

        Args:
            database: of the bus.
            name: of this node in it.
            address: of the bus.
            timing: for late ticks, and how long the board is waited for.
            step: period of samples and ticks [s].
            log: for frames and ticks; None: nowhere.
        """
        self.cycle = ControllerCycle(database, name, timing, step)
        super().__init__(database, name, address, step, self.cycle.reception)
        self.log = log
        self._timing = timing
        self._step = step
        self._period = step * 1e6
        self._sample_deadline = timing.sample_deadline * 1e6
        self.input: CycleInput | None = None
        self._last_heartbeat: int | None = None
        self._start = 0

    def wait_for_board(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Say that this node is operational, and wait for the board's first sample.

        Args:
            stopped: asked now and then whether to give up.

        Raises:
            FaultError: nothing complete comes in time.
        """
        start = now()
        self._start = time.monotonic_ns()
        if not self.reception.has_samples:
            return
        while not self.reception.ready and not stopped():
            if now() - start > self._timing.startup_timeout * 1e6:
                raise FaultError(self._no_sample())
            self._wait_with_heartbeat(OPERATIONAL, 0.01)
            if self.channel.state is ChannelState.FAILED:
                raise FaultError(f"the CAN bus ({self.address}): {self.channel.reason}")
        # What came with the sample, a heartbeat that says operational.
        self._receive_all()

    def _no_sample(self) -> str:
        counts = {k: v for k, v in self.reception.counts.items() if v}
        seen = [m.message.name for m in self.reception.messages.values() if m.last is not None]
        heard = f"heard were {', '.join(seen)}" if seen else "nothing of the DBC file was heard"
        more = f"; dropped: {counts}" if counts else ""
        return (
            f"no complete sample within {self._timing.startup_timeout:g} s on the CAN bus "
            f"({self.address}): {heard}{more}. Is the board powered, its bit rate "
            f"{self.database.bitrate:g} bit/s, and {self.database.path.name} its message set?"
        )

    def wait(self, index: int, idle: Callable[[], None] = lambda: None) -> CycleInput:
        """Wait for the tick's sample or its deadline, and begin the tick.

        Args:
            index: of the tick.
            idle: called when there is time.

        Raises:
            FaultError: the bus has failed, or the loop is too late and `stop` is its policy.
        """
        reception, channel, previous = self.reception, self.channel, self.input
        deadline = now()
        overran = False
        if previous is not None:
            overran = deadline - previous.tick.time > self._period
            deadline = int(reception.clock.predict(previous.number + 1) + self._sample_deadline)
        ready = reception.ready
        if not ready:
            idle()
            if self.log is not None:
                self.log.flush()
        if not reception.has_samples:
            sleep_until(self._start + round(index * self._period * 1e3))
        while reception.has_samples and not (
            ready and (previous is None or ready[-1].number > previous.number)
        ):
            left = deadline - now()
            if not self._receive_one(max(left, 0) * 1e-6) and left <= 0:
                break
        is_behind = overran or not ready or now() - ready[-1].time > self._period / 2
        arrived = iter(lambda: self._next_frame(0.0), None) if is_behind else ()
        frames = [*arrived]
        channel.tick()
        tick = Tick(index, now(), channel.state, overran, channel.reason)
        taken = self.input = self.cycle.cycle(frames, tick)
        if self.log is not None:
            self.log.tick(tick.time, taken.packed())
        if tick.state is ChannelState.FAILED:
            raise FaultError(f"the CAN bus ({self.address}) failed: {channel.reason}")
        if taken.is_fresh and not taken.fault:
            channel.recovered()
        return taken

    def _next_frame(self, timeout: float) -> Any:
        frame = super()._next_frame(timeout)
        if frame is not None and self.log is not None:
            self.log.frame(frame)
        return frame

    def transmit(self, wanted: Sequence[float]) -> tuple[Command, float] | None:
        """Send the tick's command, and what else is due.

        Returns:
            The command, and its latency: time since the last frame of the tick's sample [s], 0
            without a fresh one. None where nothing is commanded.
        """
        command, taken, latency = self.cycle.command(wanted), self.input, 0.0
        if command is not None:
            assert self.cycle.command_message is not None
            sent = self._send(self.cycle.command_message, command.data)
            if sent is not None and taken is not None and taken.is_fresh and taken.sample:
                latency = (sent - taken.sample.time) * 1e-6
        self.send_heartbeat_if_due()
        return None if command is None else (command, latency)

    def send_heartbeat_if_due(self) -> None:
        """Say that this node is there, when it is time to."""
        index = self.input.tick.index if self.input is not None else 0
        last = self._last_heartbeat
        if last is None or any(h.every and index - last >= h.every for h in self._heartbeats):
            self._last_heartbeat = index
            self._send_heartbeat(OPERATIONAL)

    def _send(self, sent: SentMessage, data: bytes) -> int | None:
        m = sent.message
        message = self.channel.send(m.id, data, m.is_fd, m.extended)
        if message is None:
            return None
        self.reception.sent(sent.seconds)
        time: int = now()
        message.timestamp = time
        if self.log is not None:
            self.log.frame(message)
        return time

    def close(self) -> None:
        """Command on its way to rest, then off, then leave the bus."""
        if self._channel is None:
            return
        if self.cycle.is_commanding:
            self._shut_down()
        self._channel.close()
        self._channel = None

    def _shut_down(self) -> None:
        message = self.cycle.command_message
        assert message is not None
        instant = time.monotonic()
        count = 0
        while count < _SHUTDOWN_FRAMES and self.channel.state is ChannelState.OPEN:
            command = self.cycle.shutdown_command()
            count += command.mode == OFF
            self._send(message, command.data)
            instant += self._step
            while self._receive_one(max(0.0, instant - time.monotonic())):
                pass
        self._send_heartbeat(STOPPED)
