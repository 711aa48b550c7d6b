"""What the terminal shows: progress of a run, its figures, the inside of scenarios and FMUs."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

from harness.common.quantities import format_quantity
from harness.results.variants import RANKED, VariantSummary

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from harness.parts.description import Description, Variable
    from harness.parts.ports import Port
    from harness.results.metrics import Metric
    from harness.system.assembly import System
    from harness.system.wire import Link

__all__ = ["Display", "fmu_table", "metrics_table", "system_tables"]


class Display:
    """Messages and a progress bar; silent on demand."""

    def __init__(self, console: Console, quiet: bool) -> None:
        """Show on a console, or not at all."""
        self._console = console
        self._quiet = quiet

    def status(self, text: str) -> None:
        """Say what is being done."""
        if not self._quiet:
            self._console.print(text, style="dim", markup=False, highlight=False, soft_wrap=True)

    def show(self, block: Table) -> None:
        """Print a table."""
        if not self._quiet:
            self._console.print(block)

    def files(self, **paths: Path) -> None:
        """Say where files are, those that exist."""
        for what, path in paths.items():
            if path.is_file():
                self.status(f"{what}: {path}")

    @contextmanager
    def progress(self) -> Iterator[Callable[[float, float], None]]:
        """Show a bar with per cent, rate in multiples of real time, and time left."""
        if self._quiet:
            yield lambda _done, _seconds: None
            return
        bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
        )
        begun = 0.0
        task = None

        def update(done: float, seconds: float) -> None:
            nonlocal begun, task
            if task is None:
                begun = time.perf_counter()
                bar.start()
                task = bar.add_task("running", total=seconds, rate="")
            spent = time.perf_counter() - begun
            rate = f"{done / spent:.1f} x real time" if spent > 0.0 else ""
            bar.update(task, completed=done, rate=rate)

        try:
            yield update
        finally:
            bar.stop()

    @contextmanager
    def counting(self, what: str) -> Iterator[Callable[[int, int, int], None]]:
        """Show a bar for counted things: per cent, how many, how many failed, time left."""
        if self._quiet:
            yield lambda _done, _all, _failed: None
            return
        bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            MofNCompleteColumn(),
            TextColumn("[red]{task.fields[failed]}"),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
        )
        task = None

        def update(done: int, count: int, failed: int) -> None:
            nonlocal task
            if task is None:
                bar.start()
                # What an earlier start has done says nothing about how fast it goes now.
                task = bar.add_task(what, total=count, completed=done, failed="")
            bar.update(task, completed=done, failed=f"{failed} failed" if failed else "")

        try:
            yield update
        finally:
            bar.stop()


def metrics_table(metrics: Mapping[str, Metric]) -> Table:
    """Name, value and unit for people, one row per figure."""
    table = Table("figure", box=None, pad_edge=False)
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, metric in metrics.items():
        table.add_row(name, *format_quantity(metric.value, metric.unit))
    return table


_COMPARED = ("reduction_in_band", "reduction_a_posteriori", "tip_rms", "tip_rms_uncompensated")


def comparison_table(runs: Mapping[str, Mapping[str, Metric]]) -> Table:
    """Return the main figures of several runs, one row each, and their mean."""
    table = Table(Column("run", overflow="fold"), box=None, pad_edge=False)
    for name in _COMPARED:
        units = {
            format_quantity(m[name].value, m[name].unit)[1] for m in runs.values() if name in m
        }
        words = escape(f"{name.replace('_', ' ')} [{', '.join(units)}]")
        table.add_column(words, justify="right", min_width=13)

    def row(title: str, values: list[list[Metric]]) -> None:
        cells = [
            format_quantity(sum(m.value for m in column) / len(column), column[0].unit)[0]
            if column
            else ""
            for column in values
        ]
        table.add_row(title, *cells)

    for run, metrics in runs.items():
        row(run, [[metrics[name]] if name in metrics else [] for name in _COMPARED])
    of_all = [[m[name] for m in runs.values() if name in m] for name in _COMPARED]
    row("mean", of_all)
    missing = [run for run, metrics in runs.items() if _COMPARED[0] not in metrics]
    if missing and len(missing) < len(runs):
        table.caption = f"The mean leaves out {', '.join(missing)}: nothing there could be reduced."
    return table


def ranking_table(found: Sequence[VariantSummary]) -> Table:
    """Mean and worst reduction of each variant."""
    table = Table(Column("variant", overflow="fold"), box=None, pad_edge=False)
    for name in RANKED:
        words = name.removeprefix("reduction_").replace("_", " ")
        table.add_column(escape(f"{words} [%], mean"), justify="right")
        table.add_column("worst", justify="right")
    for rank in found:
        cells = [f"{of[name]:.1f}" for name in RANKED for of in (rank.mean, rank.worst)]
        table.add_row(escape(rank.variant), *cells)
    return table


def system_tables(system: System) -> Iterator[Table | str]:
    """Parts in run order, wires with units and delays, inputs that nothing drives, notes."""
    scenario = system.scenario
    yield (
        f"[bold]{escape(scenario.title)}[/bold] ({scenario.name}): "
        f"{system.steps * scenario.step_size:g} s, step {scenario.step_size:g} s, "
        f"seed {scenario.seed}"
    )
    if scenario.variants:
        yield f"variants: {escape(', '.join(scenario.variants))}"
    parts = Table(
        "order", Column("part", no_wrap=True), "kind", "what", "inputs", "outputs", "seed"
    )
    for index, part in enumerate((system.parts[n] for n in system.wiring.order), start=1):
        metadata = part.metadata()
        parts.add_row(
            str(index),
            part.name,
            metadata["kind"],
            str(metadata.get("file", "")),
            str(len(part.inputs)),
            str(len(part.outputs)),
            str(metadata.get("seed") or ""),
        )
    yield parts
    wires = Table(
        Column("from", overflow="fold"),
        Column("to", overflow="fold"),
        "signals",
        "unit",
        "delay, samples",
    )
    for wire, links in itertools.groupby(system.wiring.links, key=lambda link: link.wire):
        ports = [_source_port(system, link) for link in links]
        units = dict.fromkeys(port.unit_name or port.type for port in ports)
        wires.add_row(
            wire.source, wire.target, str(len(ports)), ", ".join(units), str(wire.delay or "")
        )
    yield wires
    if system.wiring.unconnected:
        yield "inputs that keep their start value: " + ", ".join(system.wiring.unconnected)
    yield from system.notes


def _source_port(system: System, link: Link) -> Port:
    outputs = system.parts[link.source.part].outputs
    return next(port for port in outputs if port.name == link.source.port)


def fmu_table(description: Description) -> Iterator[Table | str]:
    """Identity, ports and parameters of an FMU."""
    model = description.model
    period = f", sample period {description.step:g} s" if description.step else ""
    yield (
        f"[bold]{escape(model.modelName)}[/bold] {model.version or ''} ({description.path.name}): "
        f"FMI {model.fmiVersion} co-simulation{period}, GUID {model.guid}, "
        f"sha256 {description.sha256}"
    )
    if model.description:
        yield escape(model.description)
    for causality in ("input", "output", "parameter"):
        variables = [v for v in description.variables.values() if v.causality == causality]
        if variables:
            yield _variables_table(causality, variables)


def _variables_table(title: str, variables: Sequence[Variable]) -> Table:
    # A name that is cut off cannot be copied into a scenario.
    table = Table(Column(title, no_wrap=True), "type", "unit", "start", "min", "max", "meaning")
    for variable in variables:
        table.add_row(
            escape(variable.name),
            variable.type,
            variable.unit,
            "" if variable.start is None else f"{variable.start}",
            f"{variable.low:g}" if math.isfinite(variable.low) else "",
            f"{variable.high:g}" if math.isfinite(variable.high) else "",
            escape(variable.description),
        )
    return table
