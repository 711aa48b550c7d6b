"""All checks of one FMU."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Container
from dataclasses import dataclass
from pathlib import Path

from fmu_src.errors import SteadytipError
from harness.validation import archive, binary, description, structure  # noqa: F401 - register
from harness.validation.checks import FILES, ITEMS, PROBES, CheckOutcome
from harness.validation.files import Fmu
from harness.validation.running import run_probes

__all__ = ["Validation", "validate"]


@dataclass(frozen=True)
class Validation:
    """Results of all checks of one FMU.

    Attributes:
        path: the file.
        outcomes: of all checks, in the order of the checklist.
    """

    path: Path
    outcomes: tuple[CheckOutcome, ...]

    @property
    def counts(self) -> Counter[str]:
        """Numbers of checks that ended as `ok`, `error`, `warning`, `info`, `skipped`."""
        return Counter(outcome.verdict for outcome in self.outcomes)

    @property
    def good(self) -> bool:
        """True if there is no error."""
        return not self.counts["error"]

    def __getitem__(self, id: str) -> CheckOutcome:
        """Return the outcome of one check by its id."""
        return next(outcome for outcome in self.outcomes if outcome.id == id)


def validate(
    path: str | os.PathLike[str],
    *,
    timeout: float = 60.0,
    only: Container[str] | None = None,
    progress: Callable[[int, int, str], None] = lambda _done, _all, _id: None,
) -> Validation:
    """Check an FMU: its archive, description and binaries, then the running FMU.

    Args:
        path: the file.
        timeout: for each probe of the running FMU [s].
        only: ids of the checks to carry out; all by default.
        progress: called with the checks done, the checks in all, and the id of the last one.

    Raises:
        SteadytipError: there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise SteadytipError(f"FMU {path} does not exist")
    fmu = Fmu(path)
    found: list[CheckOutcome] = []
    files, probes = (
        [check for check in registry.values() if only is None or check.id in only]
        for registry in (FILES, PROBES)
    )
    count = len(files) + len(probes)

    def add(outcome: CheckOutcome) -> None:
        found.append(outcome)
        progress(len(found), count, outcome.id)

    for check in files:
        add(check.run(fmu))
    for outcome in run_probes(fmu, probes, timeout):
        add(outcome)
    order = list(ITEMS)
    return Validation(path, tuple(sorted(found, key=lambda outcome: order.index(outcome.item))))
