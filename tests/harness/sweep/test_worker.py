"""Runs in one process, used again, from saved states, fused: the numbers of the run alone."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import steadytip as st
from harness.loop import loop as loops
from harness.scenario import load as scenarios
from harness.sweep.plan import Queue, SweepPlan, groups_of
from harness.sweep.worker import Base, CaseRow, Worker, with_places
from harness.system.assembly import assemble
from harness.system.container import fuse

STATM = Path("/proc/self/statm")
GRID = """
[sweep]
seeds = [3, 4]
[sweep.vary]
"part.sensor.noise"  = [1e-6, 2e-6]
"part.sensor.stroke" = { values = [1e-6, 2e-6, 3e-6], from = 1.0 }
[[sweep.fault]]
wire  = "again.stroke"
kind  = "dropout"
value = [0.2, 0.9]
at    = 0.5
"""


def laid_out(path, fused: bool = False, **overrides) -> tuple[SweepPlan, Base]:
    scenario = scenarios.load(path, overrides)
    plan = SweepPlan(scenario, scenario.sweep)
    common = with_places(scenario, plan.faults)
    container = fuse(assemble(common)).parts["container"].description.path if fused else None
    return plan, Base(common, {}, container)


def values(row: CaseRow) -> dict[str, float]:
    assert row.status == "ok", row.error
    return {name: metric.value for name, metric in row.metrics.items()}


def in_order(plan: SweepPlan) -> list:
    queue = Queue(groups_of(plan, range(len(plan))))
    return [plan.case(*queue.next("one")) for _ in range(len(plan))]


@pytest.mark.parametrize("fused", [False, True])
def test_shared_beginnings_change_no_bit_and_are_simulated_once(small, monkeypatch, fused):
    plan, base = laid_out(small(GRID), fused)
    ticks = []
    go = loops.Loop.go

    def counted(self, *arguments):
        outcome = go(self, *arguments)
        ticks.append(outcome.ticks - self._run.first)
        return outcome

    monkeypatch.setattr(loops.Loop, "go", counted)
    shared = {case.number: values(row) for case, row in _performed(base, in_order(plan))}
    with_sharing, ticks[:] = sum(ticks), []
    apart = {
        case.number: values(row)
        for case, row in _performed(base, [plan.case(k) for k in range(len(plan))])
    }
    assert shared == apart
    assert len({tuple(each.items()) for each in shared.values()}) == len(plan)
    # Of 1500 ticks, four beginnings of 500 are common to nine runs, and then 500 to the three
    # without fault; without sharing each run takes all.
    assert sum(ticks) == 36 * 1500
    assert with_sharing == 4 * (500 + 6 * 1000 + 500 + 3 * 500)


def _performed(base: Base, cases):
    stand = Worker(base)
    try:
        yield from ((case, stand.perform(case)) for case in cases)
    finally:
        stand.close()


def test_a_run_used_again_is_as_a_fresh_one_whatever_came_before(small):
    plan, base = laid_out(small(GRID))
    case, other = plan.case(0), plan.case(len(plan) - 1)
    stand = Worker(base)
    first = values(stand.perform(case))
    assert values(stand.perform(other)) != first
    assert values(stand.perform(case)) == first
    ((_, row),) = _performed(base, [case])
    assert values(row) == first
    stand.close()


@pytest.mark.parametrize("mode", [1, 6, 2, 5], ids=["fails", "discards", "gives_nan", "is_fatal"])
def test_after_a_run_that_failed_the_next_is_as_if_it_had_not(write_scenario, mode):
    text = (
        '[part.bad]\nfmu = PROBE\nu = 2.0\n[signals]\nactuator_voltage = ["bad.y", "bad.count"]\n'
        f'[sweep]\n[sweep.vary]\n"part.bad.mode" = [0, {mode}, 0]\n"part.bad.at" = [0.5]\n'
    )
    path = write_scenario(text, head="seconds = 1.5\nstep_size = 1e-3\n")
    plan, base = laid_out(path)
    rows = [row for _, row in _performed(base, plan.cases())]
    assert [row.status for row in rows] == ["ok", "failed", "ok"]
    assert "'bad' ended the run at t = 0.5 s" in rows[1].error
    assert values(rows[0]) == values(rows[2])


def test_what_changes_the_system_itself_may_vary_too(small, tmp_path):
    text = '[sweep]\n[sweep.vary]\nseconds = [1.3, 1.4]\n"part.again.flavour" = ["native"]\n'
    path = small(text)
    plan, base = laid_out(path)
    for case, row in _performed(base, plan.cases()):
        result = st.run(
            path, overrides={**case.values, "seed": case.seed}, out=tmp_path, report=False
        )
        assert result.metrics["drive_rms"].value == row.metrics["drive_rms"].value
        assert len(result.time) == round(1000 * case.values["seconds"])


def test_a_system_that_cannot_be_assembled_leaves_no_folder(small, tmp_path, monkeypatch):
    plan, base = laid_out(small('[sweep]\n[sweep.vary]\n"part.again.fmu" = ["gone.fmu"]\n'))
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(room))
    ((_, row),) = _performed(base, plan.cases())
    assert row.status == "failed"
    assert "gone.fmu" in row.error
    assert not list(room.iterdir())


def test_a_recording_may_vary(tmp_path, recording):
    scenario = scenarios.load(
        "closed_loop", {"seconds": 1.5, "warm_up": 0.2, "sweep": {"motions": [str(recording)] * 2}}
    )
    plan = SweepPlan(scenario, scenario.sweep, [recording])
    ((_, row),) = _performed(Base(with_places(scenario, ()), {}), [plan.case(0)])
    result = st.run(
        "closed_loop",
        motion=recording,
        overrides={"seconds": 1.5, "warm_up": 0.2},
        out=tmp_path / "alone",
        report=False,
    )
    wanted = {k: m.value for k, m in result.metrics.items() if k != "real_time_factor"}
    assert values(row) == wanted


@pytest.mark.slow  # counts pages
@pytest.mark.skipif(not STATM.exists(), reason="reads /proc")
def test_memory_stays_flat_over_many_runs(small):
    plan, base = laid_out(small(GRID))
    stand = Worker(base)

    def after(runs: int) -> int:
        for case in in_order(plan)[:runs]:
            stand.perform(case)
        return int(STATM.read_text().split()[1])

    for _ in range(3):
        after(len(plan))
    before = after(len(plan))
    for _ in range(8):
        last = after(len(plan))
    stand.close()
    # Pages of 4 KiB over 288 runs. A loop whose signals were kept would add 15 000; a process that
    # has run other tests before breaks its memory into pieces, and adds some thousand.
    assert last - before < 5_000


@pytest.mark.slow
def test_cost_is_linear_in_runs_and_in_steps(small):
    def cost(runs: int, seconds: float) -> float:
        plan, base = laid_out(
            small('[sweep]\nruns = 1\n[sweep.vary]\n"part.sensor.noise" = [1e-6]\n'),
            **{"sweep.runs": runs, "seconds": seconds},
        )
        stand = Worker(base)
        stand.perform(plan.case(0))
        begun = time.process_time()
        for case in plan.cases():
            stand.perform(case)
        spent = time.process_time() - begun
        stand.close()
        return spent

    short = min(cost(10, 20.0) for _ in range(3))
    runs = min(cost(40, 20.0) for _ in range(3))
    steps = min(cost(10, 80.0) for _ in range(3))
    assert 2.5 < runs / short < 6.0
    assert 2.0 < steps / short < 6.0


def test_a_bad_value_is_the_runs_own_and_names_the_range(small):
    plan, base = laid_out(small('[sweep]\n[sweep.vary]\n"part.sensor.noise" = [1e-6, -1.0]\n'))
    good, bad = (row for _, row in _performed(base, plan.cases()))
    assert good.status == "ok"
    assert bad.status == "failed"
    assert "'noise' = -1 m should be in [0, 0.001] m" in bad.error


def test_a_case_without_a_key_shares_nothing(small):
    plan, base = laid_out(small(GRID))
    cases = [replace(case, shared=None) for case in in_order(plan)[:4]]
    shared = [values(row) for _, row in _performed(base, in_order(plan)[:4])]
    assert shared == [values(row) for _, row in _performed(base, cases)]
    assert len(np.unique([each["drive_rms"] for each in shared])) == 4
