"""The report of a run: one HTML file that needs nothing but a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from harness.common.quantities import format_quantity
from harness.report.consistency import consistency_plots
from harness.report.figures import figures
from harness.report.hil import hil_sections
from harness.report.page import ready, rendered, write_page
from harness.results.metrics import metric_inputs_of
from harness.results.result import Result

__all__ = ["write_report"]

_VERDICT = {
    "reduction_in_band": "of the tremor band removed",
    "reduction_a_posteriori": "of the distance from the intent removed",
}


def write_report(result: Result) -> Path:
    """Write `report.html` beside the record; whatever the run has no signals for is left out."""
    return write_page(result.report, "report.html.j2", **_content(result))


def _start_values(part: dict[str, Any]) -> str:
    values = {k: v for k, v in part.get("start_values", {}).items() if k != "seed"}
    return json.dumps(values) if values else ""


def _content(result: Result) -> dict[str, Any]:
    metadata = result.metadata
    drive = metadata.roles.get("actuator_voltage", ())
    delays = tuple(metadata.delays.get(name, 0) for name in drive)
    ticks = len(result.time)
    drawn = (
        [
            *figures(result.time, metric_inputs_of(result), result.role("actuator_stroke"), delays),
            *consistency_plots(result.consistency),
        ]
        if ticks > 1
        else []
    )
    metrics = result.metrics
    recording = ", ".join(metadata.motions.values()) or "none"
    simulated = f"{ticks * metadata.step_size:g} s in {ticks} steps of {metadata.step_size:g} s"
    return {
        "title": metadata.title,
        "subtitle": f"{metadata.scenario}, recording: {recording}, {simulated}",
        "error": result.error,
        "notes": metadata.notes,
        "findings": metadata.findings,
        "verdict": [
            (f"{metrics[name].value:.1f} %", text)
            for name, text in _VERDICT.items()
            if name in metrics
        ],
        "plots": rendered(drawn),
        "sections": ready(hil_sections(result)),
        "metrics": [
            (name, *format_quantity(metric.value, metric.unit), metric.definition)
            for name, metric in metrics.items()
        ],
        "run": {
            "scenario": metadata.scenario,
            "recording": recording,
            "simulated": simulated,
            "wall time": f"{metadata.wall or 0.0:.2f} s",
            "left out at the start": f"{metadata.warm_up:g} s",
            "seed": metadata.seed,
            "run order": ", ".join(metadata.order),
            "machine": metadata.machine,
            "versions": ", ".join(f"{name} {text}" for name, text in metadata.versions.items()),
        },
        "parts": [
            {**part, "name": name, "settings": _start_values(part)}
            for name, part in metadata.parts.items()
        ],
        "texts": metadata.texts,
        "overrides": metadata.overrides,
        "undriven": metadata.unconnected,
    }
