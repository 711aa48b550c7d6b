"""The table `[sweep]` of a scenario: what is varied, and how.

    [sweep]
    method  = "monte-carlo"       # or "latin-hypercube", "grid"
    runs    = 1000                # not of a grid, which has as many as it has points
    seed    = 1                   # of the sweep: values and seeds of all runs follow from it
    seeds   = 20                  # seeds of the scenario, or a list of them
    motions = ["recordings"]      # files or folders
    judge   = "tip_rms"           # figure that tells the worst runs
    timeout = 60.0                # wall-clock time that a run may take [s]

    [sweep.vary]                  # keys as `--set` takes them
    "part.sensors.accelerometer_noise" = { min = 1e-4, max = 5e-3, scale = "log" }
    "part.piezo_1.gain_error"          = { mean = 0.0, sigma = 0.03 }
    "part.hand.tremor_rms"             = [3e-5, 5e-5]
    "part.estimator.gain"              = { values = [1.0, 2.0], from = 5.0 }

    [[sweep.fault]]               # one of them in a run, or none
    wire  = "sensors.volts_a3y"
    kind  = "offset"
    value = [0.1, 0.2]
    at    = 5.0

A grid is the product of everything that is listed: values, seeds, recordings, faults; without
`seeds` all runs have the scenario's. Of the other methods each run has values of its own and,
without `seeds`, a seed of its own; recordings, faults and `seeds` take turns.

| what is said of a variable | values |
| --- | --- |
| a list, or `values` | each of them, equally likely |
| `min`, `max`, `scale` | uniform, the logarithm if `scale` is `log`; `points` of them in a grid |
| `mean`, `sigma` | normal; cut off at `min` and `max`, if given |
| `distribution`, and its arguments | of that name in `scipy.stats` |

`integer = true` rounds. `times = [1e-5, 2e-5]` is for arrays: each element is the value times its
own number. A variable with `from` acts from that time on [s]; until then it is as the scenario has
it. Only what can be set in a run can have one: see `harness.system.events`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from harness.common.errors import nearest
from harness.common.strict_model import Positive, StrictModel
from harness.common.validation_errors import explain
from harness.scenario.events import Fault

if TYPE_CHECKING:
    pass

__all__ = ["METHODS", "FaultRange", "Sweep", "SweepVariable", "variables_of"]

METHODS = ("grid", "latin-hypercube", "monte-carlo")
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_SCALES = ("linear", "log")
_EDGE = 1e-12
"""Distance of a probability from 0 and 1: no distribution gives infinity."""


class SweepVariable(BaseModel):
    """What is said of one variable; see the module's table.

    Attributes:
        key: as `--set` takes it.
        extra: arguments of the distribution.
    """

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, populate_by_name=True)

    values: list[Any] | None = Field(default=None, min_length=1)
    min: _Finite | None = None
    max: _Finite | None = None
    scale: Literal["linear", "log"] | _Finite = "linear"
    points: int | None = Field(default=None, ge=1)
    mean: _Finite | None = None
    sigma: Positive | None = None
    distribution: str | None = None
    integer: bool = False
    times: list[_Finite] | None = Field(default=None, min_length=1)
    since: Positive | None = Field(default=None, alias="from")

    @property
    def form(self) -> str:
        """Row of the module's table that it is; empty if it is none."""
        if self.values is not None:
            return "values"
        if self.distribution is not None:
            return "distribution"
        if self.mean is not None:
            return "mean"
        return "min" if self.min is not None else ""

    def trouble(self, grid: bool) -> Iterator[str]:
        """Yield what is wrong with it."""
        given = {name for name in self.model_fields_set if getattr(self, name) is not None}
        extra = self.model_extra or {}
        allowed = {
            "values": {"values"},
            "distribution": {"distribution", *({"scale"} if self.scale not in _SCALES else ())},
            "mean": {"mean", "sigma", "min", "max"},
            "min": {"min", "max", "scale", "points"},
            "": {"min", "max", "scale", "points"},
        }[self.form] | {"integer", "times", "since"}
        if self.form != "distribution" and extra:
            known = [f.alias or name for name, f in type(self).model_fields.items()]
            yield from (f"unknown key '{key}'; {nearest(key, known)}" for key in extra)
            return
        if given - allowed:
            yield f"'{', '.join(sorted(given - allowed))}' does not go with '{self.form or 'min'}'"
        if self.form == "":
            yield "say 'values', or 'min' and 'max', or 'mean' and 'sigma', or 'distribution'"
        elif self.form == "min":
            yield from self._range_trouble()
        elif self.form == "mean" and self.sigma is None:
            yield "'mean' needs a 'sigma'"
        elif self.form == "distribution":
            yield from self._distribution_trouble()
        if self.form == "mean" and self.min is not None and self.max is not None:
            yield from self._range_trouble()
        if grid and self.form in {"mean", "distribution"}:
            yield "a grid needs 'values', or 'min', 'max' and 'points'"
        elif grid and self.form == "min" and self.points is None:
            yield "a grid needs the number of 'points' between 'min' and 'max'"

    def _range_trouble(self) -> Iterator[str]:
        if self.min is None or self.max is None:
            yield "'min' and 'max' go together"
        elif self.min >= self.max:
            yield f"'min' = {self.min:g} is not below 'max' = {self.max:g}"
        elif self.scale not in _SCALES:
            yield f"'scale' = {self.scale}: one of {', '.join(_SCALES)}"
        elif self.scale == "log" and self.min <= 0.0:
            yield f"'min' = {self.min:g}: a logarithmic scale has positive values only"

    def _distribution_trouble(self) -> Iterator[str]:
        from scipy import stats

        known = [n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous)]
        if self.distribution not in known:
            hint = nearest(str(self.distribution), known)
            yield f"'distribution' = {self.distribution!r}: {hint}"
            return
        try:
            good = math.isfinite(self._frozen.ppf(0.5))
        except (TypeError, ValueError) as error:
            yield f"distribution '{self.distribution}': {error}"
            return
        if not good:
            yield f"distribution '{self.distribution}' has no values for these arguments"

    @cached_property
    def _frozen(self) -> Any:
        from scipy import stats

        arguments = dict(self.model_extra or {})
        if self.scale not in _SCALES:
            arguments["scale"] = self.scale
        return getattr(stats, str(self.distribution))(**arguments)

    def _normal(self, u: float) -> float:
        """Quantile of the normal distribution between `min` and `max`."""
        from scipy.special import ndtr, ndtri

        assert self.mean is not None
        assert self.sigma is not None
        low = -math.inf if self.min is None else self.min
        high = math.inf if self.max is None else self.max
        a, b = ((end - self.mean) / self.sigma for end in (low, high))
        # Near 1 a probability has few digits: the upper half is the mirrored lower one.
        sign = -1.0 if a > 0.0 else 1.0
        start, end = (ndtr(a), ndtr(b)) if sign > 0.0 else (ndtr(-a), ndtr(-b))
        value = self.mean + self.sigma * sign * float(ndtri(start + (end - start) * u))
        return min(max(value, low), high)

    def whole(self, value: Any) -> Any:
        """Return what a part is given for a value."""
        return value if self.times is None else [value * each for each in self.times]

    def at(self, u: float) -> Any:
        """Value at a probability in (0, 1)."""
        if self.values is not None:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        u = min(max(u, _EDGE), 1.0 - _EDGE)
        if self.form == "min":
            assert self.min is not None
            assert self.max is not None
            if self.scale == "log":
                value = self.min * (self.max / self.min) ** u
            else:
                value = self.min + (self.max - self.min) * u
            value = min(max(value, self.min), self.max)
        elif self.form == "mean":
            value = self._normal(u)
        else:
            value = float(self._frozen.ppf(u))
        return round(value) if self.integer else float(value)

    def listed(self) -> list[Any]:
        """Values in a grid."""
        if self.values is not None:
            return list(self.values)
        assert self.points is not None
        points = [self.at(k / max(self.points - 1, 1)) for k in range(self.points)]
        points[-1] = self._end if self.points > 1 else points[-1]
        points[0] = self._begin
        return list(dict.fromkeys(points))

    @property
    def _begin(self) -> Any:
        return round(self.min or 0.0) if self.integer else float(self.min or 0.0)

    @property
    def _end(self) -> Any:
        return round(self.max or 0.0) if self.integer else float(self.max or 0.0)


