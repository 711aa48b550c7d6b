"""Whether a run is as it should be, and what a rig is told of it."""

import json
import re
from importlib.resources import files
from xml.etree import ElementTree

import can
import pytest
from typer.testing import CliRunner

import steadytip as st
from harness.can.frame_log import read_log
from harness.cli.main import app
from harness.common.errors import ProblemsError
from harness.common.junit import JunitCase, JunitSuite, write_junit
from harness.results.conversion import convert
from harness.results.limits import MACHINES, judge, suite_of
from harness.scenario.load import load
from tests.harness.hil.synthetic import record

LIMITED = {"latency_p50": 1e-3, "late_samples": 0.0}


def at_most(**limits: float) -> dict:
    return {name: {"min": None, "max": value} for name, value in limits.items()}


def failures(result) -> dict[str, str]:
    return {each.name: each.failure for each in judge(result) if each.failure}


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    return record(tmp_path_factory.mktemp("quiet"), ticks=500, hil={"limits": at_most(**LIMITED)})


def test_a_quiet_run_is_good_in_every_point(quiet):
    judged = judge(quiet)
    assert failures(quiet) == {}
    names = [each.name for each in judged]
    assert {"ended in order", "board and log ended in order", "crc", "lost"} <= set(names)
    assert {"lost_samples", "invalid", *LIMITED} <= set(names)
    assert not set(MACHINES) & set(names)
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("fault", "kinds"),
    [
        ("drop:0.05@0.1-0.4", {"lost", "incomplete", "lost_samples"}),
        ("corrupt:0.05@0.1-0.4", {"crc"}),
        ("silence@0.2-0.23", {"timeouts", "sequence", "invalid", "lost_samples"}),
        ("unavailable:0.2@0.1-0.2", {"range"}),
        ("wrong-length:0.1@0.1-0.4", {"length"}),
        ("duplicate:0.1@0.1-0.4", {"repeated"}),
        ("unknown:0.1@0.1-0.4", {"unknown"}),
    ],
)
def test_each_fault_fails_by_its_name(fault, kinds, tmp_path):
    assert kinds <= failures(record(tmp_path, [fault], ticks=600, seed=1)).keys()


def test_limits_take_the_place_of_what_is_asked_for_otherwise(tmp_path):
    fault = ["unknown:0.1@0.1-0.4"]
    allowed = at_most(unknown=1000.0)
    assert failures(record(tmp_path, fault, ticks=500, hil={"limits": allowed})) == {}
    narrow = record(tmp_path, fault, ticks=500, hil={"limits": at_most(unknown=3.0)})
    count = narrow.metadata.hil["counts"]["unknown"]
    assert failures(narrow) == {"unknown": f"unknown is {count}; it has to be at most 3"}


def test_a_figure_out_of_its_limits_is_told_with_both(tmp_path):
    limits = {
        "latency_p50": {"min": None, "max": 1e-5},
        "wake_up_p50": {"min": 1.0, "max": 2.0},
        "bus_load": {"min": 1.0, "max": None},
    }
    result = record(tmp_path, ticks=500, hil={"limits": limits})
    found = failures(result)
    assert set(found) == {"latency_p50", "wake_up_p50"}
    value = result.metrics["latency_p50"].value
    assert found["latency_p50"] == (
        f"latency_p50 is {value * 1e6:.4g} µs; it has to be at most 10 µs"
    )
    assert found["wake_up_p50"].endswith("it has to be at least 1 s and at most 2 s")


def test_overruns_count_only_where_there_is_a_limit(tmp_path):
    counts = {"overruns": 5, "late": 0}
    assert failures(record(tmp_path, ticks=200, hil={"counts": counts})) == {}
    limited = {"counts": counts, "limits": at_most(overruns=4.0)}
    assert failures(record(tmp_path, ticks=200, hil=limited)) == {
        "overruns": "overruns is 5; it has to be at most 4"
    }


