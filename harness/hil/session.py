"""One run on the wall clock: the board, the loop, the log, and what both have recorded."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from fmu_src.errors import SteadytipError
from harness.can.controller_node import ControllerNode
from harness.can.frame_log import SUFFIXES, FrameLog
from harness.common.errors import FaultError
from harness.common.processes import end_process
from harness.hil.board import BUS, part_on_bus, world_scenario
from harness.hil.clock import Session, TickClock, WallClock
from harness.hil.monitor import start_monitor
from harness.hil.realtime import realtime
from harness.hil.ring import Ring, RingWriter, memory_folder
from harness.loop.loop import LoopOutcome, Progress
from harness.parts.can.address import address_of
from harness.parts.can.feed import FeedPart
from harness.recordings.run_record import read_metadata, read_record, record_file
from harness.results.result import Result
from harness.running import perform, run_folder
from harness.scenario import load as scenarios
from harness.scenario.replaced import can_settings, is_on_bus
from harness.scenario.schema import Hil, Scenario
from harness.system.assembly import System, assemble
from harness.system.roles import roles

__all__ = ["FRAMES", "READY", "WORLD", "hil"]

FRAMES = "frames"
"""Stem of the log of frames in the folder of a run."""
WORLD = "board"
"""Folder of the emulated board's own record in it."""
_LOOP_RING, _BOARD_RING = "loop.ring", "board.ring"
READY = "on the bus"
"""Line with which an emulated board says that it is."""
_START_TIMEOUT = 120.0  # s for an emulated board to build and load its FMUs
_MARGIN = 10.0  # s that the C program's recording is longer than the run
_END_TIMEOUT = 20.0  # s for it to write its record


class _SampleClock(TickClock):
    """Ticks by the samples of a board."""

    def __init__(self, feed: str, node: ControllerNode, settings: Hil) -> None:
        super().__init__(realtime(settings.priority), feed, settings.watchdog)
        self._node = node

    def begin(self, idle: Callable[[], None]) -> None:
        """Wait for the board."""
        super().begin(idle)
        self._node.wait_for_board(lambda: self.is_stopped)

    def _wait(self, tick: int) -> int:
        return self._node.wait(tick, self._idle).steps


