"""The report of a run: one HTML file that needs nothing but a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from harness.display import shown
from harness.metrics import motion_of
from harness.record import replacing
from harness.report.figures import figures
from harness.result import Result

__all__ = ["write_report"]

_VERDICT = {
    "reduction_in_band": "of the tremor band removed",
    "reduction_a_posteriori": "of the distance from the intent removed",
}


def write_report(result: Result) -> Path:
    """Write `report.html` beside the record; whatever the run has no signals for is left out."""
    environment = Environment(
        loader=PackageLoader("harness", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.j2").render(**_content(result))
    with replacing(result.report) as part:
        part.write_text(page, encoding="utf-8")
    return result.report


def _start_values(part: dict[str, Any]) -> str:
    values = {k: v for k, v in part.get("start_values", {}).items() if k != "seed"}
    return json.dumps(values) if values else ""


def _content(result: Result) -> dict[str, Any]:
    facts = result.facts
    drive = facts["roles"].get("drive", ())
    delays = tuple(facts["delays"].get(name, 0) for name in drive)
    ticks = len(result.time)
    drawn = (
        figures(result.time, motion_of(result), result.role("stroke"), delays) if ticks > 1 else ()
    )
    metrics = result.metrics
    return {
        "title": facts["title"],
        "error": result.error,
        "notes": facts["notes"],
        "verdict": [
            (f"{metrics[name].value:.1f} %", text)
            for name, text in _VERDICT.items()
            if name in metrics
        ],
        "figures": [
            {
                "title": figure.title,
                "caption": figure.caption,
                "html": Markup(
                    figure.plot.to_html(
                        full_html=False,
                        include_plotlyjs=False,
                        config={"displaylogo": False, "responsive": True},
                    )
                ),
            }
            for figure in drawn
        ],
        "metrics": [
            (name, *shown(metric.value, metric.unit), metric.definition)
            for name, metric in metrics.items()
        ],
        "run": {
            "scenario": facts["scenario"],
            "recording": ", ".join(facts["motions"].values()) or "none",
            "simulated": f"{ticks * facts['step']:g} s in {ticks} steps of {facts['step']:g} s",
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
        # The script is the library's own file; it holds no `</script`.
        "plotly": Markup(get_plotlyjs()),
    }
