"""Benchmarks as a session of pytest: what they are given, and what becomes of their numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import pytest_benchmark  # noqa: F401 - whoever has none is told so by the import

from fmu_src.errors import SteadytipError
from harness.bench.results import BenchResults

if TYPE_CHECKING:
    from harness.common.figures import Figure

__all__ = ["SUITE", "Bench", "measure"]

SUITE = Path(__file__).with_name("suite")
_SCALES = {"s": 1.0, "ms": 1e3, "us": 1e6}
_LONG, _SHORT = 1.0, 0.05  # s that pytest-benchmark calibrates for


@dataclass(frozen=True)
class Bench:
    """Fixture `bench` of a benchmark, beside pytest-benchmark's own fixture.

    Attributes:
        group: that it belongs to.
        book: that its numbers go to.
        quick: whether numbers may be rough.
        seconds: length of runs on the wall clock [s].
        folder: for files, the same for all benchmarks.
    """

    group: str
    results: BenchResults
    quick: bool
    seconds: float
    folder: Path
    _request: pytest.FixtureRequest

    def add(
        self, row: str, column: str, values: Sequence[float] | float, unit: str, **more: Any
    ) -> None:
        """Add samples; see `BenchResults.add`."""
        found = [values] if isinstance(values, float | int) else values
        self.results.add(self.group, row, column, found, unit, **more)

    def ratio(
        self, row: str, column: str, over: tuple[str, str], under: tuple[str, str], wanted: str = ""
    ) -> None:
        """Add a ratio; see `BenchResults.ratio`."""
        self.results.ratio(self.group, row, column, over, under, wanted=wanted)

    def add_figure(self, part: str, row: str, column: str, figure: Figure) -> None:
        """Add a figure; see `BenchResults.add_figure`."""
        self.results.add_figure(self.group, part, row, column, figure)

    def time(
        self,
        row: str,
        column: str,
        action: Callable[[], Any],
        *,
        unit: str = "us",
        per: float = 1,
        rounds: int | None = None,
        warmup: int = 0,
        setup: Callable[[], None] | None = None,
        setting: str = "",
        wanted: str = "",
        best: bool = False,
    ) -> list[float]:
        """Measure an action.

        Args:
            row: what it is.
            column: what of it is measured.
            action: to be timed.
            unit: `s`, `ms` or `us`.
            per: how many of what is counted it does.
            rounds: times that it is done; None: as often as calibration finds right.
            warmup: times that it is done before.
            setup: to be done before each round, untimed.
            setting: under which conditions.
            wanted: what is, in words.
            best: give the least of all rounds beside the median, as "at best".

        Returns:
            The samples [unit].
        """
        benchmark = self._request.getfixturevalue("benchmark")
        if rounds is None:
            benchmark(action)
        else:
            benchmark.pedantic(action, rounds=rounds, warmup_rounds=warmup, setup=setup)
        values = [_SCALES[unit] / per * spent for spent in benchmark.stats.stats.data]
        self.add(row, column, values, unit, setting=setting, wanted=wanted)
        if best:
            self.add(
                row,
                ", ".join(filter(None, (column, "at best"))),
                values,
                unit,
                setting=setting,
                statistic=min,
            )
        return values


@dataclass(eq=False)
class _Plugin:
    """Plugin of the pytest session."""

    _results: BenchResults
    _quick: bool
    _seconds: float
    _turns: int
    _status: Callable[[str], None]
    troubles: list[str] = field(default_factory=list)

    @pytest.fixture(scope="session")
    def folder(self, tmp_path_factory: pytest.TempPathFactory) -> Path:
        """Return a folder for files of all benchmarks."""
        return tmp_path_factory.mktemp("bench")

    @pytest.fixture(scope="session")
    def quick(self) -> bool:
        """Return whether numbers may be rough."""
        return self._quick

    @pytest.fixture
    def bench(self, request: pytest.FixtureRequest, folder: Path) -> Bench:
        """Return what a benchmark is given; see `Bench`."""
        group = request.path.stem
        return Bench(group, self._results, self._quick, self._seconds, folder, request)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Measure in turns what is compared: the machine changes while it does."""
        if "turn" in metafunc.fixturenames:
            metafunc.parametrize("turn", range(self._turns))

    def pytest_runtest_logstart(self, nodeid: str, location: Any) -> None:
        """Say what is being done."""
        path, _, name = nodeid.partition("::")
        self._status(f"{Path(path).stem}: {name.removeprefix('bench_').replace('_', ' ')}")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: Any) -> Any:
        """Keep the other benchmarks going where one fails, and note the failure."""
        report = yield
        error = call.excinfo.value if call.excinfo is not None else None
        if isinstance(error, pytest.skip.Exception | SteadytipError):
            # For the session, a benchmark that the machine cannot do has not failed.
            report.outcome = "skipped"
            report.longrepr = (str(item.path), 0, str(error))
            self._results.skip(item.path.stem, str(error))
            self._status(f"skipped: {error}")
        elif report.failed:
            self.troubles.append(f"{item.name}:\n{report.longreprtext}")
        return report


def measure(
    groups: Sequence[str],
    *,
    quick: bool = False,
    seconds: float = 20.0,
    status: Callable[[str], None] = lambda _: None,
) -> BenchResults:
    """Run groups of benchmarks.

    Args:
        groups: names of files of the suite.
        quick: rough numbers soon.
        seconds: length of runs on the wall clock [s].
        status: called with a text on what is being done.

    Raises:
        SteadytipError: a benchmark is broken.
    """
    results = BenchResults()
    turns = 2 if quick else 7
    plugin = _Plugin(results, quick, seconds, turns, status)
    span = _SHORT if quick else _LONG
    ended = pytest.main(
        [
            *(str(SUITE / f"{group}.py") for group in groups),
            f"--config-file={SUITE / 'pytest.ini'}",
            f"--rootdir={SUITE}",
            f"--benchmark-max-time={span}",
            "--benchmark-timer=harness.bench.timing.now",
        ],
        plugins=[plugin],
    )
    if plugin.troubles:
        raise SteadytipError("a benchmark is broken: " + "\n".join(plugin.troubles))
    if ended not in (pytest.ExitCode.OK, pytest.ExitCode.INTERRUPTED):
        raise SteadytipError(f"pytest ended with {ended!r}")
    return results
