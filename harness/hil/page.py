"""The monitor's page: Dash draws it and asks for new data four times a second.

A figure goes to the browser once; then only its curves do. The page holds nothing of other hosts.
"""

from __future__ import annotations

import base64
import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dash
import numpy as np
import plotly.graph_objects as go
from dash import dcc, html
from plotly.subplots import make_subplots

from harness.common.quantities import format_quantity
from harness.common.types import FloatArray
from harness.hil.monitor_view import MODES, WINDOW, MonitoredRings, MonitorState, View, histogram
from harness.report.figures import colour, three_rows
from harness.report.page import page_text
from harness.report.plots import GREY, SERIES, layout, line, thinned
from harness.results.metrics import TREMOR_BAND

__all__ = ["PERIOD", "application"]

PERIOD = 0.25
"""Between two refreshes [s]."""

_POINTS = 1000
_BEFORE, _AFTER = "without compensation", "with compensation"
_SPECTRUM = 25.0  # Hz
_VOLTS = 2.0  # s
_NO_ANSWER = 2.5  # s without an answer
_MICRO, _MILLI = 1e6, 1e3

Curve = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class _Panel:
    """One figure of the page: what it is made of, and its curves for a view.

    Attributes:
        figure: with as many empty curves as `curves` gives.
        curves: none where the rings do not have what it shows.
    """

    id: str
    title: str
    caption: str
    wide: bool
    figure: Callable[[View], go.Figure]
    curves: Callable[[View], list[Curve]]


def application(rings: MonitoredRings) -> dash.Dash:
    """Return the page and the callbacks that answer its requests.

    Args:
        rings: asked for a view whenever a page wants one.
    """
    app = dash.Dash(
        "steadytip",
        title="Steadytip: live",
        update_title="",
        include_assets_files=False,
        serve_locally=True,
    )
    subtitle = f"The last {WINDOW:g} s, read from memory that the loop writes to."
    app.index_string = page_text("monitor.html.j2", "{%title%}", subtitle, plotly="")
    app.layout = _page()
    outputs = [dash.Output(name, what) for name, what in _FIXED]
    for panel in _PANELS:
        outputs += [dash.Output(f"{panel.id}-box", "hidden"), dash.Output(panel.id, "figure")]
    cache = _ViewCache(rings)

    # A page that is slow to draw asks less often, rather than for what it will never show.
    @app.callback(
        outputs,
        dash.Input("beat", "n_intervals"),
        dash.State("drawn", "data"),
        running=[(dash.Output("beat", "disabled"), True, False)],
    )
    def _refresh(_beats: int, drawn: list[int] | None) -> tuple[Any, ...]:
        return cache.answer(drawn)

    app.clientside_callback(
        f"""(beats, shown) => {{
            const last = window.steadytip ??= {{}}, now = Date.now();
            if (last.shown !== shown) {{ last.shown = shown; last.at = now; }}
            return now - last.at > {_NO_ANSWER * 1e3:g}
                ? "The monitor no longer answers. What is below is old." : "";
        }}""",
        dash.Output("no-answer", "children"),
        dash.Input("clock", "n_intervals"),
        dash.Input("shown", "data"),
    )
    return app


_FIXED = (
    ("shown", "data"),
    ("drawn", "data"),
    ("banner", "children"),
    ("banner", "className"),
    ("note", "children"),
    ("tiles", "children"),
    ("counters", "children"),
)


def _page() -> html.Div:
    boxes = [
        html.Section(
            [
                html.H2(panel.title),
                html.P(panel.caption, className="caption"),
                dcc.Graph(id=panel.id, config={"displayModeBar": False, "responsive": True}),
            ],
            id=f"{panel.id}-box",
            className="wide" if panel.wide else "",
            hidden=True,
        )
        for panel in _PANELS
    ]
    return html.Div(
        [
            dcc.Interval(id="beat", interval=round(PERIOD * 1e3)),
            dcc.Interval(id="clock", interval=500),
            dcc.Store(id="shown"),
            dcc.Store(id="drawn"),
            html.Div(id="no-answer", className="error"),
            html.Div(MonitorState.WAITING.value, id="banner", className="banner waiting"),
            html.Div(id="note", className="note"),
            html.Div(id="tiles", className="verdict"),
            html.Div(boxes, className="grid"),
            html.Div(id="counters"),
        ]
    )


