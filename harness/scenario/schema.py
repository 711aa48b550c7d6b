"""Scenario files: which parts, how they are wired, for how long.

A scenario is TOML. Keys of the file:

| key | unit | meaning |
| --- | --- | --- |
| title | | one line for people |
| extends | | scenario that this one changes, or a list of them, one laid over the other |
| seconds | s | simulated time |
| step_size | s | period of the loop |
| warm_up | s | left out of the metrics at the start |
| seed | | all randomness of the run follows from it |
| part.NAME | | one member of the loop: one key of `harness.parts.kinds.kinds()`, and its settings |
| variant.NAME | | what one variant changes, as `extends` does; `steadytip run` compares them |
| wire | | list of `from`, `to` (`part.port`; a `*` is the same text on both sides), `delay` |
| signals | | what the metrics and the report read: role = port, pattern (`*`, `?`) or list |
| change, fault | | lists of what happens in the middle of a run: `harness.system.events` |
| hil | | the loop on the wall clock: `Hil` |
| sweep | | what `steadytip sweep` varies: `harness.scenario.sweep` |

Laid over another table, parts and variants merge per key; a wire takes the place of one with the
same `to`, or is appended.

Settings that every kind of part has: `step_limit` (wall-clock time that one call may take [s]),
`motion` (a recording that is streamed into the part's inputs `recorded_*`), `accept` and `repair`
(names of findings about that recording to go on with, or to repair), `columns` (what the recording
does not say: `{ time = "t", time_unit = "ms", length_unit = "um", rate = 250.0 }`) and
`innovation_size` (degrees of freedom of each correction of an estimator that has no output of that
name). Where a scenario makes another kind of a part, `stands_for` keeps the table that the part had
before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from harness.can.timing import Timing
from harness.common.endpoint import Endpoint
from harness.common.strict_model import Positive, StrictModel
from harness.parts.settings import KindSettings
from harness.recordings.motion import MotionColumns
from harness.scenario.events import Change, Fault
from harness.scenario.sweep import Sweep

__all__ = [
    "NIS_OUTPUT",
    "SHORTEST_EVALUATION",
    "Hil",
    "Limit",
    "PartTable",
    "Scenario",
    "SignalRoles",
    "Wire",
]

SHORTEST_EVALUATION = 1.0
"""Seconds that have to be left after `warm_up`; less is no basis for a figure of merit."""
NIS_OUTPUT = "innovation_squared"
"""Output with which an estimator tells how large its corrections are; see `results.consistency`."""

Ports = str | list[str]


@dataclass(frozen=True)
class Wire:
    """Connection from an output to an input, or from several to as many by one `*`.

    Attributes:
        source: `part.port` that gives the value.
        target: `part.port` that takes it.
        delay: samples of the scenario's step by which the value arrives later.
    """

    source: str
    target: str
    delay: int = 0


class WireTable(StrictModel):
    source: str = Field(alias="from")
    target: str = Field(alias="to")
    delay: int = Field(default=0, ge=0)


class SignalRoles(StrictModel):
    """Roles that recorded ports play for the metrics and the report; every one may be missing.

    Attributes:
        tip_uncompensated: tip if nothing compensated it (3), m in W.
        tip: tip with compensation (3), m in W.
        intent: what the hand wants to do (3), m in W.
        actuator_voltage: of the actuators (n), V.
        actuator_stroke: displacement of the actuators (n), m.
        attitude_true: quaternion q_WB of the plant (4), scalar first.
        attitude_estimated: the same as estimated (4).
        position_true: position that an estimator is after (3), m in W.
        position_estimated: the same as estimated (3).
        saturated: true while a command is at its limit (1).
    """

    tip_uncompensated: Ports | None = None
    tip: Ports | None = None
    intent: Ports | None = None
    actuator_voltage: Ports | None = None
    actuator_stroke: Ports | None = None
    attitude_true: Ports | None = None
    attitude_estimated: Ports | None = None
    position_true: Ports | None = None
    position_estimated: Ports | None = None
    saturated: Ports | None = None


def _at_most(value: Any) -> Any:
    """Take a number alone for the largest value."""
    return {"max": value} if not isinstance(value, dict) else value


class Limit(StrictModel):
    """Of a figure of merit, both ends included.

    Attributes:
        min: least value.
        max: largest value.
    """

    min: float | None = Field(default=None, allow_inf_nan=False)
    max: float | None = Field(default=None, allow_inf_nan=False)


class Hil(Timing):
    """The loop on the wall clock, and boards on a bus; see `harness.hil`.

    Attributes (and those of `Timing`):
        watchdog: how long the step of any part may take before the run is ended [s].
        board: whether the board is emulated: `python`, `c`, or `none` for a real one.
        log: format of the log of raw frames, `candump`, `blf` or `none`.
        priority: of the loop's thread, 1 to 99; 0 for an ordinary one.
        limits: of figures of merit and of counts of faults, by their names, which `--junit` judges;
            a number is the largest value. See `harness.results.limits`.
    """

    watchdog: Positive = 0.5
    board: Literal["none", "python", "c"] = "none"
    log: Literal["candump", "blf", "none"] = "candump"
    priority: int = Field(default=50, ge=0, le=99)
    limits: dict[str, Annotated[Limit, BeforeValidator(_at_most)]] = Field(default_factory=dict)


class PartSettings(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    step_limit: Positive = 10.0
    motion: str | None = None
    accept: list[str] = Field(default_factory=list)
    repair: list[str] = Field(default_factory=list)
    columns: MotionColumns = MotionColumns()
    innovation_size: int | None = Field(default=None, ge=1)
    stands_for: dict[str, Any] = Field(default_factory=dict)


class ScenarioTable(StrictModel):
    title: str = ""
    seconds: Positive
    step_size: Positive
    warm_up: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    seed: int = Field(default=1, ge=0)
    part: dict[str, PartSettings]
    wire: list[WireTable] = Field(default_factory=list)
    signals: SignalRoles = SignalRoles()
    change: list[Change] = Field(default_factory=list)
    fault: list[Fault] = Field(default_factory=list)
    hil: Hil = Hil()
    sweep: Sweep | None = None
    variant: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True)
class PartTable:
    """One part as the scenario describes it.

    Attributes:
        kind: key of `harness.parts.kinds.kinds()`.
        settings: the kind's own settings.
        step_limit: wall-clock time that one call may take [s].
        motion: recording to stream into it.
        accept: names of findings about the recording to go on with.
        repair: names of findings about the recording to repair.
        columns: columns, units and rate of the recording, as far as it does not say.
        innovation_size: degrees of freedom of its corrections, if it does not say itself.
        stands_for: what it was before a scenario made another kind of it; None if it always was.
    """

    kind: str
    settings: KindSettings
    step_limit: float = 10.0
    motion: Path | None = None
    accept: tuple[str, ...] = ()
    repair: tuple[str, ...] = ()
    columns: MotionColumns = field(default_factory=MotionColumns)
    innovation_size: int | None = None
    stands_for: PartTable | None = None


@dataclass(frozen=True)
class Scenario:
    """A checked scenario; see the module's table for the fields.

    Attributes:
        name: file name without its ending.
        given: how it was asked for: a path, or the name of a shipped one.
        table: what was checked, everything laid over each other.
        texts: (name, text) of the files that it was read from, the most basic one first.
        overrides: what replaced values of the files.
        variant: which of the file's variants this is; None if it is none of them.
        variants: all of them.
        notes: what the user should know of its files, as old names of keys.
    """

    name: str
    given: str
    title: str
    seconds: float
    step_size: float
    warm_up: float
    seed: int
    parts: Mapping[str, PartTable]
    wires: tuple[Wire, ...]
    signals: SignalRoles
    hil: Hil
    changes: tuple[Change, ...]
    faults: tuple[Fault, ...]
    sweep: Sweep | None
    table: Mapping[str, Any]
    texts: tuple[tuple[str, str], ...]
    overrides: Mapping[str, Any] = field(default_factory=dict)
    variant: str | None = None
    variants: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def part_setting(self, key: str) -> Endpoint | None:
        """Return part and setting of a key as `part.hand.seed`; None if it is no such key."""
        head, _, rest = key.partition(".")
        return Endpoint.find(rest, self.parts) if head == "part" else None
