"""Time to build each native FMU, for this machine's platform.

Each column is a process of its own, with the models' modules loaded. Without a cache, the compiler
has nothing but its own libraries for this target, which the build of another FMU has left there;
with it, FMUs are gone and the build folder is kept. Up to date is what each run asks for.
"""

import shutil
from pathlib import Path

import pytest

from fmu_src.pack.discovery import model_names
from harness.bench import probes
from harness.bench.session import Bench
from harness.bench.timing import counting

_FIRST = "Wflc"  # brings the compiler's own libraries along
_QUICK = ("Flc", "PiezoStack")
_STATES = ("without a cache", "with a cache", "up to date")


@pytest.fixture(scope="module")
def spent(folder: Path, quick: bool) -> dict[str, dict[str, float]]:
    """Return seconds by state and model."""
    place = folder / "build"
    place.mkdir()
    names = [name for name in (_QUICK if quick else model_names()) if name != _FIRST]
    probes.in_new_process(probes.builds, place, [_FIRST])
    cold = probes.in_new_process(probes.builds, place, names)
    shutil.rmtree(place / "build" / "fmus")
    found = (cold, *(probes.in_new_process(probes.builds, place, names) for _ in range(2)))
    return dict(zip(_STATES, found, strict=True))


@pytest.mark.parametrize("state", _STATES)
@pytest.mark.parametrize("name", model_names())
def bench_build(bench: Bench, name: str, state: str, spent: dict[str, dict[str, float]]) -> None:
    """Build one FMU."""
    if name in spent[state]:
        bench.time(name, state, counting(lambda: spent[state][name]), unit="s", rounds=1)


def bench_all(bench: Bench, spent: dict[str, dict[str, float]]) -> None:
    """Sum the builds of each state."""
    for state, seconds in spent.items():
        bench.add(f"all {len(seconds)}", state, sum(seconds.values()), "s")