def test_a_limit_on_nothing_is_a_failure_with_a_hint(tmp_path):
    result = record(tmp_path, ticks=200, hil={"limits": at_most(latency_p9=1e-3)})
    (text,) = failures(result).values()
    assert text == (
        "this run has no figure and no kind of fault 'latency_p9'; did you mean 'latency_p99'?"
    )


def test_a_run_that_ended_early_or_a_board_that_did_is_not_good(tmp_path):
    result = record(
        tmp_path, ticks=200, error="stopped by the user", hil={"notes": ["the board was killed"]}
    )
    assert failures(result) == {
        "ended in order": "stopped by the user",
        "board and log ended in order": "the board was killed",
    }


def test_a_loop_without_a_bus_is_judged_by_how_it_ended_and_by_its_limits(tmp_path):
    result = record(tmp_path, ticks=50, parts={}, hil={"limits": at_most(real_time_factor=2.0)})
    for key in ("counts", "messages", "events"):
        result.metadata.hil.pop(key)
    names = [each.name for each in judge(result)]
    assert names == ["ended in order", "board and log ended in order", "real_time_factor"]
    assert failures(result) == {}


def test_limits_of_a_scenario_are_checked_when_it_is_read(tmp_path):
    def read(text: str):
        path = tmp_path / "rig.toml"
        path.write_text(f'extends = "{SHIPPED}"\n{text}')
        return load(path)

    SHIPPED = files("harness.scenario") / "library" / "closed_loop_can.toml"
    limits = read(
        "[hil.limits]\nlatency_p99 = 1e-3\noverruns = 10\nreduction_in_band = { min = 70.0 }\n"
    ).hil.limits
    assert (limits["latency_p99"].max, limits["latency_p99"].min) == (1e-3, None)
    assert limits["overruns"].max == 10
    assert (limits["reduction_in_band"].min, limits["reduction_in_band"].max) == (70.0, None)
    with pytest.raises(ProblemsError, match=r"'hil\.limits\.latency_p99\.max' = 'soon'"):
        read('[hil.limits]\nlatency_p99 = "soon"\n')
    with pytest.raises(ProblemsError, match=r"'hil\.limits\.x\.most'; known: max, min"):
        read("[hil.limits]\nx = { most = 1 }\n")
    with pytest.raises(ProblemsError, match=r"'hil\.overun'; did you mean 'overrun'"):
        read('[hil]\noverun = "skip"\n')


def test_junit_has_a_case_for_each_point(tmp_path):
    result = record(tmp_path, ["corrupt:0.05@0.1-0.4"], ticks=500, seed=2)
    path = write_junit(tmp_path / "new" / "j.xml", "rig", [suite_of("bench", judge(result), 2.5)])
    (suite,) = ElementTree.parse(path).getroot()
    cases = {case.get("name"): case for case in suite}
    assert suite.get("name") == "bench"
    assert suite.get("tests") == str(len(cases)) == str(len(judge(result)))
    assert suite.get("failures") == str(len(failures(result)))
    assert float(suite.get("time")) == 2.5
    crc = cases["crc"].find("failure")
    assert crc.get("message") == failures(result)["crc"]
    assert cases["crc"].get("classname") == "bench.faults"
    assert cases["length"].find("failure") is None
    assert cases["length"].findtext("system-out") == "0, wanted: at most 0"


def test_junit_holds_any_text(tmp_path):
    case = JunitCase("g", "a\x00<b>", failure='first "line"\nsecond\ud800', output="ä & \x1b[0m")
    path = write_junit(
        tmp_path / "j.xml", "n", [JunitSuite("s", (case, JunitCase("g", "b", skipped="")))]
    )
    (suite,) = ElementTree.parse(path).getroot()
    first, second = suite
    assert first.get("name") == "a\ufffd<b>"
    assert first.find("failure").get("message") == 'first "line"'
    assert first.findtext("failure") == 'first "line"\nsecond\ufffd'
    assert first.findtext("system-out") == "ä & \ufffd[0m"
    assert second.find("skipped") is not None
    assert (suite.get("failures"), suite.get("skipped")) == ("1", "1")


