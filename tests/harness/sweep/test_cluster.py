"""The same sweep on a Dask cluster: a local one, and a scheduler with workers of their own."""

import contextlib
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster

from fmu_src.errors import SteadytipError
from harness.sweep import cluster
from harness.sweep.cluster import Luggage
from harness.sweep.execution import prepare
from harness.sweep.worker import Base, Worker
from tests.waiting import wait_until

from .test_sweep import BAD, CHANCE, journal_lines, posix, rows, start, swept, wait_for

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[3]


@pytest.fixture
def quiet_dask(monkeypatch):
    """Dask's loops are left open by its own threads when a test ends."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


def test_a_local_cluster_gives_the_same_table(small, tmp_path, quiet_dask):
    path = small(CHANCE)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as local:
        found = swept(path, tmp_path / "cluster", scheduler=local.scheduler_address)
    assert rows(found) == rows(swept(path, tmp_path / "here"))


def test_threads_of_one_worker_do_not_share_parts(small, tmp_path, quiet_dask):
    path = small(CHANCE)
    with LocalCluster(
        n_workers=1, threads_per_worker=3, processes=False, dashboard_address=":0"
    ) as local:
        found = swept(path, tmp_path / "cluster", scheduler=local.scheduler_address)
    assert rows(found) == rows(swept(path, tmp_path / "here"))


def test_a_failed_run_is_a_row_here_too(small, tmp_path, quiet_dask):
    path = small('[sweep]\n[sweep.vary]\n"part.sensor.noise" = [1e-6, -1.0, 2e-6]\n')
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as local:
        found = swept(path, tmp_path / "cluster", scheduler=local.scheduler_address)
    assert [row["status"] for row in rows(found)] == ["ok", "failed", "ok"]
    assert "should be in [0, 0.001] m" in found.failed[0][2]


def test_nobody_at_the_address_is_said(small, tmp_path, monkeypatch):
    monkeypatch.setattr("harness.sweep.cluster._PATIENCE", 1.0)
    with pytest.raises(SteadytipError, match=r"--scheduler tcp://127\.0\.0\.1:9: no scheduler"):
        swept(small(CHANCE), tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def test_what_workers_need_goes_as_bytes_and_each_content_once(small, tmp_path):
    base = prepare(small(CHANCE), {}).base
    luggage = Luggage(base)
    names = {path.read_bytes() for path in [*base.files.values(), base.container]}
    assert set(luggage._data.values()) == names
    assert Luggage(base).name == luggage.name
    assert Luggage(prepare(small(CHANCE), {"part.again.noise": 1e-7}).base).name != luggage.name


def test_a_worker_runs_from_what_it_was_sent_alone(small, tmp_path):
    """The very files are gone: what a worker on another machine would find."""
    prepared = prepare(small(CHANCE), {})
    here = Worker(prepared.base)
    wanted = here.perform(prepared.plan.case(1)).metrics
    here.close()
    sent = {}
    for key, path in {**prepared.base.files, "": prepared.base.container}.items():
        sent[key] = tmp_path / "here" / path.name
        sent[key].parent.mkdir(exist_ok=True)
        sent[key].write_bytes(path.read_bytes())
    container = sent.pop("")
    luggage = pickle.loads(pickle.dumps(Luggage(Base(prepared.base.scenario, sent, container))))
    shutil.rmtree(tmp_path / "here")
    luggage.setup(None)
    try:
        stand = Worker(cluster._bases[luggage.name][0])
        found = stand.perform(prepared.plan.case(1))
        stand.close()
        assert found.metrics == wanted
    finally:
        luggage.teardown(None)
    assert luggage.name not in cluster._bases


@contextlib.contextmanager
def process(*arguments: str, folder: Path, **more) -> Iterator[subprocess.Popen]:
    command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
    log = folder / f"{arguments[0]}-{time.monotonic_ns()}.log"
    with log.open("w") as file:
        running = subprocess.Popen(command, stdout=file, stderr=file, cwd=folder, **more)
        running.log = log
        try:
            yield running
        finally:
            running.kill()
            running.wait()


def address_in(log: Path) -> str:
    return wait_until(
        lambda: re.search(r"tcp://\S+:\d+", log.read_text()), what=f"an address in {log}"
    )[0]


@posix
def test_one_of_two_workers_is_killed_in_mid_run_and_no_run_is_missing(small, tmp_path):
    """Scheduler and workers are processes of their own, in a folder without FMUs."""
    path, out, away = small(CHANCE), tmp_path / "out", tmp_path / "away"
    away.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with contextlib.ExitStack() as stack:
        host = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        scheduler = stack.enter_context(process("scheduler", *host, folder=away, env=environment))
        address = address_in(scheduler.log)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        workers = [
            stack.enter_context(process("worker", address, *options, folder=away, env=environment))
            for _ in range(2)
        ]
        more = ("--scheduler", address, "--runs", "60", "--seconds", "8", "--no-page")
        sweep = start(path, out, *more)
        wait_for(out, 6, sweep)
        workers[0].send_signal(signal.SIGKILL)
        before = journal_lines(out)
        output = sweep.communicate(timeout=120)[0]
        assert sweep.returncode == 0, output
        assert before < 60
        assert workers[1].poll() is None
    found = swept(path, out, runs=60, overrides={"seconds": 8.0})
    assert [row["status"] for row in rows(found)] == ["ok"] * 60
    here = swept(path, tmp_path / "here", runs=60, overrides={"seconds": 8.0}, workers=2)
    assert rows(found) == rows(here)
    assert not list(away.rglob("*.fmu"))


def test_a_run_that_hangs_is_lost_here_too(write_scenario, tmp_path, quiet_dask):
    text = BAD.replace("MODE", "3").replace("step_limit = 0.4", "step_limit = 50.0")
    path = write_scenario(text, head="seconds = 1.5\nstep_size = 1e-3\n")
    with LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=":0") as local:
        more = {"scheduler": local.scheduler_address, "timeout": 2.0}
        found = swept(path, tmp_path / "out", **more)
    assert [row["status"] for row in rows(found)] == ["ok", "ok", "lost", "lost", "ok", "ok"]
    assert "'timeout' of 2 s" in found.failed[0][2]