class _ViewCache:
    """Answers any number of pages from one view per period."""

    def __init__(self, rings: MonitoredRings) -> None:
        self._rings = rings
        self._lock = threading.Lock()
        self._made = -np.inf
        self._words: tuple[Any, ...] = ()
        self._curves: list[list[Curve]] = []
        self._figures: tuple[list[int], list[dict[str, Any]]] = ([], [])

    def answer(self, drawn: list[int] | None) -> tuple[Any, ...]:
        """Return all outputs of the callback.

        Args:
            drawn: curves in each figure that the page has.
        """
        with self._lock:
            if time.monotonic() - self._made > 0.8 * PERIOD:
                self._renew()
            made, words, curves = self._made, self._words, self._curves
            count, figures = self._figures
        parts: list[Any] = []
        for figure, each in zip(figures, curves, strict=True):
            parts += [not each, _patch(each) if count == drawn else _filled(figure, each)]
        return made, count, *words, *parts

    def _renew(self) -> None:
        view = self._rings.view()
        self._words = (*_banner(self._rings, view), _tiles(view), _counters(view))
        self._curves = [panel.curves(view) for panel in _PANELS]
        self._made = time.monotonic()
        count = [len(each) for each in self._curves]
        if count != self._figures[0]:
            figures = [_figure(*each, view) for each in zip(_PANELS, self._curves, strict=True)]
            self._figures = count, figures


def _figure(panel: _Panel, curves: list[Curve], view: View) -> dict[str, Any]:
    return dict(json.loads(panel.figure(view).to_json())) if curves else {"data": [], "layout": {}}


def _filled(figure: dict[str, Any], curves: Sequence[Curve]) -> dict[str, Any]:
    traces = [
        {**trace, "x": _encoded(x), "y": _encoded(y)}
        for trace, (x, y) in zip(figure["data"], curves, strict=True)
    ]
    return {**figure, "data": traces}


def _patch(curves: Sequence[Curve]) -> dash.Patch:
    patch = dash.Patch()
    for place, (x, y) in enumerate(curves):
        patch["data"][place]["x"] = _encoded(x)
        patch["data"][place]["y"] = _encoded(y)
    return patch


def _encoded(values: FloatArray) -> dict[str, str]:
    """As plotly.js takes typed arrays: a tenth of the bytes of a list, and no time to write."""
    return {"dtype": "f4", "bdata": base64.b64encode(values.astype("<f4").tobytes()).decode()}


# ---- Figures -----------------------------------------------------------------------------------

_EMPTY = np.empty(0)


def _empty(name: str, shade: str, legend: bool = True, **style: Any) -> go.Scatter:
    return line(_EMPTY, _EMPTY, shade, name, legend, **style)


def _finished(figure: go.Figure, height: int, **more: Any) -> go.Figure:
    # With one `uirevision` a zoom outlives the next refresh.
    layout(figure, height, uirevision="one", **more)
    figure.update_xaxes(title_font_size=13)
    return figure.update_yaxes(title_font_size=13)


def _with_time(figure: go.Figure, seconds: float = WINDOW, **place: Any) -> go.Figure:
    figure.update_xaxes(range=[-seconds, 0.0])
    figure.update_xaxes(title_text="time before now, s", **place)
    return figure


def _tip_figure(_view: View) -> go.Figure:
    figure = three_rows("", "µm")
    for row in range(3):
        for name in (_BEFORE, _AFTER):
            figure.add_trace(_empty(name, colour(name), legend=row == 0), row=row + 1, col=1)
    return _finished(_with_time(figure, row=3, col=1), 400)


def _tip_curves(view: View) -> list[Curve]:
    if view.tip is None:
        return []
    return [
        thinned(view.tip_time, signal[:, axis] * _MICRO, _POINTS)
        for axis in range(3)
        for signal in (view.tip.without, view.tip.error)
    ]


