"""Loops that are measured against each other, each in a process of its own.

All run the same FMUs with the same wiring and step. A contender is opened once and then asked for
blocks of ticks; each tells how long its ticks took by its own clock.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from fmu_src.errors import SteadytipError
from harness.scenario.load import load

__all__ = ["HOSTS", "OPENERS", "HostProcess", "PlainLoop", "absent_host"]

Block = Callable[[int], float]
"""Given a number of ticks, it runs them and says how long they took [s]."""

_OPENING_TIME = 60.0  # s for a contender to open
HOSTS = {
    "libcosim": ("libcosimpy", "pip install 'steadytip[hosts]'"),
    "Ecos": ("ecospy", "pip install 'steadytip[hosts]', and libtbb12 of the system"),
}
"""Other people's: module, and what to do where it is missing."""


def absent_host(name: str) -> str:
    """Return why another host cannot be used here; empty if it can."""
    module, cure = HOSTS[name]
    found = importlib.util.find_spec(module) is not None
    if found:
        # Loading its libraries may fail, in whatever way.
        loads = [sys.executable, "-c", f"import {module}"]
        found = subprocess.run(loads, capture_output=True).returncode == 0
    return "" if found else f"{name} is not installed: {cure}"


def _harness(scenario: str, ssp: Path, folder: Path) -> Block:
    """Return blocks of this harness with its record; each is the ticks of a whole run."""
    from harness.running import run
    from harness.scenario.load import load

    def block(ticks: int) -> float:
        overrides = {"seconds": ticks * step, "warm_up": 0.0}
        result = run(scenario, overrides=overrides, out=folder / "own", report=False)
        assert result.metadata.ticks == ticks
        return float(result.metadata.wall or 0.0)

    step = load(scenario).step_size
    return block


class PlainLoop:
    """FMUs stepped one after the other with fmpy's own calls.

    As one writes such a loop by hand, with what can be prepared prepared. All outputs of all ticks
    are kept.

    Attributes:
        names: of the outputs, `part.port`.
        rows: of their values, a list for each tick.
    """

    def __init__(self, scenario: str, folder: Path) -> None:
        """Load and initialise the FMUs of a scenario.

        Args:
            scenario: path of a scenario file, or the name of a shipped one.
            folder: to unpack FMUs in.
        """
        import fmpy
        from fmpy.fmi2 import FMU2Slave

        from harness.parts.fmu import FmuPart
        from harness.system.assembly import assemble

        system = assemble(load(scenario))
        self.step = system.scenario.step_size
        self.names: list[str] = []
        self.rows: list[list[float]] = []
        self._tick = 0
        slaves: dict[str, Any] = {}
        outputs: list[tuple[Any, str, list[int], slice]] = []
        place: dict[tuple[str, str], int] = {}
        starts: dict[str, FmuPart] = {}
        for name in system.wiring.order:
            part = system.parts[name]
            assert isinstance(part, FmuPart)
            path = str(part.description.path)
            described = fmpy.read_model_description(path)
            slaves[name] = slave = FMU2Slave(
                guid=described.guid,
                unzipDirectory=fmpy.extract(path, folder / name),
                modelIdentifier=described.coSimulation.modelIdentifier,
                instanceName=name,
            )
            slave.instantiate()
            starts[name] = part
            for kind in ("Real", "Integer", "Boolean"):
                ports = [
                    v
                    for v in described.modelVariables
                    if v.causality == "output" and v.type == kind
                ]
                if ports:
                    span = slice(len(self.names), len(self.names) + len(ports))
                    place |= {(name, v.name): span.start + i for i, v in enumerate(ports)}
                    self.names += [f"{name}.{v.name}" for v in ports]
                    get = getattr(slave, f"get{kind}")
                    outputs.append((get, name, [v.valueReference for v in ports], span))
        self._signals = [0.0] * len(self.names)
        self._plan = []
        for name in system.wiring.order:
            variables = starts[name].description.variables
            links = [link for link in system.wiring.links if link.target.part == name]
            sets = []
            for kind in ("Real", "Integer", "Boolean"):
                into = [link for link in links if variables[link.target.port].type == kind]
                if into:
                    references = [variables[link.target.port].reference for link in into]
                    sources = [place[link.source] for link in into]
                    known = [link.delay == 0 for link in into]
                    sets.append((getattr(slaves[name], f"set{kind}"), references, sources, known))
            gets = [(get, refs, span) for get, owner, refs, span in outputs if owner == name]
            self._begin(slaves[name], starts[name], sets, gets)
            self._plan.append((slaves[name].doStep, [s[:3] for s in sets], gets))

    def _begin(self, slave: Any, part: Any, sets: Sequence[Any], gets: Sequence[Any]) -> None:
        for name, value in part.start_values.items():
            variable = part.description.variables[name]
            getattr(slave, f"set{variable.type}")([variable.reference], [value])
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        for put, references, sources, known in sets:
            pairs = [(r, s) for r, s, k in zip(references, sources, known, strict=True) if k]
            if pairs:
                put([r for r, _ in pairs], [self._signals[s] for _, s in pairs])
        slave.exitInitializationMode()
        for get, references, span in gets:
            self._signals[span] = get(references)

    def run(self, ticks: int) -> None:
        """Go on for some ticks."""
        signals, plan, rows, step = self._signals, self._plan, self.rows, self.step
        for tick in range(self._tick, self._tick + ticks):
            for do_step, sets, gets in plan:
                for put, references, sources in sets:
                    put(references, [signals[i] for i in sources])
                do_step(tick * step, step)
                for get, references, span in gets:
                    signals[span] = get(references)
            rows.append(signals.copy())
        self._tick += ticks


