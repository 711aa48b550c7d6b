"""The runs of a sweep: what each of them is follows from the sweep and the run's number alone.

Randomness comes from NumPy's `SeedSequence(seed of the sweep, spawn_key)`: with the key
`(0, number)` the values of a run of a Monte Carlo, with `(1, number)` the scenario's seed of a run
that has one of its own, with `(1, index)` the seeds that all runs share.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from harness.scenario.events import Change, Fault

if TYPE_CHECKING:
    from harness.scenario.schema import Scenario
    from harness.scenario.sweep import Sweep

__all__ = ["Group", "Queue", "SweepCase", "SweepPlan", "groups_of", "value_on", "words"]

_VALUES, _SEEDS = 0, 1
_SEED_BITS = 31


@dataclass(frozen=True)
class SweepCase:
    """One run of a sweep.

    Attributes:
        number: from 0.
        seed: of the scenario.
        drawn: value of each variable, by key.
        values: what parts are given by the variables that act from the beginning.
        late: what they are given by those that act later.
        changes: what the late ones do.
        motion: recording; None without one.
        fault: None without one.
        shared: key of the beginning that it has in common with other runs; None if there are none.
    """

    number: int
    seed: int
    drawn: Mapping[str, Any]
    values: Mapping[str, Any]
    late: Mapping[str, Any]
    changes: tuple[Change, ...]
    motion: str | None
    fault: Fault | None
    shared: str | None = None

    @property
    def all_changes(self) -> list[Change]:
        """In the middle of the run."""
        return [*self.changes, *(self.fault.changes() if self.fault else ())]

    @property
    def first(self) -> float:
        """Time at which anything changes for the first time [s]; infinite if nothing does."""
        return min((change.at for change in self.all_changes), default=math.inf)

    @property
    def beginning(self) -> str:
        """Runs with the same one are equal until something changes."""
        wire = [self.fault.wire, self.fault.settings] if self.fault and not self.fault.at else None
        return json.dumps([self.seed, self.motion, dict(self.values), wire], sort_keys=True)


@dataclass
class Group:
    """Runs with one beginning, the one that leaves it first in front.

    Attributes:
        numbers: of the runs.
        key: what they have in common; None of runs that are alone.
    """

    numbers: deque[int]
    key: str | None


class SweepPlan:
    """All runs of a sweep."""

    def __init__(self, scenario: Scenario, sweep: Sweep, motions: Sequence[Path] = ()) -> None:
        """Lay out the runs.

        Args:
            scenario: that is swept over.
            sweep: checked table.
            motions: recordings, folders expanded.
        """
        self.scenario = scenario
        self.sweep = sweep
        self.variables = sweep.variables
        self.motions = [str(path) for path in motions]
        self.faults = sweep.faults
        self.grid = sweep.design == "grid"
        lists: list[list[Any]] = [list(self.motions) or [None]]
        lists.append([None, *self.faults])
        lists.append([None] if self.seeds is None else list(self.seeds))
        self._turns = lists
        self._lists = [v.listed() for v in self.variables.values()] if self.grid else []
        self._lists += lists
        self._count = (
            math.prod(len(each) for each in self._lists) if self.grid else int(sweep.runs or 1)
        )

    def __len__(self) -> int:
        return self._count

    @property
    def axes(self) -> list[str]:
        """Names of everything that differs between runs: variables, `motion`, `fault`."""
        more = {"motion": len(self.motions) > 1, "fault": bool(self.faults)}
        return [*self.variables, *(name for name, there in more.items() if there)]

    @cached_property
    def seeds(self) -> list[int] | None:
        """That runs share; None where each has its own, or all the scenario's."""
        if isinstance(self.sweep.seeds, list):
            return self.sweep.seeds
        if self.sweep.seeds is None:
            return [self.scenario.seed] if self.grid else None
        return [self._seed(index) for index in range(self.sweep.seeds)]

    def _seed(self, index: int) -> int:
        sequence = np.random.SeedSequence(self.sweep.seed, spawn_key=(_SEEDS, index))
        return int(sequence.generate_state(1)[0]) & (2**_SEED_BITS - 1)

    @cached_property
    def _cube(self) -> np.ndarray:
        """Points of the Latin hypercube, (runs, variables)."""
        from scipy.stats import qmc

        cube = qmc.LatinHypercube(len(self.variables), rng=np.random.default_rng(self.sweep.seed))
        return np.asarray(cube.random(len(self)))

    def _drawn(self, number: int) -> list[Any]:
        if self.sweep.design == "latin-hypercube" and self.variables:
            points = self._cube[number]
        else:
            sequence = np.random.SeedSequence(self.sweep.seed, spawn_key=(_VALUES, number))
            points = np.random.default_rng(sequence).random(len(self.variables))
        return [v.at(float(u)) for v, u in zip(self.variables.values(), points, strict=True)]

    def case(self, number: int, shared: str | None = None) -> SweepCase:
        """One run, and the beginning that it has in common with others, if it has."""
        if self.grid:
            chosen = _digits(number, self._lists)
            values, turns = chosen[: len(self.variables)], chosen[len(self.variables) :]
        else:
            values, turns = self._drawn(number), _turns(number, self._turns)
        motion, fault, seed = turns
        if seed is None:
            seed = self._seed(number)
        drawn = dict(zip(self.variables, values, strict=True))
        both = {key: self.variables[key].whole(value) for key, value in drawn.items()}
        late = {key: value for key, value in both.items() if self.variables[key].since is not None}
        changes = tuple(
            Change(at=since, set={key.removeprefix("part."): value})
            for key, value in late.items()
            if (since := self.variables[key].since) is not None
        )
        early = {key: value for key, value in both.items() if key not in late}
        return SweepCase(number, int(seed), drawn, early, late, changes, motion, fault, shared)

    def cases(self) -> Iterator[SweepCase]:
        """Yield all runs."""
        return map(self.case, range(len(self)))