class _Board:
    """An emulated board in a process of its own."""

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        """Start it and wait until it is on the bus.

        Raises:
            SteadytipError: it is not in time, or ends before; with its own words.
        """
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        # What it says goes to a file: a pipe that nobody reads would stop it.
        self._output = folder / "board.txt"
        command = [sys.executable, "-c", "from harness.cli.main import main; main()", "board"]
        with self._output.open("wb") as output:
            self._process = subprocess.Popen(
                [*command, *arguments, "--out", str(folder)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                # Ctrl-C is for the loop, which then ends the board in order.
                start_new_session=True,
            )
        until = time.monotonic() + _START_TIMEOUT
        # As a whole line: what else it says may have these words in it.
        while READY not in self._output.read_text(errors="replace").splitlines():
            if self._process.poll() is not None or time.monotonic() > until:
                self._process.kill()
                raise SteadytipError(f"the emulated board did not start: {self._text()}")
            time.sleep(0.02)

    def _text(self) -> str:
        words = self._output.read_text(errors="replace").strip()
        return words or "it said nothing"

    def abandon(self) -> None:
        """End it at once, if it is still there."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def end(self) -> str:
        """Let it write its record and end.

        Returns:
            What is wrong with it; empty if nothing is.
        """
        try:
            # It ends by itself when the loop has said that it stops, and then writes its record.
            code = self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            if not end_process(self._process, _END_TIMEOUT):
                return f"the emulated board did not end within {_END_TIMEOUT:g} s and was killed"
            code = self._process.returncode
        return f"the emulated board ended with exit code {code}: {self._text()}" if code else ""


class _Firmware:
    """The board's C program; the world that it is in is simulated before and after.

    What the sensors feel does not depend on the tip, so that they can be recorded beforehand; where
    the tip was follows afterwards from the voltages that the board has applied.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        link: Path,
        motion: Path | None,
        faults: Sequence[str],
        seed: int,
    ) -> None:
        """Record the sensors, start the program, and wait for its terminal.

        Raises:
            SteadytipError: it does not start; with its own words.
        """
        from harness.can.firmware.process import CHANNELS, FirmwareBoard, write_samples

        self.folder = folder
        self._scenario, self._motion = scenario, motion
        name = part_on_bus(scenario)
        length = dataclasses.replace(scenario, seconds=scenario.seconds + _MARGIN)
        world = assemble(world_scenario(length), motion)
        sensed = perform(world, folder / "sensors", report=False)
        volts = np.column_stack([sensed.signals(f"{name}.volts_{c}") for c in CHANNELS])
        samples = write_samples(
            folder / "samples.csv", volts, sensed.signals(f"{name}.temperature")
        )
        self._board = FirmwareBoard(
            samples,
            can_settings(scenario.parts[name]).can,
            link=link,
            faults=faults,
            seed=seed,
            priority=scenario.hil.priority,
        )
        self._board.start()

    def abandon(self) -> None:
        """End it at once, if it is still there."""
        self._board.stop()

    def end(self) -> str:
        """End it, and find out where the tip was; see `_Board.end`."""
        self._board.stop()
        try:
            self._board.check()
            applied = self._board.log
        except SteadytipError as error:
            return str(error)
        count = len(applied["sample"])
        step = self._scenario.step_size
        if not count:
            return ""
        command = self.folder / "command.parquet"
        names = [name for name in applied if name.startswith("volts_")]
        fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
        fields += [
            pa.field(f"{BUS}.{name}", pa.float64(), metadata={"unit": "V"}) for name in names
        ]
        columns = [np.arange(count) * step, *(applied[name] for name in names)]
        parquet.write_table(pa.table(columns, schema=pa.schema(fields)), command)
        length = dataclasses.replace(self._scenario, seconds=count * step)
        world = assemble(world_scenario(length, command), self._motion)
        perform(world, self.folder, report=False)
        return ""


class _LoopSession(Session):
    """The loop's clock, log and board; see `harness.running.HilSession`."""

    def __init__(
        self,
        clock: TickClock,
        system: System,
        folder: Path,
        board: _Board | _Firmware | None,
        ring: RingWriter | None,
        injected: Mapping[str, Any],
        node: ControllerNode | None = None,
    ) -> None:
        """Take over what belongs to the run.

        Args:
            clock: of the ticks.
            system: that runs.
            folder: of the run.
            board: the emulated one; None without.
            ring: that shows each tick; None without a monitor.
            injected: faults that the emulated board was asked for, and their seed.
            node: of the loop; None without a bus.
        """
        super().__init__(clock, ring)
        self._clock = clock
        self._system = system
        self._folder = folder
        self._board = board
        self._injected = injected
        self._node = node

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        """See `harness.running.HilSession.closed`."""
        super().closed(outcome)
        notes = []
        log = self._node.log if self._node is not None else None
        if log is not None:
            try:
                log.close()
            except FaultError as error:
                notes.append(str(error))
        if self._board is not None:
            problem = self._board.end()
            notes += [problem] * bool(problem)
        conditions = self._clock.conditions
        limits = self._system.scenario.hil.limits
        return {
            "hil": {
                "conditions": conditions.metadata() if conditions is not None else {},
                "notes": notes,
                "log": log.path.name if log is not None else None,
                "injected": self._injected,
                "limits": {n: limit.model_dump() for n, limit in limits.items()},
                **({} if self._node is None else self._node.cycle.metadata()),
            }
        }

    def extra_columns(self) -> tuple[pa.Table | None, dict[str, Any]]:
        """Return what the emulated board has recorded of the world, at the samples of the ticks."""
        if self._board is None or not self._clock.name:
            return None, {}
        try:
            world = read_record(record_file(self._board.folder))
            loop = read_record(record_file(self._folder))
        except SteadytipError:
            return None, {}
        table = _joined(loop, self._clock.name, world)
        system = self._system
        columns = [*loop.column_names, *table.column_names]
        parts = {name: part.metadata() for name, part in system.parts.items()}
        return table, {
            "roles": {role: list(names) for role, names in roles(system.scenario, columns).items()},
            "parts": {**read_metadata(world.schema).get("parts", {}), **parts},
        }


