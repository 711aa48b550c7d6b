"""Benchmarks as a session of pytest: what they are given, and what becomes of their numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import pytest_benchmark  # noqa: F401 - whoever has none is told so by the import

from harness.bench.results import Book
from harness.common.errors import SteadytipError

if TYPE_CHECKING:
    from harness.common.figures import Figure

__all__ = ["SUITE", "Bench", "measure"]

SUITE = Path(__file__).with_name("suite")
_SCALES = {"s": 1.0, "ms": 1e3, "us": 1e6}
_LONG, _SHORT = 1.0, 0.05  # s that pytest-benchmark calibrates for


@dataclass(frozen=True)
class Bench:
    """What a benchmark has beside pytest-benchmark's own fixture: the fixture `bench`.

    Attributes:
        group: that it belongs to.
        book: that its numbers go to.
        quick: whether numbers may be rough.
        seconds: length of runs on the wall clock [s].
        folder: for files, the same for all benchmarks.
    """

    group: str
    book: Book
    quick: bool
    seconds: float
    folder: Path
    _request: pytest.FixtureRequest

    def add(
        self, row: str, column: str, values: Sequence[float] | float, unit: str, **more: Any
    ) -> None:
        """See `Book.add`."""
        found = [values] if isinstance(values, float | int) else values
        self.book.add(self.group, row, column, found, unit, **more)

    def ratio(
        self, row: str, column: str, over: tuple[str, str], under: tuple[str, str], wanted: str = ""
    ) -> None:
        """See `Book.ratio`."""
        self.book.ratio(self.group, row, column, over, under, wanted=wanted)

    def take(self, part: str, row: str, column: str, figure: Figure) -> None:
        """See `Book.take`."""
        self.book.take(self.group, part, row, column, figure)

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


class _Plugin:
    """Of the session."""

    def __init__(
        self,
        book: Book,
        quick: bool,
        seconds: float,
        turns: int,
        status: Callable[[str], None],
    ) -> None:
        self._book, self._quick, self._seconds = book, quick, seconds
        self._turns, self._status = turns, status
        self.troubles: list[str] = []

    @pytest.fixture(scope="session")
    def folder(self, tmp_path_factory: pytest.TempPathFactory) -> Path:
        """For files of all benchmarks."""
        return tmp_path_factory.mktemp("bench")

    @pytest.fixture(scope="session")
    def quick(self) -> bool:
        """Whether numbers may be rough."""
        return self._quick

    @pytest.fixture
    def bench(self, request: pytest.FixtureRequest, folder: Path) -> Bench:
        """See `Bench`."""
        group = request.path.stem
        return Bench(group, self._book, self._quick, self._seconds, folder, request)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """What is compared is measured in turns: the machine changes while it does."""
        if "turn" in metafunc.fixturenames:
            metafunc.parametrize("turn", range(self._turns))

    def pytest_runtest_logstart(self, nodeid: str, location: Any) -> None:
        """Say what is being done."""
        path, _, name = nodeid.partition("::")
        self._status(f"{Path(path).stem}: {name.removeprefix('bench_').replace('_', ' ')}")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: Any) -> Any:
        """What cannot be had keeps no other benchmark; what is broken is told."""
        report = yield
        error = call.excinfo.value if call.excinfo is not None else None
        if isinstance(error, pytest.skip.Exception | SteadytipError):
            # For the session, a benchmark that the machine cannot do has not failed.
            report.outcome = "skipped"
            report.longrepr = (str(item.path), 0, str(error))
            self._book.skip(item.path.stem, str(error))
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
) -> Book:
    """Run groups of benchmarks.

    Args:
        groups: names of files of the suite.
        quick: rough numbers soon.
        seconds: length of runs on the wall clock [s].
        status: told in a few words what is being done.

    Raises:
        SteadytipError: a benchmark is broken.
    """
    book = Book()
    turns = 2 if quick else 7
    plugin = _Plugin(book, quick, seconds, turns, status)
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
    return book
