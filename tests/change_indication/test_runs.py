"""Figures and recorded signals of the shipped scenarios."""

import json
from collections import defaultdict

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.change_indication.conftest import Check, digest
from tests.command import steadytip

RUNS = {
    "closed_loop": ("closed_loop",),
    "closed_loop_a04_noise": ("closed_loop_a04_noise",),
    "closed_loop_fused": ("closed_loop", "--fuse"),
    "closed_loop_fault": (
        *("closed_loop", "--seconds", "4", "--set"),
        'fault=[{wire="sensors.volts_a3y", kind="noise", value=0.002, at=1.0, until=2.0}]',
    ),
    "em_tracking": ("em_tracking",),
    "optical_tracking": ("optical_tracking",),
    "pose_tracking": ("pose_tracking", "--seconds", "15"),
    "raw_unit": ("raw_unit",),
    "tremor_bench_printed": ("tremor_bench", "--variant", "thesis-as-printed", "--seconds", "10"),
    "tremor_bench_forecaster": ("tremor_bench", "--variant", "forecaster", "--seconds", "10"),
}
"""Arguments of `steadytip run` by the name of the file that holds the figures."""


@pytest.mark.parametrize("name", RUNS)
def test_a_run_gives_the_same_figures_and_the_same_bits(name, tmp_path, unchanged: Check) -> None:
    steadytip("run", *RUNS[name], "--out", tmp_path, "--no-report", "--quiet")
    metrics = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    table = pq.read_table(tmp_path / "results.parquet")
    by_part: dict[str, list[str]] = defaultdict(list)
    for column in sorted(table.column_names):
        by_part[column.rpartition(".")[0] or column].append(column)
    signals = {
        f"sha256 of {len(columns)} signals of {part}, {len(table)} ticks": digest(
            np.column_stack([table.column(column).to_numpy().astype(float) for column in columns])
        )
        for part, columns in by_part.items()
    }
    del metrics["real_time_factor"]  # of the machine, not of the run
    unchanged(f"runs/{name}", {key: entry["value"] for key, entry in metrics.items()} | signals)
