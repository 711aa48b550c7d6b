"""`steadytip bench hil`: what it measures and how it tells; never how fast it is."""

import json

import pytest
from typer.testing import CliRunner

from fmu_src.errors import SteadytipError
from harness.can.database import load
from harness.cli.main import app
from harness.hil import speed
from harness.hil.speed import BusLink, codec_figures, loop_figures, pacing_figures

from .synthetic import record

KEYS = ["source", "quantity", "unit", "paper", "measured", "setting"]


@pytest.fixture
def made_up(monkeypatch, tmp_path):
    """Runs that were never on the wall clock, and what each was asked for."""
    asked = []

    def run(scenario, *, overrides, out, **_):
        asked.append(overrides)
        if overrides["part.sensors.interface"] == "slcanbulk":
            raise SteadytipError("no such line")
        return record(tmp_path / f"{len(asked)}", ticks=300)

    monkeypatch.setattr(speed, "hil", run)
    return asked


def test_figures_of_a_run_are_its_metrics_with_the_conditions(made_up, tmp_path):
    figures = {f.quantity: f for f in loop_figures(BusLink("unixbus", "python"), 50, 3.0)}
    metrics = record(tmp_path / "same", ticks=300).metrics
    assert figures["latency, median"].measured == 1e6 * metrics["latency_p50"].value
    assert figures["wake-up, 99 %"].measured == 1e6 * metrics["wake_up_p99"].value
    assert figures["latency, 99 %"].unit == "us"
    assert figures["lost samples"].measured == metrics["lost_samples"].value
    (setting,) = {figure.setting for figure in figures.values()}
    assert setting == (
        "closed_loop_can, unixbus, python board, 3 s, SCHED_FIFO 50, stolen CPU 1.2 %"
    )
    (asked,) = made_up
    assert asked["hil.priority"] == 50
    assert asked["seconds"] == 3.0


def test_each_link_is_run_with_priority_and_without_and_none_keeps_the_others(made_up, tmp_path):
    path = tmp_path / "new" / "bench.json"
    done = CliRunner().invoke(
        app, ["bench", "hil", "--seconds", "1", "--json", str(path)], env={"COLUMNS": "200"}
    )
    assert done.exit_code == 0, done.output
    links = [(a["part.sensors.interface"], a["hil.board"], a["hil.priority"]) for a in made_up]
    assert links == [
        (interface, board, priority)
        for interface, board in (("unixbus", "python"), ("slcanbulk", "python"), ("slcanbulk", "c"))
        for priority in (50, 0)
    ]
    assert done.output.count("skipped: no such line") == 4
    entries = json.loads(path.read_text("utf-8"))
    assert all(list(entry) == KEYS for entry in entries)
    quantities = [entry["quantity"] for entry in entries]
    assert quantities.count("latency, 99 %") == 2
    assert quantities.count("pacing, late by, median") == 2
    assert "encode PiezoCommand" in quantities
    assert all(entry["measured"] >= 0 for entry in entries)
    assert {"instrument.dbc, E2E profile P01", "instrument_fd.dbc, E2E profile P05"} <= {
        entry["setting"] for entry in entries
    }
    for text in ("median", "µs", f"json: {path}"):
        assert text in done.output


@pytest.mark.parametrize("dbc", speed.DBCS)
def test_every_message_is_decoded_and_encoded(dbc):
    figures = list(codec_figures(dbc))
    named = {figure.quantity for figure in figures}
    assert named == {
        f"{what} {m.name}" for m in load(dbc).messages for what in ("decode", "encode")
    }
    assert all(0 < figure.measured < 1000 for figure in figures)


def test_pacing_is_never_early():
    median, most = pacing_figures(0, 0.1)
    assert 0 <= median.measured <= most.measured
    assert median.setting.startswith("1 kHz, 0.1 s, ordinary thread, stolen CPU")


def test_a_run_without_a_latency_is_told(monkeypatch, tmp_path):
    """A loop that was late in every tick has none."""
    result = record(tmp_path, ["silence@0-1"], ticks=50)
    monkeypatch.setattr(speed, "hil", lambda *_, **__: result)
    with pytest.raises(
        SteadytipError, match="unixbus, python board: no sample of 1 s came in time"
    ):
        loop_figures(BusLink("unixbus", "python"), 0, 1.0)


@pytest.mark.slow
@pytest.mark.xdist_group("wall-clock")
def test_on_the_wall_clock():
    figures = {f.quantity: f for f in loop_figures(BusLink("unixbus", "python"), 50, 2.0)}
    assert 0 < figures["wake-up, median"].measured < figures["latency, median"].measured
    assert figures["latency, median"].measured < figures["latency, 99 %"].measured
