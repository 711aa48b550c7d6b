"""The part of a report that is about the wall clock and the bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.can.fault_injection import parse
from harness.can.reception import FAULTS, PER_MESSAGE
from harness.common.quantities import format_quantity
from harness.common.types import FloatArray
from harness.report.page import Plot, Section, Table
from harness.report.plots import GREY, SERIES, flats, grid, layout, line, thinned
from harness.results.can_feed import feed_of, latencies, wakings
from harness.results.fault_episodes import Trouble, mode_of, troubles
from harness.results.limits import judge
from harness.results.result import Result

__all__ = ["hil_sections"]

_QUANTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
_BINS = 120
_MODES = ("off", "hold", "run")
_ROWS = 100
"""Of the table of faults, at the most."""
_TEXTS = 12
"""Of the events of one fault, at the most."""
_MARKS = 300
"""Places along the time axis at which faults are counted."""
_UNIT = 1e3  # ms


def hil_sections(result: Result) -> Iterator[Section]:
    """Yield one section for a run on the wall clock, none for others."""
    metadata = result.metadata.hil
    if metadata is None:
        return
    feed = feed_of(result)
    tables = [_conditions(result, metadata, feed)]
    plots: list[Plot] = []
    text = ["Ticks were paced by this machine's clock; there is no bus."]
    if feed is not None and "messages" in metadata:
        found = troubles(result)
        tables += [_messages(metadata), *([_fault_table(found)] if found else [])]
        tables.append(_checks(result))
        text = [_sentence(metadata, found)]
        if len(result.time) > 1:
            plots = [*_durations(result, feed), _over_time(result, feed)]
    yield Section(
        "On the wall clock",
        tuple(text),
        tuple(tables),
        tuple(plots),
        "\n".join(metadata["notes"]),
    )


def _time_text(seconds: float) -> str:
    """Format a time with its unit."""
    return " ".join(format_quantity(seconds, "s"))


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _sentence(metadata: Mapping[str, Any], found: Sequence[Trouble]) -> str:
    counted = [f"{kind} {count}" for kind, count in metadata["counts"].items() if count]
    held = sum(trouble.held for trouble in found)
    invalid = sum(trouble.invalid for trouble in found)
    return (
        f"Counted on the bus: {', '.join(counted) or 'no fault at all'}. The command did not "
        f"follow the controller for {_time_text(held)}, and samples were not to be used for "
        f"{_time_text(invalid)}."
    )


# Tables -------------------------------------------------------------------------------------------


def _drift_text(drift: float | None) -> str:
    if drift is None:
        return "not known: too few samples"
    return f"{abs(1e6 * drift):.1f} ppm {'slow' if drift > 0.0 else 'fast'}"


def _conditions(result: Result, metadata: Mapping[str, Any], feed: str | None) -> Table:
    rows = [("scheduling", _scheduling(metadata["conditions"]))]
    stolen = metadata["conditions"].get("stolen")
    rows.append(("stolen CPU", "not told" if stolen is None else f"{100 * stolen:.2g} %"))
    if feed is not None and "counts" in metadata:
        rows += [
            ("clock of the board", _drift_text(metadata["drift"])),
            ("overruns", _overruns(result, metadata["counts"], feed)),
            ("largest bus load", f"{100 * metadata['peak_load']:.0f} %"),
        ]
    injected = metadata.get("injected", {})
    if injected.get("faults"):
        words = f"{', '.join(injected['faults'])}; seed {injected['seed']}; in the board's time"
        ahead = _board_begun(result, feed) if feed is not None else 0.0
        words += f", {_time_text(ahead)} ahead of the run's" if ahead else ""
        rows.append(("faults that were asked for", words))
    if metadata.get("log"):
        rows.append(("log of frames", metadata["log"]))
    return Table(("the run", ""), tuple(rows))


def _scheduling(conditions: Mapping[str, Any]) -> str:
    if not conditions:
        return "none: a log that was run again"
    if conditions["priority"]:
        return f"SCHED_FIFO, priority {conditions['priority']}"
    reason = conditions["reason"]
    return f"that of an ordinary thread{f': {reason}' if reason else ''}"


def _overruns(result: Result, counts: Mapping[str, int], feed: str) -> str:
    step = result.metadata.step_size
    due = result.signals(f"{feed}.due")
    kinds = {
        "tick that took longer than a period": counts["overruns"],
        "sample that came after its tick": counts["late"],
        "tick left out": int(np.sum(np.diff(due) == 0.0)),
        f"wake-up later than {_time_text(step)}": int(np.sum(wakings(result, feed) > step)),
        f"command later than {_time_text(step)}": int(np.sum(latencies(result, feed) > step)),
    }
    return "; ".join(_plural(count, what) for what, count in kinds.items())


def _plural(count: int, what: str) -> str:
    """Format a count of things whose first word is the thing."""
    thing, _, more = what.partition(" ")
    return f"{_number(count, thing)} {more}"


def _messages(metadata: Mapping[str, Any]) -> Table:
    """Return a row for each message; all ids together have more kinds of faults."""
    rows = [
        (f"0x{counts['id']:03X}", name, *(str(counts[kind]) for kind in PER_MESSAGE))
        for name, counts in metadata["messages"].items()
    ]
    columns = ("id", "message", *PER_MESSAGE)
    return Table(columns, tuple(rows), frozenset(range(2, len(columns))))


def _checks(result: Result) -> Table:
    rows = [
        (each.name, each.found, "not as it should be" if each.failure else "good")
        for each in judge(result)
    ]
    return Table(("what is judged", "found", ""), tuple(rows))


def _fault_table(found: Sequence[Trouble]) -> Table:
    rows = [
        (
            f"{each.time:.3f}",
            _fault_text(each),
            _time_text(each.age),
            _response_text(each),
            _time_text(each.held),
            _time_text(each.invalid),
        )
        for each in found[:_ROWS]
    ]
    more = len(found) - len(rows)
    if more > 0:
        rows.append(("", f"and {more} more", "", "", "", ""))
    return Table(
        ("at, s", "what was found", "age, up to", "command", "held for", "invalid for"),
        tuple(rows),
        frozenset({0, 2, 4, 5}),
    )


def _fault_text(each: Trouble) -> str:
    texts = [*each.texts[:_TEXTS]]
    if len(each.texts) > _TEXTS:
        texts.append(f"and {len(each.texts) - _TEXTS} more")
    return "; ".join(texts) or "the sample was too old, or the controller's demand out of limits"


def _response_text(each: Trouble) -> str:
    if each.answer is None:
        return "followed the controller"
    return "held in the same tick" if not each.answer else f"held {_time_text(each.answer)} later"


# Plots --------------------------------------------------------------------------------------------


def _board_begun(result: Result, feed: str) -> float:
    """Time of the board at the beginning of the run [s]."""
    return float(result.signals(f"{feed}.due")[0]) * result.metadata.step_size


def _durations(result: Result, feed: str) -> Iterator[Plot]:
    """Yield histograms of latency and of wake-up, one below the other."""
    rows = {
        "latency": latencies(result, feed),
        "wake-up": wakings(result, feed),
    }
    rows = {name: values[values > 0.0] for name, values in rows.items()}
    rows = {name: values for name, values in rows.items() if len(values)}
    if not rows:
        return
    low = min(float(values.min()) for values in rows.values())
    high = max(float(values.max()) for values in rows.values())
    edges = np.geomspace(0.9 * low, 1.1 * high, _BINS + 1)
    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.12)
    for row, (name, values) in enumerate(rows.items(), start=1):
        _histogram(figure, row, name, values, edges)
    ticks = [a * 10.0**b for b in range(-3, 5) for a in (1, 2, 5)]
    # Room at the end for the words of the largest.
    span = np.log10([_UNIT * edges[0], 2.0 * _UNIT * edges[-1]])
    figure.update_xaxes(type="log", range=span, tickvals=ticks)
    figure.update_xaxes(title_text="time, ms", row=len(rows), col=1)
    marks = ", ".join(f"{q:g} %" for q in _QUANTILES[:-1])
    yield Plot(
        "Latency and wake-up",
        "Ticks by the time from the last frame of a sample to its command (latency) and to the "
        f"beginning of its tick (wake-up), both axes logarithmic. Marked: {marks} and the largest.",
        layout(figure, 60 + 230 * len(rows), showlegend=False),
    )


def _histogram(
    figure: go.Figure, row: int, name: str, values: FloatArray, edges: FloatArray
) -> None:
    counts, _ = np.histogram(values, edges)
    top = float(np.log10(counts.max()))
    # Nothing has no logarithm: an empty bin ends below the axis.
    heights = np.maximum(counts, 0.1).astype(float)
    bars = line(_UNIT * edges, np.append(heights, 0.1), SERIES[row - 1], name, shape="hv")
    figure.add_trace(bars.update(fill="tozeroy"), row=row, col=1)
    for place, quantile in enumerate(_QUANTILES):
        value = float(np.percentile(values, quantile))
        where = {"row": row, "col": 1}
        figure.add_vline(x=_UNIT * value, line={"color": GREY, "width": 1, "dash": "dot"}, **where)
        words = "max" if quantile == 100.0 else f"{quantile:g} %"
        figure.add_annotation(
            x=float(np.log10(_UNIT * value)),
            # One below the other: on a quiet machine they are close.
            y=(1.25 - 0.17 * place) * top,
            text=f"{words}: {_time_text(value)}",
            showarrow=False,
            xanchor="left",
            bgcolor="rgba(255,255,255,0.7)",
            font={"size": 11},
            **where,
        )
    figure.update_yaxes(
        type="log",
        title_text=f"{name}, ticks",
        range=[np.log10(0.7), 1.35 * top + 0.1],
        exponentformat="power",
        dtick=1,
        row=row,
        col=1,
    )


def _over_time(result: Result, feed: str) -> Plot:
    """Plot age, load, mode and faults over the time of the run."""
    time = result.time
    mode = mode_of(result, feed)
    counted = _counted(result, feed)
    age = thinned(time, _UNIT * np.maximum(result.signals(f"{feed}.age"), 1e-6))
    load = flats(time, 100.0 * result.signals(f"{feed}.load"))
    panels = [[[line(*age, SERIES[0], "age of the sample", width=0.8)]],
              [[line(*load, SERIES[2], "bus load")]]]  # fmt: skip
    names, heights = ["age, ms", "bus load, %"], [3.0, 2.0]
    if mode is not None:
        panels.append([[line(*flats(time, mode), SERIES[1], "mode", shape="hv")]])
        names.append("command")
        heights.append(1.2)
    if counted:
        panels.append([[_marks(kind, *marks) for kind, marks in counted.items()]])
        names.append("faults")
        heights.append(0.5 + 0.35 * len(counted))
    height = 120 + round(55 * sum(heights))
    figure = grid(panels, "time, s", names, height, vertical_spacing=0.04, row_heights=heights)
    figure.update_layout(showlegend=False)
    figure.update_yaxes(type="log", exponentformat="power", dtick=1, row=1, col=1)
    figure.update_yaxes(rangemode="tozero", row=2, col=1)
    if mode is not None:
        ticks = {"tickvals": list(range(len(_MODES))), "ticktext": _MODES, "range": [-0.3, 2.3]}
        figure.update_yaxes(**ticks, row=3, col=1)
    figure.update_xaxes(range=[0.0, float(time[-1])])
    _shade(figure, result, feed)
    return Plot(
        "In the course of the run",
        "Age of the sample that the loop computed with, share of the bus that frames take over "
        "0.1 s (an emulated bus has no bit rate, and takes more than all), mode of the command, "
        "and when which fault was counted. Grey: faults that the emulated board was asked for.",
        figure,
    )


def _marks(kind: str, at: FloatArray, counts: Sequence[int]) -> go.Scatter:
    """Return marks at the times of a kind of fault."""
    return go.Scatter(
        x=at,
        y=[kind] * len(at),
        mode="markers",
        marker={"color": SERIES[1], "symbol": "line-ns-open", "size": 9},
        text=[_number(count, "time") for count in counts],
        hovertemplate="%{y}, %{x:.2f} s: %{text}<extra></extra>",
        showlegend=False,
    )


def _counted(result: Result, feed: str) -> dict[str, tuple[FloatArray, list[int]]]:
    """Return times and counts of each kind of fault that occurred, few enough to be drawn."""
    time = result.time
    size = max(1, -(-len(time) // _MARKS))
    found = {}
    for kind in FAULTS:
        values = result.signals(f"{feed}.{kind}")
        ends = values[np.minimum(np.arange(size, len(time) + size, size), len(time)) - 1]
        more = np.diff(ends, prepend=values[0]).astype(int)
        places = np.flatnonzero(more > 0)
        if len(places):
            middle = np.minimum(places * size + size // 2, len(time) - 1)
            found[kind] = (time[middle], more[places].tolist())
    return found


def _shade(figure: go.Figure, result: Result, feed: str) -> None:
    """Shade where the emulated board was asked for faults."""
    begun, end = _board_begun(result, feed), float(result.time[-1])
    shapes, words = [], []
    for text in (result.metadata.hil or {}).get("injected", {}).get("faults", ()):
        fault = parse(text)
        left, right = max(fault.start - begun, 0.0), min(fault.end - begun, end)
        if left >= right:
            continue
        place = {"xref": "x", "yref": "paper"}
        grey = {"fillcolor": "#999999", "opacity": 0.2, "line_width": 0, "layer": "below"}
        shapes.append(
            {"type": "rect", "x0": left, "x1": right, "y0": 0.0, "y1": 1.0} | place | grey
        )
        word = {"text": fault.kind, "showarrow": False, "font": {"size": 11}}
        words.append({"x": left, "y": 1.0, "xanchor": "left", "yanchor": "bottom"} | place | word)
    # All at once: each call for one of them would go through all that there are.
    figure.update_layout(shapes=shapes, annotations=words)
