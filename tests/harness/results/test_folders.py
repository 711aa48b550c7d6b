"""Each run has a folder of its own, whatever runs beside it; a result never changes."""

import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import steadytip as st
from harness.results.folders import claim, new_folder
from tests.waiting import wait_until

SHORT = {"seconds": 2.0, "warm_up": 0.5}


def _run(seed, **options):
    overrides = {**SHORT, "part.hand.seed": seed}
    return st.run("closed_loop", overrides=overrides, report=False, **options)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_runs_in_a_loop_keep_their_signals_and_figures_together(here):
    results = [_run(seed) for seed in (1, 2, 3)]
    assert [result.path.name for result in results] == ["0001", "0002", "0003"]
    tips = [result.signals("instrument.tip_x") for result in results]
    assert not np.array_equal(tips[0], tips[1])
    for seed, result in zip((1, 2, 3), results, strict=True):
        alone = _run(seed)
        assert {k: m.value for k, m in alone.metrics.items() if "factor" not in k} == {
            k: m.value for k, m in result.metrics.items() if "factor" not in k
        }
    assert st.read(here / "build/runs/closed_loop").path.name == "0006"


@pytest.mark.slow
def test_runs_in_threads_do_not_meet(here):
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(_run, (1, 2, 1, 2)))
    assert len({result.path for result in results}) == 4
    tips = [result.signals("instrument.tip_x") for result in results]
    np.testing.assert_array_equal(tips[0], tips[2])
    np.testing.assert_array_equal(tips[1], tips[3])


def test_folders_made_at_once_differ(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: new_folder(tmp_path / "runs"), range(40)))
    assert sorted(path.name for path in made) == [f"{n:04d}" for n in range(1, 41)]


def test_a_folder_is_held_by_one_run(tmp_path):
    with claim(tmp_path / "out"):
        with pytest.raises(st.RecordError, match=r"another run records to .*out now"):
            _run(1, out=tmp_path / "out")
        assert not (tmp_path / "out" / "results.parquet").exists()
    assert _run(1, out=tmp_path / "out").file.is_file()


@pytest.mark.slow
def test_a_killed_run_leaves_the_others_whole(here):
    code = (
        "import steadytip as st; st.run('closed_loop', overrides={'seconds': 600.0}, report=False)"
    )
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        stream = here / "build/runs/closed_loop/0001/results.arrows"
        wait_until(lambda: stream.exists() and stream.stat().st_size > 100_000, what="a record")
        beside = _run(1)
        process.kill()
    assert beside.path.name == "0002"
    assert beside.signals("instrument.tip_x").shape == (2000,)
    killed = st.read(here / "build/runs/closed_loop/0001")
    assert len(killed.time) > 100
    assert _run(1).path.name == "0003"


def test_a_lock_ends_with_its_holder(tmp_path):
    released = threading.Event()

    def hold():
        with claim(tmp_path):
            released.wait(10.0)

    holder = threading.Thread(target=hold)
    holder.start()
    time.sleep(0.05)
    released.set()
    holder.join()
    with claim(tmp_path):
        pass
