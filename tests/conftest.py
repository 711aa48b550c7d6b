"""What several folders of tests share: where the recordings are, and each model in one process."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Read by NumPy's library when it is loaded. Each core has a worker of its own: further threads only
# wait for each other, at the cost of the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

from fmu_src.pack import model_names

# A machine that is busy is no fault of the code: no deadline, and slow generation is no failure. CI
# tries the same examples each time.
settings.register_profile(
    "steadytip",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("steadytip")

# A shell without job control starts background processes with SIGINT ignored, and children inherit
# that; tests that interrupt a command must not depend on who started the suite.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def by_model() -> list[Any]:
    """Parameters of a fixture or test: the name of each model.

    All that is done with one model is done by the same worker, so that the model is recorded,
    built, described and unpacked once.
    """
    return [pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in model_names()]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update", action="store_true", help="write the tracked figures of change_indication anew"
    )


_FIRST = ("wall-clock", "platforms")
"""Groups of tests that take minutes, each in one worker."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, or the other workers would wait for it in the end.

    Quick tests are the last: they fill what the long ones leave.
    """

    def rank(item: pytest.Item) -> int:
        groups = {mark.args[0] for mark in item.iter_markers("xdist_group")}
        if groups & set(_FIRST):
            return 0
        return 1 if item.get_closest_marker("slow") else 2

    items.sort(key=rank)


@pytest.fixture
def nothing_kept() -> Iterator[None]:
    """All that is built is made anew."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fmu_src.pack.cache.find", lambda *_: None)
        yield


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the recordings, from STEADYTIP_DATA or beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STEADYTIP_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no recordings: {folder} does not exist; set STEADYTIP_DATA to their folder")
    return folder