def _digits(number: int, lists: Sequence[Sequence[Any]]) -> list[Any]:
    """Return an element of the product of lists, the last one changing fastest."""
    chosen: list[Any] = []
    for each in reversed(lists):
        number, index = divmod(number, len(each))
        chosen.append(each[index])
    return chosen[::-1]


def _turns(number: int, lists: Sequence[Sequence[Any]]) -> list[Any]:
    """As `_digits`, but the first one changes fastest, and round again."""
    return _digits(number % math.prod(map(len, lists)), lists[::-1])[::-1]


def groups_of(plan: SweepPlan, numbers: Sequence[int]) -> list[Group]:
    """Group runs by their shared prefix, those of one recording together."""
    changing = plan.faults or any(v.since is not None for v in plan.variables.values())
    if not changing and len(plan.motions) < 2:
        return [Group(deque(numbers), None)]
    found: dict[str, list[tuple[float, int]]] = {}
    motion: dict[str, str] = {}
    for number in numbers:
        case = plan.case(number)
        found.setdefault(case.beginning, []).append((case.first, number))
        motion[case.beginning] = case.motion or ""
    ordered = sorted(found.items(), key=lambda item: motion[item[0]])
    together = [(key, runs) for key, runs in ordered if len(runs) > 1]
    alone = deque(runs[0][1] for _, runs in ordered if len(runs) == 1)
    groups = [Group(deque(n for _, n in sorted(runs)), key) for key, runs in together]
    return [*groups, Group(alone, None)] if alone else groups


class Queue:
    """Hands out runs so that those with one beginning go to one worker, while there are enough."""

    def __init__(self, groups: Sequence[Group]) -> None:
        """Take the runs.

        Args:
            groups: runs by their beginnings.
        """
        self._fresh = [group for group in reversed(groups) if group.key is not None]
        self._alone = deque(n for group in groups if group.key is None for n in group.numbers)
        self._begun: dict[str, Group] = {}
        """What each worker is at."""
        self.left = sum(len(group.numbers) for group in groups)

    def next(self, worker: str) -> tuple[int, str | None] | None:
        """Return a run for a worker, and the key of its shared prefix; None if none is left."""
        group = self._begun.get(worker)
        if group is None or not group.numbers:
            group = self._fresh.pop() if self._fresh else None
            if group is None and self._alone:
                self.left -= 1
                return self._alone.popleft(), None
            group = group or self._share()
            if group is None:
                return None
            self._begun[worker] = group
        self.left -= 1
        return group.numbers.popleft(), group.key

    def _share(self) -> Group | None:
        """Split the longest group that somebody is at, and return its later half."""
        longest = max(self._begun.values(), key=lambda group: len(group.numbers), default=None)
        if longest is None or not longest.numbers:
            return None
        half = len(longest.numbers) // 2
        taken = [longest.numbers.pop() for _ in range(len(longest.numbers) - half)]
        return Group(deque(reversed(taken)), longest.key)


def value_on(axis: str, case: SweepCase) -> Any:
    """Return what a run has on an axis: a value, the name of a recording, a fault in words."""
    if axis == "motion":
        return Path(case.motion).name if case.motion else ""
    if axis == "fault":
        return words(case.fault)
    return case.drawn[axis]


def words(fault: Fault | None) -> str:
    """Describe a fault for people."""
    if fault is None:
        return "none"
    measure = "" if fault.value is None else f" {fault.value:g}"
    until = "" if fault.until is None else f" to {fault.until:g} s"
    return f"{fault.kind}{measure} on {fault.wire} from {fault.at:g} s{until}"