def _fmpy(scenario: str, ssp: Path, folder: Path) -> Block:
    loop = PlainLoop(scenario, folder)

    def block(ticks: int) -> float:
        loop.rows.clear()
        return _spent(lambda: loop.run(ticks))

    return block


def open_libcosim(ssp: Path, step: float) -> Any:
    """Open libcosim's execution with the fixed-step algorithm; nothing observes."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level

    log_output_level(CosimLogLevel.ERROR)
    return CosimExecution.from_ssp_file(str(ssp), step_size=round(step * 1e9))


def _libcosim(scenario: str, ssp: Path, folder: Path) -> Block:

    execution = open_libcosim(ssp, load(scenario).step_size)
    return lambda ticks: _spent(lambda: execution.step(ticks))


def _libcosim_kept(scenario: str, ssp: Path, folder: Path) -> Block:
    """Return blocks of libcosim with its own observer, which keeps all outputs in memory."""
    from libcosimpy.CosimEnums import CosimVariableCausality, CosimVariableType
    from libcosimpy.CosimObserver import CosimObserver

    execution = open_libcosim(ssp, load(scenario).step_size)
    observer = CosimObserver.create_time_series()
    execution.add_observer(observer)
    for part in execution.slave_infos():
        for variable in execution.slave_variables(part.index):
            if variable.causality == CosimVariableCausality.OUTPUT.value:
                kind = CosimVariableType(variable.type)
                if kind in (CosimVariableType.REAL, CosimVariableType.INTEGER):
                    observer.start_time_series(part.index, variable.reference, kind)
    return lambda ticks: _spent(lambda: execution.step(ticks))


def open_ecos(ssp: Path, step: float) -> Any:
    """Open Ecos's simulation with the fixed-step algorithm, initialised; nothing listens."""
    from ecospy import EcosSimulation

    simulation = EcosSimulation(step, ssp_path=str(ssp))
    simulation.init(parameter_set=ssp.stem)
    return simulation


def _ecos(scenario: str, ssp: Path, folder: Path) -> Block:

    simulation = open_ecos(ssp, load(scenario).step_size)
    return lambda ticks: _spent(lambda: simulation.step(ticks))


OPENERS: dict[str, Callable[[str, Path, Path], Block]] = {
    "harness, recorded": _harness,
    "fmpy, kept in lists": _fmpy,
    "libcosim, nothing kept": _libcosim,
    "libcosim, kept in memory": _libcosim_kept,
    "Ecos, nothing kept": _ecos,
}
"""From scenario, the same as an SSP file named after it, and a folder, to blocks of ticks."""


def _spent(action: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    action()
    return time.perf_counter() - begun


def _serve(name: str, scenario: str, ssp: Path, folder: Path, pipe: Connection) -> None:
    try:
        block = OPENERS[name](scenario, ssp, folder)
    except Exception as error:
        pipe.send(f"{type(error).__name__}: {error}")
        return
    pipe.send("")
    while ticks := pipe.recv():
        pipe.send(block(ticks))


class HostProcess:
    """One of `OPENERS` in a process of its own, until it is closed."""

    def __init__(self, name: str, scenario: str, ssp: Path, folder: Path) -> None:
        """Open it.

        Args:
            name: which one.
            scenario: path of a scenario file, or the name of a shipped one.
            ssp: the same as an SSP file.
            folder: for its files.

        Raises:
            SteadytipError: it cannot be had here.
        """
        host = name.partition(",")[0]
        reason = absent_host(host) if host in HOSTS else ""
        if reason:
            raise SteadytipError(reason)
        self.name = name
        self._pipe, theirs = multiprocessing.Pipe()
        self._process = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(name, scenario, ssp, folder, theirs), daemon=True
        )
        self._process.start()
        theirs.close()
        self._receive(_OPENING_TIME)

    def block(self, ticks: int) -> float:
        """Run some ticks; how long they took [s].

        Raises:
            SteadytipError: its process has ended.
        """
        self._pipe.send(ticks)
        return float(self._receive(None))

    def close(self) -> None:
        """End its process."""
        if self._process.is_alive():
            self._pipe.send(0)
            self._process.join(5.0)
            self._process.kill()

    def __enter__(self) -> HostProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self, timeout: float | None) -> Any:
        try:
            if not self._pipe.poll(timeout):
                self._process.kill()
                raise SteadytipError(f"{self.name} is not open after {timeout:g} s")
            answer = self._pipe.recv()
        except EOFError:
            self._process.join()
            raise SteadytipError(
                f"{self.name}: its process ended with code {self._process.exitcode}"
            ) from None
        if isinstance(answer, str) and answer:
            raise SteadytipError(f"{self.name} does not open: {answer}")
        return answer
