"""Records of runs that never kept to a clock: loop and board as fast as they go, times made up."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from harness.can.database import load
from harness.can.fault_injection import parse
from harness.can.reception import FAULTS
from harness.parts.can.feed import FeedPart
from harness.parts.ports import Column, Port
from harness.parts.settings import CanSettings
from harness.results.recorder import Recorder
from harness.results.result import Result
from harness.results.run_metadata import RunMetadata

from ..can.virtual import STEP, Rig

FEED = "sensors"
ON_BUS = ("age", "valid", "sample", "due", "load", *FAULTS)
CONDITIONS = {"priority": 50, "reason": "", "stolen": 0.0125}


def record(
    folder: Path,
    faults: Sequence[str] = (),
    ticks: int = 2000,
    seed: int = 0,
    hil: dict[str, Any] | None = None,
    **metadata: Any,
) -> Result:
    """The record of a run with faults; `hil` and `metadata` replace what it says about itself."""
    chance = np.random.default_rng(seed)
    rows: list[list[float]] = []

    def row(rig: Rig) -> None:
        node, reception = rig.loop, rig.loop.reception
        held = node.held.number if node.held is not None else -1
        latency = 1e-4 * chance.lognormal(1.0, 0.4) if node._fresh else 0.0
        rows.append(
            [
                min(node.age, 1e3),
                float(node.valid),
                held,
                node.number or 0,
                reception.load,
                *reception.counts.values(),
                node.mode,
                latency,
            ]
        )

    rig = Rig(faults=[parse(fault) for fault in faults], seed=seed, each=row)
    rig.run(ticks)
    part = FeedPart(FEED, CanSettings(can="instrument"), load("instrument"))
    ports = {port.name: port for port in part.outputs}
    commanded = {port.name: port for port in part.companion.outputs}
    columns = [
        *(_column(FEED, ports[name]) for name in ON_BUS),
        *(_column(part.companion.name, commanded[name]) for name in ("mode", "latency")),
    ]
    told = {
        "conditions": CONDITIONS,
        "notes": [],
        "log": None,
        "injected": {"faults": [*faults], "seed": seed},
        "limits": {},
        **rig.loop.metadata(),
        **(hil or {}),
    }
    whole = {
        "scenario": "case", "title": "A made-up run", "step": STEP, "settle": 0.0, "seed": seed,
        "roles": {}, "motions": {}, "delays": {}, "innovation_sizes": {}, "notes": [], "order": [],
        "machine": "none", "versions": {}, "texts": [], "overrides": {}, "undriven": [],
        "error": None, "wall": ticks * STEP, "ticks": ticks, "hil": told,
        "parts": {FEED: {"kind": "can"}, f"{FEED}.command": {"kind": "can", "of": FEED}},
        **metadata,
    }  # fmt: skip
    about = RunMetadata.read(whole, "made up")
    recorder = Recorder(folder, columns, STEP, about)
    for values in rows:
        recorder.append(np.array(values, float))
    return Result(recorder.finish(about))


def _column(part: str, port: Port) -> Column:
    return Column(f"{part}.{port.name}", port.type, port.unit_name, port.description)