# The command --------------------------------------------------------------------------------------


@pytest.fixture
def call(monkeypatch):
    """`steadytip hil` with a run that is there already, or ends as an error says."""

    def call(outcome, *arguments: str):
        def run(*_, **__):
            if isinstance(outcome, Exception):
                raise outcome
            return outcome

        monkeypatch.setattr("harness.hil.session.hil", run)
        return CliRunner().invoke(app, ["hil", "closed_loop_can", *arguments])

    return call


def test_the_command_ends_with_0_and_writes_the_verdict(quiet, call, tmp_path):
    junit = tmp_path / "j.xml"
    done = call(quiet, "--junit", str(junit), "-q")
    assert (done.exit_code, done.output) == (0, "")
    (suite,) = ElementTree.parse(junit).getroot()
    assert (suite.get("name"), suite.get("failures")) == ("closed_loop_can", "0")


def test_the_command_ends_with_1_and_says_why(call, tmp_path):
    result = record(tmp_path / "run", ["corrupt:0.05@0.1-0.4"], ticks=500, seed=2)
    done = call(result, "--junit", str(tmp_path / "j.xml"), "-q")
    assert done.exit_code == 1
    assert "faults: crc is" in done.output
    # Without a file for it, nobody asked.
    assert call(result, "-q").exit_code == 0


def test_a_run_without_a_tick_is_a_failed_case(call, tmp_path):
    junit = tmp_path / "j.xml"
    error = st.PartError("sensors", 0.0, "no complete sample within 5 s")
    assert call(error, "--junit", str(junit), "-q").exit_code == 1
    (suite,) = ElementTree.parse(junit).getroot()
    assert suite.find("testcase/failure").get("message") == "no complete sample within 5 s"


def test_a_run_that_is_not_begun_leaves_no_verdict_of_an_earlier_one(call, tmp_path):
    junit = tmp_path / "j.xml"
    junit.write_text("<testsuites/>")
    mistake = st.SteadytipError("the emulated board did not start")
    assert call(mistake, "--junit", str(junit), "-q").exit_code != 0
    assert not junit.exists()


@pytest.mark.slow
@pytest.mark.xdist_group("wall-clock")
def test_a_rig_that_nobody_watches(tmp_path):
    """Loop and board on the wall clock, with a fault; the limit comes from the terminal."""
    junit = tmp_path / "j.xml"
    arguments = ["hil", "closed_loop_can", "--seconds", "4", "--out", str(tmp_path / "out")]
    arguments += ["--fault", "corrupt:0.05@1-2", "--junit", str(junit)]
    arguments += ["--set", "hil.limits.bus_load=1", "-q"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 1
    (suite,) = ElementTree.parse(junit).getroot()
    bad = {case.get("name") for case in suite if case.find("failure") is not None}
    assert {"crc", "bus_load"} <= bad
    assert not {"ended in order", "board and log ended in order", "length", "unknown"} & bad
    metadata = st.read(tmp_path / "out").metadata.hil
    assert metadata["injected"] == {"faults": ["corrupt:0.05@1-2"], "seed": 0}
    assert json.dumps(metadata["limits"]) == '{"bus_load": {"min": null, "max": 1.0}}'
    page = re.sub(
        r"<script.*?</script>", "", (tmp_path / "out" / "report.html").read_text(), flags=re.S
    )
    assert "<h2>On the wall clock</h2>" in page
    assert "corrupt:0.05@1-2; seed 0" in page
    _, frames = convert(tmp_path / "out")
    logged = [e for e in read_log(tmp_path / "out" / "frames.log") if e.tick is None]
    with can.MF4Reader(frames) as reader:
        read = list(reader)
    assert [bytes(f.data) for f in read] == [bytes(e.message.data) for e in logged]