def _as_list(value: Any) -> Any:
    """Wrap a single value into a list."""
    return value if isinstance(value, list) else [value]


def _no_value() -> list[float | None]:
    return [None]


class FaultRange(StrictModel):
    """Faults of one wire and kind, every combination of what is listed; see `Fault`."""

    wire: str
    kind: str
    value: Annotated[list[float | None], BeforeValidator(_as_list)] = Field(
        default_factory=_no_value
    )
    at: Annotated[list[float], BeforeValidator(_as_list)] = Field(default_factory=lambda: [0.0])
    until: float | None = None

    def faults(self) -> Iterator[Fault]:
        """One after the other.

        Raises:
            ValidationError: one is none.
        """
        for value in self.value:
            for at in self.at:
                yield Fault(
                    wire=self.wire,
                    kind=self.kind,  # type: ignore[arg-type]
                    value=None if value is None else float(value),
                    at=float(at),
                    until=None if self.until is None else float(self.until),
                )


class Sweep(StrictModel):
    """The table; see the module."""

    method: Literal["grid", "latin-hypercube", "monte-carlo"] | None = None
    runs: int | None = Field(default=None, ge=1)
    seed: int = Field(default=1, ge=0)
    seeds: int | list[int] | None = None
    motions: list[str] = Field(default_factory=list)
    judge: str | None = None
    vary: dict[str, Any] = Field(default_factory=dict)
    timeout: Positive | None = None
    fault: list[FaultRange] = Field(default_factory=list)

    @property
    def design(self) -> str:
        """The method: a grid where neither that nor a number of runs is given."""
        return self.method or ("grid" if self.runs is None else "monte-carlo")

    @cached_property
    def variables(self) -> dict[str, SweepVariable]:
        """By key.

        Raises:
            ValidationError: one is none.
        """
        return {key: _variable(said) for key, said in variables_of(self.vary).items()}

    @cached_property
    def faults(self) -> tuple[Fault, ...]:
        """Faults in their order."""
        return tuple(fault for each in self.fault for fault in each.faults())

    def problems(self) -> list[str]:
        """Everything that is wrong with the table alone."""
        found: list[str] = []
        grid = self.design == "grid"
        if grid and self.runs is not None:
            found.append("sweep.runs: a grid has as many runs as it has points; leave 'runs' out")
        if not grid and self.runs is None:
            found.append(f"sweep.runs is missing: how many runs of '{self.design}'?")
        numbers = self.seeds if isinstance(self.seeds, list) else [self.seeds or 1]
        least = 0 if isinstance(self.seeds, list) else 1
        if not numbers or any(number < least for number in numbers):
            found.append(f"sweep.seeds = {self.seeds!r}: a number of seeds, or a list of them")
        for key, said in variables_of(self.vary).items():
            try:
                found += [f"sweep.vary '{key}': {text}" for text in _variable(said).trouble(grid)]
            except ValidationError as error:
                texts = explain(error, SweepVariable)
                found += [f"sweep.vary '{key}': {text}" for text in texts]
        for each in self.fault:
            try:
                wrong = {fault.trouble for fault in each.faults()} - {""}
                found += [f"sweep.fault on '{each.wire}': {text}" for text in sorted(wrong)]
            except ValidationError as error:
                texts = explain(error, FaultRange)
                found += [f"sweep.fault on '{each.wire}': {text}" for text in texts]
        if not (self.vary or self.fault or self.motions or self.seeds or self.runs):
            found.append("sweep: nothing is varied; say so in [sweep.vary], or give 'seeds'")
        return found


def variables_of(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return what is said of each variable by its dotted key; keys may be written as nested tables.

    >>> variables_of({"part": {"hand": {"rms": [1, 2]}}, "part.a.b": {"min": 0, "max": 1}})
    {'part.hand.rms': [1, 2], 'part.a.b': {'min': 0, 'max': 1}}
    """
    known = {field.alias or name for name, field in SweepVariable.model_fields.items()}
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping) and value and not known & value.keys() and _deep(value):
            found |= variables_of(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found


def _deep(value: Mapping[str, Any]) -> bool:
    return all(isinstance(each, Mapping | list) for each in value.values())


def _variable(said: Any) -> SweepVariable:
    if isinstance(said, Mapping):
        return SweepVariable.model_validate(dict(said))
    return SweepVariable(values=said if isinstance(said, list) else [said])
