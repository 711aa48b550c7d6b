"""Whether a run on the wall clock was as it should be: what a rig that nobody watches is asked.

| checked | good |
| --- | --- |
| the run | it ended in order, and so did its board and its log |
| each kind of fault | none was counted; of `MACHINES`, only where the scenario has a limit |
| `lost_samples`, `invalid` | 0 |
| what `[hil.limits]` names | figure of merit or kind of fault within its limits |

Limits of the scenario take the place of those above. A figure that a run does not have, because it
was too short for it or because there is none of that name, is not within any limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from harness.can.reception import FAULTS
from harness.common.errors import nearest
from harness.common.junit import JunitCase, JunitSuite
from harness.common.quantities import format_quantity
from harness.scenario.schema import Limit

if TYPE_CHECKING:
    from harness.results.result import Result

__all__ = ["MACHINES", "Judged", "judge", "never_ran", "suite_of"]

MACHINES = ("late", "overruns")
"""Kinds of faults that are the machine's and not the bus's: none is too much to ask of most."""
_NONE = Limit(max=0.0)
_ALWAYS = ("lost_samples", "invalid")


@dataclass(frozen=True)
class Judged:
    """One thing that was checked.

    Attributes:
        group: `run`, `faults` or `figures`.
        name: what.
        found: in words.
        failure: what is wrong with it, in words; empty if nothing is.
    """

    group: str
    name: str
    found: str
    failure: str = ""


def judge(result: Result) -> list[Judged]:
    """Everything that is checked of a run on the wall clock."""
    metadata = result.metadata.hil or {}
    judged = [
        Judged("run", "ended in order", f"{len(result.time)} ticks", result.error or ""),
        Judged(
            "run",
            "board and log ended in order",
            f"log: {metadata['log']}" if metadata.get("log") else "there is no log",
            "\n".join(metadata["notes"]),
        ),
    ]
    limits = {name: Limit(**limit) for name, limit in metadata.get("limits", {}).items()}
    return [*judged, *_within(result, metadata.get("counts", {}), limits)]


def _within(
    result: Result, counts: Mapping[str, int], limits: Mapping[str, Limit]
) -> Iterator[Judged]:
    for kind, count in counts.items():
        limit = limits.get(kind, None if kind in MACHINES else _NONE)
        if limit is not None:
            yield _judged("faults", kind, float(count), "1", limit)
    metrics = result.metrics
    always = {name: _NONE for name in _ALWAYS if name in metrics}
    for name, limit in (always | dict(limits)).items():
        if name in counts:
            continue
        if name in metrics:
            yield _judged("figures", name, metrics[name].value, metrics[name].unit, limit)
        else:
            known = [*metrics, *FAULTS]
            text = f"this run has no figure and no kind of fault '{name}'; {nearest(name, known)}"
            yield Judged("figures", name, "there is none", text)


def _judged(group: str, name: str, value: float, unit: str, limit: Limit) -> Judged:
    found = _words(value, unit)
    ends = {
        "at least": (limit.min, limit.min is None or value >= limit.min),
        "at most": (limit.max, limit.max is None or value <= limit.max),
    }
    wanted = [f"{how} {_words(end, unit)}" for how, (end, _) in ends.items() if end is not None]
    good = all(well for _, well in ends.values())
    failure = "" if good else f"{name} is {found}; it has to be {' and '.join(wanted)}"
    return Judged(group, name, f"{found}, wanted: {' and '.join(wanted) or 'anything'}", failure)


def _words(value: float, unit: str) -> str:
    return " ".join(format_quantity(value, unit)).strip()


def suite_of(name: str, judged: list[Judged], seconds: float) -> JunitSuite:
    """For JUnit XML.

    Args:
        name: of the scenario.
        judged: what was checked.
        seconds: how long the run took [s].
    """
    return JunitSuite(
        name,
        tuple(
            JunitCase(
                group=f"{name}.{each.group}",
                name=each.name,
                seconds=seconds if index == 0 else 0.0,
                failure=each.failure,
                output=each.found,
            )
            for index, each in enumerate(judged)
        ),
    )


def never_ran(why: str) -> list[Judged]:
    """Return the suite of a run that ended before its first tick."""
    return [Judged("run", "ended in order", "no tick", why)]
