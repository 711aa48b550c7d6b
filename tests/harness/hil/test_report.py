"""What a report says of the wall clock and the bus; records that never kept to a clock."""

import html
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.can.database import HOLD, RUN
from harness.common.quantities import format_quantity
from harness.report.hil import hil_sections
from harness.report.run_report import write_report
from harness.results.fault_episodes import troubles

from .synthetic import FEED, record

BIT_OF_EVERYTHING = (
    "drop:0.1@0.2-0.4",
    "corrupt:0.1@0.4-0.5",
    "silence@0.8-0.85",
    "unavailable:0.5@1.2-1.3",
    "babble@1.5-1.8",
)


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    return record(tmp_path_factory.mktemp("faulty"), BIT_OF_EVERYTHING)


def table(result, heading: str) -> list[dict[str, str]]:
    """Rows of the table that has a column of that name."""
    (section,) = hil_sections(result)
    (found,) = [each for each in section.tables if heading in each.columns]
    return [dict(zip(found.columns, row, strict=True)) for row in found.rows]


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (0.000215, "s", ("215", "µs")),
        (-2.5e-5, "s", ("-25", "µs")),
        (0.0012163, "s", ("1.216", "ms")),
        (1e-3, "s", ("1", "ms")),
        (0.25, "s", ("250", "ms")),
        (1.0, "s", ("1", "s")),
        (90.0, "s", ("90", "s")),
        (0.0, "s", ("0", "s")),
        (0.0002, "V/s", ("0.0002", "V/s")),
        (2e-6, "m", ("2", "µm")),
        (3.0, "1", ("3", "")),
    ],
)
def test_short_times_are_shown_in_short_units(value, unit, words):
    assert format_quantity(value, unit) == words


@given(st.floats(1e-9, 1e6))
def test_a_shown_time_is_that_time_to_four_digits(seconds):
    number, unit = format_quantity(seconds, "s")
    assert float(number) * {"µs": 1e-6, "ms": 1e-3, "s": 1.0}[unit] == pytest.approx(seconds, 6e-4)
    assert unit == "s" or float(number) <= 1000


def test_each_message_has_a_row_with_its_faults(faulty):
    rows = {row["message"]: row for row in table(faulty, "message")}
    assert rows["SensorsA"]["id"] == "0x110"
    assert rows["BoardHeartbeat"]["id"] == "0x701"
    counted = faulty.metadata.hil["messages"]
    assert set(rows) == set(counted)
    for name, row in rows.items():
        for kind in ("received", "lost", "crc", "timeouts", "range"):
            assert int(row[kind]) == counted[name][kind], (name, kind)
    assert int(rows["SensorsB"]["lost"]) > 0
    assert int(rows["SensorsB"]["crc"]) > 0


def test_silence_is_found_within_its_timeout_and_answered_in_the_same_tick(faulty):
    """The board's last sample is that at 0.799 s; the timeout is 5 ms.

    It is back at 0.85 s, and says at 0.9 s at the latest how many samples there were meanwhile.
    """
    (row,) = [
        row for row in table(faulty, "what was found") if "no SensorsA" in row["what was found"]
    ]
    assert 0.804 <= float(row["at, s"]) <= 0.806
    assert row["command"] == "held in the same tick"
    held, unit = row["held for"].split()
    assert unit == "ms"
    assert 43 <= float(held) <= 97
    assert row["invalid for"] == row["held for"]
    assert re.search(r"no SensorsA for [56]\.\d ms, more than 5 ms", row["what was found"])


def test_babbling_is_told_and_changes_nothing(faulty):
    (row,) = [
        row for row in table(faulty, "what was found") if "unknown frames" in row["what was found"]
    ]
    assert row["command"] == "followed the controller"
    assert (row["held for"], row["invalid for"]) == ("0 s", "0 s")
    assert 1.5 < float(row["at, s"]) < 1.71


@pytest.mark.parametrize("seed", range(6))
def test_troubles_hold_all_that_went_wrong_once(seed, tmp_path):
    """Whatever the faults: each tick on hold and each event are in one of them, in their order."""
    kinds = ("drop", "delay", "corrupt", "freeze", "stick", "unavailable", "silence", "reorder")
    chance = np.random.default_rng(seed)
    begins = chance.uniform(0.05, 0.9, 5)
    faults = [
        f"{chance.choice(kinds)}:{chance.uniform(0.1, 1.0):.2f}@{t:.3f}-{t + 0.04:.3f}"
        for t in begins
    ]
    result = record(tmp_path, faults, ticks=1000, seed=seed)
    found = troubles(result)
    mode, valid = result.signals(f"{FEED}.command.mode"), result.signals(f"{FEED}.valid")
    assert sum(each.held for each in found) == pytest.approx(1e-3 * np.sum(mode == HOLD))
    assert sum(each.invalid for each in found) == pytest.approx(1e-3 * np.sum(valid == 0))
    events = result.metadata.hil["events"]
    assert {text for _, _, text in events} == {text for each in found for text in each.texts}
    ticks = [each.tick for each in found]
    assert ticks == sorted(set(ticks))
    assert all((each.answer is None) == (each.held == 0.0) for each in found)
    assert all(each.invalid <= each.held for each in found)
    assert mode[-1] == RUN


def test_events_stand_at_the_tick_whose_signals_show_them(faulty):
    metadata, valid = faulty.metadata.hil, faulty.signals(f"{FEED}.valid")
    assert len(metadata["events"]) == len(metadata["event_ticks"]) > 5
    for (_, _, text), tick in zip(metadata["events"], metadata["event_ticks"], strict=True):
        if text.startswith("invalid: "):
            assert valid[tick] == 0
        elif text.startswith("valid again"):
            assert valid[tick] == 1
            assert valid[tick - 1] == 0