def _joined(loop: pa.Table, feed: str, world: pa.Table) -> pa.Table:
    """Rows of the world at the samples that were due in the ticks, less what the loop has itself.

    Args:
        loop: record of the loop.
        feed: its part on the bus.
        world: record of the board, one row for each sample from 0 on.
    """
    due = loop.column(f"{feed}.due").to_numpy()
    rows = pa.array(np.clip(due, 0, len(world) - 1))
    taken = [name for name in world.column_names if name not in set(loop.column_names)]
    return world.select(taken).take(rows)


def hil(
    scenario: str | os.PathLike[str],
    *,
    motion: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] | None = None,
    faults: Sequence[str] = (),
    fault_seed: int = 0,
    monitor: bool = False,
    port: int = 0,
    csv: bool = False,
    report: bool = True,
    status: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _done, _seconds: None,
) -> Result:
    """Run a scenario on the wall clock, with boards on a bus where it has any.

    Args:
        scenario: path of a scenario file, or the name of a shipped one.
        motion: recording that moves the hand, in the loop or in the emulated board.
        overrides: values by dotted key, put in place of the scenario's.
        out: folder for the results; by default `build/runs/SCENARIO/NUMBER`.
        faults: of the emulated board; see `harness.can.fault_injection`.
        fault_seed: of chance in them.
        monitor: serve a page that shows the run; `status` is told where.
        port: of that page on the loopback address; 0: a free one.
        csv: write the signals as CSV, too.
        report: write `report.html`.
        status: told in a few words what is being done.
        progress: told the time done and in all [s], some times a second.

    Raises:
        RunError: the run ended early; its `result` holds what was recorded until then.
        SteadytipError: a mistake in the scenario, or the board does not start; nothing was run.
    """
    changes = dict(overrides or {})
    checked = scenarios.load(scenario, changes)
    on_bus = any(is_on_bus(table) for table in checked.parts.values())
    if on_bus:
        part_on_bus(checked)
    elif checked.hil.board != "none":
        raise SteadytipError(f"{checked.name} has no part on a CAN bus that a board could be at")
    with ExitStack() as folders:
        bus = folders.enter_context(_folder("bus"))
        rings = Path(folders.enter_context(_folder("rings", memory_folder()))) if monitor else None
        addresses: tuple[str, str] | None = None
        if checked.hil.board != "none":
            name = part_on_bus(checked)
            addresses = _addresses(checked, name, Path(bus))
            changes |= {f"part.{name}.channel": addresses[0]}
            if checked.hil.board == "c":
                changes |= {f"part.{name}.interface": "slcanbulk"}
            checked = scenarios.load(scenario, changes)
        emulated = addresses is not None
        path = Path(motion) if motion is not None else None
        system = assemble(checked, None if emulated else path, status)
        folder = run_folder(system, out)
        board: _Board | _Firmware | None = None
        if addresses is not None:
            status("starting the emulated board")
        if addresses is not None and checked.hil.board == "c":
            board = _Firmware(checked, folder / WORLD, Path(addresses[0]), path, faults, fault_seed)
        elif addresses is not None:
            arguments = _arguments(scenario, changes, addresses[1], path, faults, fault_seed)
            if rings is not None:
                arguments += ["--ring", str(rings / _BOARD_RING)]
            board = _Board(arguments, folder / WORLD)
        ring = None
        with ExitStack() as stack:
            if board is not None:
                stack.callback(board.abandon)
            if rings is not None:
                ring = Ring.create(rings / _LOOP_RING, system.columns, checked.step_size)
                shown = [rings / _LOOP_RING, *[rings / _BOARD_RING] * isinstance(board, _Board)]
                known = _signals(checked, moved=path is not None)
                page = stack.enter_context(start_monitor(shown, known, port))
                status(f"monitor: {page.url}")
            injected = {"faults": list(faults), "seed": fault_seed} if emulated else {}
            node: ControllerNode | None = None
            clock: TickClock
            feeds = [part for part in system.parts.values() if isinstance(part, FeedPart)]
            if feeds:
                system, node, clock = _sample_clock(system, feeds[0], folder)
            else:
                settings = checked.hil
                clock = WallClock(checked.step_size, settings.watchdog, settings.priority)
            session = _LoopSession(clock, system, folder, board, ring, injected, node)
            return perform(
                system,
                folder,
                session=session,
                csv=csv,
                report=report,
                status=status,
                progress=progress,
            )


