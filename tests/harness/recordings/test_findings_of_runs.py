"""What is wrong with a recording is said by the run, in its files and in the terminal."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import steadytip as st
from harness.cli.main import app
from harness.recordings.findings import FindingsError
from harness.recordings.tables import write_table
from tests.command import steadytip
from tests.harness.recordings import hands

HEADINGS = ["time [s]", "x [mm]", "y [mm]", "z [mm]"]


@pytest.fixture
def hand_file(tmp_path):
    """Writes a drawn hand, with defects, as a table in mm."""

    def write(name, time, position):
        values = np.column_stack([time, position * 1e3])
        return write_table(tmp_path / name, HEADINGS, values, ["%.6f"] * 4)

    return write


def _run(tmp_path, path, **options):
    overrides = {"seconds": 4.0, "warm_up": 1.0}
    out = tmp_path / "out"
    return st.run("closed_loop", motion=path, overrides=overrides, out=out, report=True, **options)


def test_a_glitch_stops_the_run_with_its_place_and_can_be_accepted_or_repaired(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    position[600, 1] += 2e-4
    path = hand_file("hand.csv", time, position)
    with pytest.raises(FindingsError, match=r"y is off by 0\.2 mm .*line 602.*--accept glitch"):
        _run(tmp_path, path)
    accepted = _run(tmp_path, path, accept=["glitch"])
    assert [(f.name, f.severity) for f in accepted.findings] == [("glitch", "stop")]
    worse = accepted.metrics["reduction_a_posteriori"].value
    repaired = _run(tmp_path, path, repair=["glitch"])
    assert [(f.name, f.severity) for f in repaired.findings] == [("glitch", "repaired")]
    assert repaired.metrics["reduction_a_posteriori"].value > worse + 20
    page = repaired.report.read_text(encoding="utf-8")
    assert "Findings about the recordings" in page
    assert "y is off by 0.2 mm" in page


def test_noisy_stamps_cost_nothing(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    plain = _run(tmp_path, hand_file("plain.csv", time, position)).metrics
    stamps = time + np.random.default_rng(1).normal(0, 1e-3, len(time))
    stamps -= stamps.min()
    noisy = _run(tmp_path, hand_file("noisy.csv", stamps, position))
    assert [f.name for f in noisy.findings] == ["noisy-clock"]
    for name in ("reduction_in_band", "reduction_a_posteriori"):
        assert noisy.metrics[name].value == pytest.approx(plain[name].value, abs=1.0)


def test_a_motionless_recording_has_no_per_cent_and_does_not_enter_the_mean(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    still = hand_file("still.csv", time, np.zeros_like(position))
    moving = hand_file("moving.csv", time, position)
    metrics = _run(tmp_path, still).metrics
    assert not [name for name in metrics if name.startswith("reduction")]
    arguments = ["--motion", str(still), "--motion", str(moving), "--seconds", "4"]
    done = CliRunner().invoke(
        app,
        ["run", "closed_loop", *arguments, "--set", "warm_up=1.0", "--out", str(tmp_path / "two")],
    )
    assert done.exit_code == 0
    assert "does not move" in done.output
    assert "leaves out still" in " ".join(done.output.split())


def test_the_command_ends_with_2_and_names_the_finding(tmp_path, hand_file, capsys):
    time, position = hands.draw_hand(3, seconds=4.0)
    path = hand_file("slow.csv", time * 1000, position)
    with pytest.raises(AssertionError, match="ended with 2"):
        steadytip("run", "closed_loop", "--motion", path)
    assert "a thousandth of the time" in " ".join(capsys.readouterr().err.split())


def test_findings_are_in_the_record_of_the_run(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    position[600, 1] += 1e-5
    result = _run(tmp_path, hand_file("hand.csv", time, position))
    (finding,) = st.read(result.path).findings
    assert (finding.name, finding.severity, finding.where) == (
        "glitch",
        "note",
        "line 602, at 2.4000 s",
    )
    parts = result.metadata.parts["hand.motion"]["findings"]
    assert json.loads(json.dumps(parts))[0]["name"] == "glitch"


@pytest.mark.parametrize(
    ("headings", "columns"),
    [
        (["T", "a", "b", "c"], {"time": "T", "x": "a", "y": "b", "z": "c", "length_unit": "mm"}),
        (["time", "x", "y", "z"], {"length_unit": "mm"}),
        (["n", "x [mm]", "y [mm]", "z [mm]"], {"rate": 250.0}),
    ],
)
def test_columns_and_units_that_the_recording_does_not_say_are_given(tmp_path, headings, columns):
    time, position = hands.draw_hand(3, seconds=4.0)
    table = np.column_stack([time, position * 1e3])
    path = write_table(tmp_path / "odd.csv", headings, table, ["%.6f"] * 4)
    result = _run(tmp_path, path, columns=columns)
    assert result.metrics["reduction_a_posteriori"].value > 30.0


def test_the_command_and_the_scenario_take_the_same_columns(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    table = np.column_stack([time * 1e3, position * 1e3])
    path = write_table(tmp_path / "odd.csv", ["t", "x", "y", "z"], table, ["%.6f"] * 4)
    given = ["--time-unit", "ms", "--length-unit", "mm", "--seconds", 4, "--set", "warm_up=1.0"]
    steadytip("run", "closed_loop", "--motion", path, *given, "--out", tmp_path / "out")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(
        'extends = "closed_loop"\nseconds = 4.0\nwarm_up = 1.0\n[part.hand]\nmotion = "odd.csv"\n'
        'columns = { time_unit = "ms", length_unit = "mm" }\n',
        encoding="utf-8",
    )
    own = st.run(scenario, out=tmp_path / "own", report=False)
    shown = st.read(tmp_path / "out")
    name = "reduction_in_band"
    assert own.metrics[name].value == shown.metrics[name].value


def test_an_unknown_column_key_is_refused_with_the_nearest(tmp_path, hand_file):
    time, position = hands.draw_hand(3, seconds=4.0)
    path = hand_file("hand.csv", time, position)
    with pytest.raises(st.ProblemsError, match="unknown key 'time_unt'; did you mean 'time_unit'"):
        _run(tmp_path, path, columns={"time_unt": "ms"})