def test_a_quiet_run_says_that_nothing_happened(tmp_path):
    result = record(tmp_path, ticks=300)
    (section,) = hil_sections(result)
    assert "Counted on the bus: no fault at all." in section.text[0]
    assert not [each for each in section.tables if "what was found" in each.columns]
    assert section.trouble == ""
    conditions = dict(section.tables[0].rows)
    assert conditions["scheduling"] == "SCHED_FIFO, priority 50"
    assert conditions["stolen CPU"] == "1.2 %"
    assert conditions["clock of the board"] == "not known: too few samples"
    assert "faults that were asked for" not in conditions


def test_conditions_in_words(tmp_path):
    refused = {"priority": 0, "reason": "Operation not permitted", "stolen": None}
    result = record(
        tmp_path,
        ticks=50,
        hil={"conditions": refused, "drift": 2.55e-5, "notes": ["the board did not end"]},
    )
    (section,) = hil_sections(result)
    conditions = dict(section.tables[0].rows)
    assert conditions["scheduling"].endswith("thread: Operation not permitted")
    assert conditions["stolen CPU"] == "not told"
    assert conditions["clock of the board"] == "25.5 ppm slow"
    assert section.trouble == "the board did not end"


def test_a_log_that_was_run_again_has_no_conditions(tmp_path):
    (section,) = hil_sections(record(tmp_path, ticks=50, hil={"conditions": {}}))
    assert dict(section.tables[0].rows)["scheduling"] == "none: a log that was run again"


def test_many_troubles_are_cut_short(tmp_path):
    faults = [f"silence@{t / 1000}-{(t + 8) / 1000}" for t in range(50, 4000, 35)]
    result = record(tmp_path, faults, ticks=4100)
    rows = table(result, "what was found")
    assert len(rows) == 101
    assert rows[-1]["what was found"] == f"and {len(troubles(result)) - 100} more"


def test_overruns_by_kind(tmp_path):
    result = record(
        tmp_path, ["delay:0.2@0.1-0.2"], ticks=300, hil={"counts": {"overruns": 7, "late": 1}}
    )
    words = dict(table(result, "the run")[i].values() for i in range(6))["overruns"]
    assert "7 ticks that took longer than a period" in words
    assert "1 sample that came after its tick" in words
    latency = result.signals(f"{FEED}.command.latency")
    assert f"{np.sum(latency > 1e-3)} command" in words


def test_histograms_count_every_tick_and_mark_the_percentiles(faulty):
    (section,) = hil_sections(faulty)
    histogram = section.plots[0].figure
    latency = faulty.signals(f"{FEED}.command.latency")
    latency = latency[latency > 0]
    counts = np.array(histogram.data[0].y)
    assert round(counts[counts >= 1].sum()) == len(latency)
    words = [note.text for note in histogram.layout.annotations]
    for quantile in (50, 90, 99, 99.9):
        value = " ".join(format_quantity(float(np.percentile(latency, quantile)), "s"))
        assert f"{quantile:g} %: {value}" in words
    assert f"max: {' '.join(format_quantity(float(latency.max()), 's'))}" in words


def test_the_course_shows_age_load_mode_and_when_which_fault_was_counted(faulty):
    (section,) = hil_sections(faulty)
    course = section.plots[1].figure
    named = {trace.name: trace for trace in course.data if trace.name}
    age = faulty.signals(f"{FEED}.age")
    assert max(named["age of the sample"].y) == pytest.approx(1e3 * age.max(), rel=1e-6)
    assert set(named["mode"].y) == {HOLD, RUN}
    marks = {trace.y[0]: np.array(trace.x) for trace in course.data if trace.mode == "markers"}
    assert ((marks["crc"] > 0.38) & (marks["crc"] < 0.52)).all()
    assert ((marks["unknown"] > 1.48) & (marks["unknown"] < 1.82)).all()
    assert ((marks["range"] > 1.18) & (marks["range"] < 1.32)).all()
    assert "bus_off" not in marks
    counted = {
        kind: sum(
            int(text.split()[0])
            for trace in course.data
            if trace.y[0] == kind
            for text in trace.text
        )
        for kind in marks
    }
    before = {kind: faulty.signals(f"{FEED}.{kind}")[0] for kind in marks}
    assert counted == {k: faulty.metadata.hil["counts"][k] - before[k] for k in marks}
    # Shaded and named: what the board was asked for.
    words = [note.text for note in course.layout.annotations]
    assert words == ["drop", "corrupt", "silence", "unavailable", "babble"]


def test_the_page_has_the_section_and_nothing_of_it_without_a_wall_clock(faulty, tmp_path):
    page = write_report(faulty).read_text("utf-8")
    page = html.unescape(re.sub(r"<script.*?</script>", "", page, flags=re.S))
    for text in (
        "<h2>On the wall clock</h2>",
        "<h3>Latency and wake-up</h3>",
        "<h3>In the course of the run</h3>",
        "0x112",
        "held in the same tick",
        "babble@1.5-1.8",
    ):
        assert text in page
    plain = record(tmp_path, ticks=50)
    plain.__dict__["metadata"] = plain.metadata.model_copy(update={"hil": None})
    assert list(hil_sections(plain)) == []


def test_a_loop_without_a_bus_has_conditions_only(tmp_path):
    result = record(tmp_path, ticks=50, parts={})
    result.metadata.hil.pop("messages")
    (section,) = hil_sections(result)
    assert "there is no bus" in section.text[0]
    assert len(section.tables) == 1
    assert not section.plots
