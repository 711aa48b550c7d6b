"""Figures of merit of a run on the wall clock.

lost       samples that were due and that no tick has seen
latency    from the last frame of a sample to the command that follows from it
wake-up    from the last frame of a sample to the beginning of its tick
"""

from __future__ import annotations

import numpy as np

from harness.common.types import FloatArray
from harness.results.metrics import Metric
from harness.results.signals import RecordedSignals

__all__ = ["feed_of", "figures_of", "latencies", "wakings"]

_QUANTILES = {"p50": 50.0, "p99": 99.0}


def feed_of(result: RecordedSignals) -> str | None:
    """Name of the part that is on a bus; None without one."""
    parts = result.metadata.parts
    return next((n for n, metadata in parts.items() if metadata.get("kind") == "can"), None)


def latencies(result: RecordedSignals, feed: str) -> FloatArray:
    """From the last frame of a sample to its command [s], of the ticks that had a new sample."""
    name = f"{feed}.command.latency"
    if name not in result.columns:
        return np.zeros(0)
    values = result.signals(name)
    return np.asarray(values[values > 0.0])


def wakings(result: RecordedSignals, feed: str) -> FloatArray:
    """From the last frame of a sample to the beginning of its tick [s], where it was in time."""
    due, sample = result.signals(f"{feed}.due"), result.signals(f"{feed}.sample")
    return np.asarray(result.signals(f"{feed}.age")[due == sample])


def figures_of(result: RecordedSignals) -> dict[str, Metric]:
    """Figures by name; none of a run that was not on the wall clock."""
    metadata = result.metadata.hil
    feed = feed_of(result)
    if metadata is None or feed is None:
        return {}
    due, sample = result.signals(f"{feed}.due"), result.signals(f"{feed}.sample")
    seen = np.unique(sample)
    lost = int(due[-1] - due[0]) + 1 - int(np.sum((seen >= due[0]) & (seen <= due[-1])))
    counts = metadata["counts"]
    found = {
        "lost_samples": Metric(lost, "1", "samples that were due and that no tick has seen"),
        "late_samples": Metric(counts["late"], "1", "samples that came after their tick"),
        "overruns": Metric(counts["overruns"], "1", "ticks that took longer than a period"),
        "invalid": Metric(
            100.0 * float(np.mean(result.signals(f"{feed}.valid") == 0.0)),
            "%",
            "share of ticks whose sample was not to be used",
        ),
    }
    for name, values, text in (
        ("latency", latencies(result, feed), "time from the last frame of a sample to its command"),
        ("wake_up", wakings(result, feed), "time from the last frame of a sample to its tick"),
    ):
        if len(values):
            for short, quantile in _QUANTILES.items():
                value = float(np.percentile(values, quantile))
                found[f"{name}_{short}"] = Metric(
                    value, "s", f"{quantile:g} % quantile of the {text}"
                )
    stolen = metadata["conditions"].get("stolen")
    if stolen is not None:
        text = "share of the machine's processor time that its owner took meanwhile"
        found["stolen"] = Metric(100.0 * stolen, "%", text)
    if metadata["peak_load"]:
        text = "largest share of the bus that frames took over 0.1 s"
        found["bus_load"] = Metric(100.0 * metadata["peak_load"], "%", text)
    return found
