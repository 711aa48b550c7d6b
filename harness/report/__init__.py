"""The report of a run: one HTML file that needs nothing but a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from harness.display import shown
from harness.metrics import motion_of
from harness.report.consistency import consistency_plots
from harness.report.figures import figures
from harness.report.hil import hil_sections
from harness.report.page import ready, rendered, write_page
from harness.result import Result

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
    facts = result.facts
    drive = facts["roles"].get("drive", ())
    delays = tuple(facts["delays"].get(name, 0) for name in drive)
    ticks = len(result.time)
    drawn = (
        [
            *figures(result.time, motion_of(result), result.role("stroke"), delays),
            *consistency_plots(result.consistency),
        ]
        if ticks > 1
        else []
    )
    metrics = result.metrics
    recording = ", ".join(facts["motions"].values()) or "none"
    simulated = f"{ticks * facts['step']:g} s in {ticks} steps of {facts['step']:g} s"
    return {
        "title": facts["title"],
        "subtitle": f"{facts['scenario']}, recording: {recording}, {simulated}",
        "error": result.error,
        "notes": facts["notes"],
        "verdict": [
            (f"{metrics[name].value:.1f} %", text)
            for name, text in _VERDICT.items()
            if name in metrics
        ],
        "plots": rendered(drawn),
        "sections": ready(hil_sections(result)),
        "metrics": [
            (name, *shown(metric.value, metric.unit), metric.definition)
            for name, metric in metrics.items()
        ],
        "run": {
            "scenario": facts["scenario"],
            "recording": recording,
            "simulated": simulated,
            "wall time": f"{facts['wall']:.2f} s",
            "left out at the start": f"{facts['settle']:g} s",
            "seed": facts["seed"],
            "run order": ", ".join(facts["order"]),
            "machine": facts["machine"],
            "versions": ", ".join(f"{name} {text}" for name, text in facts["versions"].items()),
        },
        "parts": [
            {**part, "name": name, "settings": _start_values(part)}
            for name, part in facts["parts"].items()
        ],
        "texts": facts["texts"],
        "overrides": facts["overrides"],
        "undriven": facts["undriven"],
    }
