"""Resident memory.

Of FMUs: the first instance with its library, unpacked and begun, and what each further one adds;
one that takes less than a page adds nothing now and then. Of runs of `closed_loop`, each with its
record and metrics, in one process: what further runs add, what a long run adds while it ticks, and
what is there after it, with its metrics, which read the signals that they need.
"""

import statistics
from itertools import pairwise

from fmu_src import pack
from harness.bench import probes
from harness.bench.session import Bench

_SCENARIO = "closed_loop"
_SHORT, _LONG = 2.0, 60.0  # s
_KIBI = 1024.0


def bench_instances(bench: Bench) -> None:
    """Measure each FMU."""
    count = 5 if bench.quick else 50
    found = probes.in_new_process(probes.instances, pack.build(), count)
    for name, sizes in found.items():
        for column, size in zip(("first", "each further"), sizes, strict=True):
            setting = f"{count} instances beside the first"
            bench.add(name, column, _KIBI * size, "KiB", setting=setting, part="instances")


def bench_runs(bench: Bench) -> None:
    """Measure runs in one process, and a long one."""
    count, short, longer = (4, 0.5, 10.0) if bench.quick else (20, _SHORT, _LONG)
    sizes, _ = probes.in_new_process(probes.runs, _SCENARIO, short, count)
    late = [b - a for a, b in pairwise(sizes[-(count // 2) - 1 :])]
    (_, after), ticking = probes.in_new_process(probes.runs, _SCENARIO, longer, 1)
    several = f"{count} runs of {short:g} s in one process"
    long = f"{longer:g} s, the first run of its process"
    for row, value, unit, setting, wanted in (
        ("a process with all imports", sizes[0], "MiB", "", ""),
        ("after its first run", sizes[1], "MiB", several, ""),
        (
            "each further run adds",
            _KIBI * statistics.fmean(late),
            "KiB",
            f"{several}, mean of the later half",
            "0: flat over runs",
        ),
        *(
            [("ticks of a long run add", _KIBI * ticking, "KiB", long, "0: flat over steps")]
            if ticking is not None
            else []
        ),
        ("after a long run", after, "MiB", long, ""),
    ):
        bench.add(row, "", value, unit, setting=setting, wanted=wanted, part="runs")