def _folder(what: str, where: Path | None = None) -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix=f"steadytip-{what}-", dir=where, ignore_cleanup_errors=True)


def _signals(scenario: Scenario, moved: bool) -> dict[str, Sequence[str]]:
    """Roles of the scenario as a monitor takes them; a recording does not know the intent."""
    named = {role: patterns for role, patterns in scenario.signals if patterns is not None}
    if moved:
        named.pop("intent", None)
    return {role: [p] if isinstance(p, str) else p for role, p in named.items()}


def _addresses(scenario: Scenario, name: str, folder: Path) -> tuple[str, str]:
    """Channels of the loop's and of the board's end of a bus that is made for one run."""
    settings = can_settings(scenario.parts[name])
    interface = settings.interface
    if scenario.hil.board == "c":
        interface = "slcanbulk"  # the C program speaks nothing else
    if interface == "unixbus":
        channel = settings.channel or str(folder)
        return channel, channel
    if interface == "slcanbulk":
        link = settings.channel or str(folder / "tty")
        return link, f"pty:{link}"
    raise SteadytipError(
        f"part '{name}': an emulated board is at the interfaces 'unixbus' and 'slcanbulk', not at "
        f"'{interface}'; with hil.board = \"none\" the loop takes the board that is there"
    )


def _arguments(
    scenario: str | os.PathLike[str],
    changes: Mapping[str, Any],
    channel: str,
    motion: Path | None,
    faults: Sequence[str],
    seed: int,
) -> list[str]:
    """Return the arguments with which an emulated board is started."""
    import json

    arguments = [str(scenario), "--channel", channel]
    for key, value in changes.items():
        if not key.endswith(".channel"):
            arguments += ["--set", f"{key}={json.dumps(value)}"]
    if motion is not None:
        arguments += ["--motion", str(motion)]
    for fault in faults:
        arguments += ["--fault", fault]
    return [*arguments, "--fault-seed", str(seed)]


def _sample_clock(
    system: System, feed: FeedPart, folder: Path
) -> tuple[System, ControllerNode, TickClock]:
    """Put the loop's end on the bus: the system with its node, the node, and the ticks by it."""
    settings = system.scenario.hil
    log = None
    if settings.log != "none":
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in SUFFIXES.values():
            (folder / f"{FRAMES}{suffix}").unlink(missing_ok=True)
        log = FrameLog(folder / f"{FRAMES}{SUFFIXES[settings.log]}")
    step, address = system.scenario.step_size, address_of(feed.keys)
    node = ControllerNode(feed.database, feed.keys.node, address, settings, step, log)
    system = dataclasses.replace(system, parts={**system.parts, **feed.on_bus(node)})
    return system, node, _SampleClock(feed.name, node, settings)