def _spectrum_figure(_view: View) -> go.Figure:
    figure = go.Figure([_empty(name, colour(name)) for name in (_BEFORE, _AFTER)])
    figure.add_vrect(*TREMOR_BAND, fillcolor=SERIES[2], opacity=0.1, line_width=0)
    figure.update_xaxes(title_text="frequency, Hz", range=[0.0, _SPECTRUM])
    figure.update_yaxes(title_text="µm/√Hz", rangemode="tozero")
    return _finished(figure, 270)


def _spectrum_curves(view: View) -> list[Curve]:
    if view.tip is None or view.tip.spectra is None:
        return []
    frequency, *both = view.tip.spectra
    kept = frequency <= _SPECTRUM
    return [(frequency[kept], density[kept] * _MICRO) for density in both]


def _volts_figure(view: View) -> go.Figure:
    names, _ = view.volts
    figure = go.Figure(
        [_empty(n.rpartition(".")[2], SERIES[i % len(SERIES)]) for i, n in enumerate(names)]
    )
    figure.update_yaxes(title_text="V")
    return _finished(_with_time(figure, _VOLTS), 270)


def _volts_curves(view: View) -> list[Curve]:
    kept = view.time >= -_VOLTS
    return [thinned(view.time[kept], volts, _POINTS) for volts in view.volts[1][kept].T]


def _state_figure(view: View) -> go.Figure:
    figure = make_subplots(
        rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.07, row_heights=[0.44, 0.22, 0.34]
    )
    for i, feed in enumerate(view.feeds):
        shade = SERIES[i % len(SERIES)]
        figure.add_trace(_empty(feed.name, shade, legend=len(view.feeds) > 1), row=1, col=1)
        figure.add_trace(_empty(feed.name, shade, legend=False, shape="hv"), row=2, col=1)
    if view.mode is not None:
        figure.add_trace(_empty("command", GREY, legend=False, shape="hv"), row=3, col=1)
    figure.update_yaxes(title_text="age, ms", rangemode="tozero", row=1, col=1)
    _steps(figure, 2, "valid", ("no", "yes"))
    _steps(figure, 3, "command", MODES)
    return _finished(_with_time(figure, row=3, col=1), 340)


def _steps(figure: go.Figure, row: int, title: str, words: Sequence[str]) -> None:
    places = list(range(len(words)))
    span = [-0.3, len(words) - 0.7]
    figure.update_yaxes(
        title_text=title, range=span, tickvals=places, ticktext=words, row=row, col=1
    )


def _state_curves(view: View) -> list[Curve]:
    curves = []
    for feed in view.feeds:
        curves.append(thinned(view.time, feed.age * _MILLI, _POINTS))
        curves.append(thinned(view.time, feed.valid, _POINTS))
    if view.mode is not None:
        curves.append(thinned(view.time, view.mode, _POINTS))
    return curves


def _latency_figure(_view: View) -> go.Figure:
    figure = go.Figure(go.Bar(x=[], y=[], marker={"color": SERIES[0]}, showlegend=False))
    figure.update_xaxes(title_text="latency, µs", rangemode="tozero")
    figure.update_yaxes(title_text="commands, %", rangemode="tozero")
    return _finished(figure, 340, bargap=0.05)


def _latency_curves(view: View) -> list[Curve]:
    if view.latency is None:
        return []
    edges, counts = histogram(view.latency)
    return [((edges[:-1] + edges[1:]) / 2 * _MICRO, 100.0 * counts / max(1, counts.sum()))]


