"""`steadytip bench`: that its numbers are what they say they are; never how fast anything is."""

import json
import math
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import steadytip
from fmu_src.errors import SteadytipError
from harness.bench import other_hosts, page, samples, session, stepper, timing
from harness.bench.results import BenchResults
from harness.cli import bench as cli
from harness.cli.main import app

KEYS = ["source", "quantity", "unit", "paper", "measured", "setting"]
POSITIVE = st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=9)
TOY = '''"""Toys.

What it says of itself.
"""

import pytest

from harness.bench.timing import counting
from harness.common.errors import SteadytipError


@pytest.mark.parametrize("name", ["one", "two"])
def bench_toy(bench, turn, name):
    told = counting(lambda: {"one": 1.0, "two": 2.0}[name])
    bench.time(name, "a go", told, unit="ms", per=10, rounds=1, setting="a toy", wanted="fun")
    if name == "two":
        bench.ratio("two", "over one", ("two", "a go"), ("one", "a go"))


def bench_calibrated(bench):
    bench.time("calibrated", "a call", lambda: None)


def bench_impossible(bench):
    raise SteadytipError("no such toy here")
'''


@pytest.fixture(autouse=True)
def unspread(monkeypatch):
    """pytest-benchmark does not measure among tests that are spread over processes."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)


@pytest.fixture
def toys(tmp_path, monkeypatch):
    """A suite of toys in the place of ours."""
    suite = tmp_path / "suite"
    suite.mkdir()
    (suite / "toys.py").write_text(TOY)
    (suite / "pytest.ini").write_bytes((session.SUITE / "pytest.ini").read_bytes())
    monkeypatch.setattr(session, "SUITE", suite)
    monkeypatch.setattr(page, "SUITE", suite)
    monkeypatch.setattr(cli, "GROUPS", ("toys",))
    return suite


def bench(*arguments):
    return CliRunner().invoke(app, ["bench", *arguments], env={"COLUMNS": "200"})


def test_the_command_measures_and_tells(toys, tmp_path):
    out, table = tmp_path / "new" / "bench.json", tmp_path / "SPEED.md"
    done = bench("--quick", "--json", str(out), "--table", str(table))
    assert done.exit_code == 0, done.output
    entries = {entry["quantity"]: entry for entry in json.loads(out.read_text("utf-8"))}
    assert list(entries) == ["one, a go", "two, a go", "two, over one", "calibrated, a call"]
    for entry in entries.values():
        assert list(entry) == KEYS
        assert entry["source"] == "steadytip bench toys"
        assert entry["paper"] is None
        assert entry["measured"] > 0
    one, two, ratio, calibrated = entries.values()
    assert one["measured"] == pytest.approx(100, rel=0.2)
    assert two["measured"] == pytest.approx(200, rel=0.2)
    assert one["setting"] == "a toy; wanted fun"
    assert ratio["measured"] == pytest.approx(2, rel=0.2)
    assert (one["unit"], ratio["unit"], calibrated["unit"]) == ("ms", "", "us")
    text = table.read_text("utf-8")
    for words in ("## toys: Toys", "What it says of itself", "core", "Skipped: no such toy here."):
        assert words in text
    row = next(line for line in text.splitlines() if line.startswith("| two"))
    assert row == "| two | 200 ms | 2 |  | a go fun | a toy |"
    assert "skipped: no such toy here" in done.output
    assert "µs" in done.output


def test_a_broken_benchmark_is_no_number(toys, monkeypatch):
    (toys / "broken.py").write_text("def bench_it(bench):\n    assert 1 == 2\n")
    monkeypatch.setattr(cli, "GROUPS", ("broken",))
    done = bench("--quick", "--quiet")
    assert done.exit_code == 1
    assert "a benchmark is broken: bench_it" in str(done.exception)
    assert "assert 1 == 2" in str(done.exception)


def test_without_pytest_benchmark_it_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "harness.bench.session")
    monkeypatch.setitem(sys.modules, "pytest_benchmark", None)
    done = bench("loop")
    assert done.exit_code == 1
    assert str(done.exception) == (
        "benchmarks need 'pytest_benchmark': pip install 'steadytip[bench]'"
    )


def test_a_group_that_is_not_there_is_named():
    done = bench("loops")
    assert done.exit_code == 1
    assert str(done.exception) == "bench: there is no group 'loops'; did you mean 'loop'?"


def test_every_group_is_a_file_that_says_what_it_is():
    assert sorted(cli.GROUPS) == sorted(file.stem for file in session.SUITE.glob("*.py"))
    for group in cli.GROUPS:
        assert page._docstring(group) != group


@given(POSITIVE, POSITIVE)
def test_ratios_are_of_samples_of_the_same_turn(over, under):
    results = BenchResults()
    results.ratio("g", "r", "ratio", ("a", "x"), ("b", "x"))
    for values, row in ((over, "a"), (under, "b")):
        for value in values:
            results.add("g", row, "x", [value], "us")
    found = {line.row: line.value for line in results.lines()}
    assert found["a"] == pytest.approx(np.median(over))
    assert found["r"] == pytest.approx(
        np.median([a / b for a, b in zip(over, under, strict=False)])
    )


def test_a_ratio_without_one_of_its_sides_is_none():
    results = BenchResults()
    results.add("g", "a", "x", [1.0], "us")
    results.ratio("g", "r", "ratio", ("a", "x"), ("b", "x"))
    assert [line.row for line in results.lines()] == ["a"]


@given(st.floats(0.0, 10.0))
def test_the_stopwatch_counts_what_it_is_told(seconds):
    begun = time.perf_counter()
    before = timing.now()
    timing.counting(lambda: seconds)()
    counted = timing.now() - before
    spent = time.perf_counter() - begun
    assert seconds - 1e-6 <= counted <= seconds + spent + 1e-6


def test_the_plain_loop_is_the_harness_to_the_bit(tmp_path):
    """What is compared with the harness does the same."""
    ticks = 300
    loop = other_hosts.PlainLoop("closed_loop", tmp_path)
    loop.run(100)
    loop.run(ticks - 100)
    overrides = {"seconds": ticks * loop.step, "warm_up": 0.0}
    own = steadytip.run("closed_loop", overrides=overrides, out=tmp_path / "own", report=False)
    rows = np.array(loop.rows)
    assert rows.shape == (ticks, len(own.table.column_names) - 1)
    for name, values in zip(loop.names, rows.T, strict=True):
        np.testing.assert_array_equal(values, own.signals(name).astype(float), err_msg=name)


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """What FMUs are measured with, of a short run."""
    return {case.name: case for case in samples.cases(tmp_path_factory.mktemp("runs"), 0.1)}


def test_every_model_is_measured_with_what_it_took_in_a_run(few):
    assert sorted(few) == samples.names()
    for case in few.values():
        assert np.all(np.isfinite(case.table))
    still = {name for name, case in few.items() if not np.any(np.ptp(case.table, axis=0) > 0)}
    assert still == {"Hand", "Robot", "EmTracker"}, "nothing drives two, a robot at rest the third"


@pytest.mark.parametrize("name", ["MicronEstimator", "PiezoStack", "OpticalInertialEkf"])
def test_the_host_in_c_does_what_the_harness_does(name, few, tmp_path):
    """Its last outputs are those of the same samples from Python."""
    case = few[name]
    spent = np.zeros(len(case.table))
    with stepper.SteppedFmu(case, tmp_path) as native:
        native.samples(0, 10)
        native.samples(10, len(case.table), spent[10:])
        reals = [port.type == "Real" for port in case.description.outputs]
        found = native.outputs()[reals]
    with stepper.SteppedFmu(case, tmp_path) as python:
        for k, row in enumerate(case.table):
            python.u[:] = row
            python.advance(k * case.period, case.period)
        np.testing.assert_array_equal(found, python.outputs()[reals])
    assert np.all(spent[:10] == 0)
    assert np.all(spent[10:] > 0)


def test_a_sample_that_is_refused_is_told(few, tmp_path):
    case = few["MicronEstimator"]
    broken = replace(case, table=case.table.copy())
    broken.table[1] = np.nan
    with stepper.SteppedFmu(broken, tmp_path) as fmu:
        fmu.samples(0, 1)
        with pytest.raises(SteadytipError, match=r"MicronEstimator: .* ended with FMI's status"):
            fmu.samples(1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("group", [g for g in cli.GROUPS if g != "hil"])
def test_a_group_measures(group, tmp_path):
    """Figures are there and are numbers of times and sizes."""
    out = tmp_path / "bench.json"
    done = bench(group, "--quick", "--json", str(out))
    assert done.exit_code == 0, done.output
    entries = json.loads(out.read_text("utf-8"))
    assert entries
    for entry in entries:
        assert list(entry) == KEYS
        assert math.isfinite(entry["measured"])
        assert entry["measured"] > 0 or entry["unit"] not in ("s", "ms", "us")