_PANELS = (
    _Panel(
        "tip",
        "Tip error",
        "Distance of the tip from the intent along each axis of the world, about its mean.",
        True,
        _tip_figure,
        _tip_curves,
    ),
    _Panel(
        "spectrum",
        "Spectrum of the tip error",
        "Amplitude density over the three axes together; the tremor band is shaded.",
        False,
        _spectrum_figure,
        _spectrum_curves,
    ),
    _Panel(
        "volts",
        "Voltages",
        f"Sent to the actuators, the last {_VOLTS:g} s.",
        False,
        _volts_figure,
        _volts_curves,
    ),
    _Panel(
        "states",
        "Fault states",
        "Age of the sample in use, whether it is valid, and the mode of the command.",
        False,
        _state_figure,
        _state_curves,
    ),
    _Panel(
        "latency",
        "Latency",
        "From the last frame of a sample to its command; the last bar holds all beyond.",
        False,
        _latency_figure,
        _latency_curves,
    ),
)


# ---- Words -------------------------------------------------------------------------------------


def _banner(rings: MonitoredRings, view: View) -> tuple[str, str, str]:
    """Text, class and notes."""
    (path, state, quiet), *others = rings.look()
    at = f"{view.seconds:.1f} s"
    text = {
        MonitorState.WAITING: f"Waiting for the loop ({path.name})",
        MonitorState.RUNNING: f"Running, {at}",
        MonitorState.SILENT: f"No data for {quiet:.0f} s: the loop hangs, or has ended without a "
        f"word. What is below is from {at}.",
        MonitorState.STOPPED: f"Stopped at {at}",
    }[state]
    notes = [_note(*other) for other in others if other[1] is not MonitorState.RUNNING]
    return text, f"banner {state.value}", "; ".join(notes)


def _note(path: Path, state: MonitorState, quiet: float) -> str:
    words = {
        MonitorState.WAITING: "is waited for",
        MonitorState.SILENT: f"has had no data for {quiet:.0f} s",
        MonitorState.STOPPED: "has been closed by its writer",
    }
    return f"{path.name} {words[state]}"


def _tiles(view: View) -> list[html.Div]:
    tiles = []
    if view.tip is not None:
        for name, words in _FIGURES.items():
            metric = view.tip.metrics.get(name)
            if metric is not None:
                tiles.append(
                    _tile(
                        " ".join(format_quantity(metric.value, metric.unit)),
                        words,
                        metric.definition,
                    )
                )
    if view.latency is not None and len(view.latency):
        half, most = np.quantile(view.latency, [0.5, 0.99]) * _MICRO
        tiles.append(_tile(f"{half:.0f} / {most:.0f} µs", "latency, p50 / p99"))
    for feed in view.feeds:
        good = bool((feed.valid[-1:] > 0.0).all())  # not a number is not good
        words = f"{feed.name}, " + (
            "no sample yet" if feed.sample is None else f"sample {feed.sample}"
        )
        tiles.append(_tile("valid" if good else "invalid", words, bad=not good))
    if view.mode is not None and len(view.mode):
        known = dict(enumerate(MODES))
        text = known.get(view.mode[-1], f"mode {view.mode[-1]:g}")
        tiles.append(_tile(text, "command", bad=text != "run"))
    return tiles


_FIGURES = {
    "tip_rms": "tip error, rms",
    "tip_rms_uncompensated": "without compensation",
    "reduction_in_band": "reduction in band",
    "reduction_a_posteriori": "reduction a-posteriori",
}


def _tile(value: str, words: str, definition: str = "", bad: bool = False) -> html.Div:
    return html.Div([html.B(value), words], className="bad" if bad else "", title=definition)


def _counters(view: View) -> list[Any]:
    blocks: list[Any] = []
    for feed in view.feeds:
        if not feed.counts:
            continue
        heading = ("counter", "total", f"last {WINDOW:g} s", "")
        rows = [
            html.Tr(
                [
                    html.Td(count.name, className="name"),
                    html.Td(f"{count.total}", className="number"),
                    html.Td(f"{count.recent}", className="number"),
                    html.Td(count.description),
                ],
                className="bad" if count.recent else "",
            )
            for count in feed.counts
        ]
        head = html.Tr(
            [html.Th(word, className="number" if word[:1] in "tl" else "") for word in heading]
        )
        blocks += [html.H2(f"Frames heard by '{feed.name}'"), html.Table([head, *rows])]
    return blocks
