"""Scenario files: which parts, how they are wired, for how long.

A scenario is TOML. Keys of the file:

| key | unit | meaning |
| --- | --- | --- |
| title | | one line for people |
| extends | | scenario that this one changes, or a list of them, one laid over the other |
| seconds | s | simulated time |
| step | s | period of the loop |
| settle | s | left out of the metrics at the start |
| seed | | all randomness of the run follows from it |
| part.NAME | | one member of the loop: one key of `harness.parts.kinds()`, and its settings |
| variant.NAME | | what one variant changes, as `extends` does; `steadytip run` compares them |
| wire | | list of `from`, `to` (`part.port`; a `*` is the same text on both sides), `delay` |
| signals | | what the metrics and the report read: role = port, pattern (`*`, `?`) or list |
| change, fault | | lists of what happens in the middle of a run: `harness.events` |
| hil | | the loop on the wall clock: `Hil` |
| sweep | | what `steadytip sweep` varies: `harness.sweep.table` |

Laid over another table, parts and variants merge per key; a wire takes the place of one with the
same `to`, or is appended.

Settings that every kind of part has: `step_limit` (wall-clock time that one call may take [s]),
`motion` (a recording that is streamed into the part's inputs `recorded_*`) and `innovation_size`
(degrees of freedom of each correction of an estimator that has no output of that name). Where a
scenario makes another kind of a part, `stands_for` keeps the table that the part had before.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from harness.errors import ProblemsError, SteadytipError, nearest
from harness.events import Change, Fault
from harness.parts import is_path, kinds
from harness.sweep.table import FaultRange, Sweep
from harness.tables import Positive as _Positive
from harness.tables import Strict as _Strict

__all__ = [
    "SHORTEST",
    "SQUARED",
    "Hil",
    "Limit",
    "PartTable",
    "Scenario",
    "Signals",
    "Wire",
    "available",
    "load",
    "merged",
    "nested",
    "varied",
]

SHORTEST = 1.0
"""Seconds that have to be left after `settle`; less is no basis for a figure of merit."""
SQUARED = "innovation_squared"
"""Output with which an estimator tells how large its corrections are; see `harness.consistency`."""

_Ports = str | list[str]
_SHIPPED = files("harness") / "scenarios"


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


class _Wire(_Strict):
    source: str = Field(alias="from")
    target: str = Field(alias="to")
    delay: int = Field(default=0, ge=0)


class Signals(_Strict):
    """Roles that recorded ports play for the metrics and the report; every one may be missing.

    Attributes:
        moved: tip if nothing compensated it (3), m in W.
        tip: tip with compensation (3), m in W.
        intent: what the hand wants to do (3), m in W.
        drive: voltages of the actuators (n), V.
        stroke: what the actuators make of them (n), m.
        attitude_true: quaternion q_WB of the plant (4), scalar first.
        attitude_estimated: the same as estimated (4).
        position_true: position that an estimator is after (3), m in W.
        position_estimated: the same as estimated (3).
        saturated: true while a command is at its limit (1).
    """

    moved: _Ports | None = None
    tip: _Ports | None = None
    intent: _Ports | None = None
    drive: _Ports | None = None
    stroke: _Ports | None = None
    attitude_true: _Ports | None = None
    attitude_estimated: _Ports | None = None
    position_true: _Ports | None = None
    position_estimated: _Ports | None = None
    saturated: _Ports | None = None


def _at_most(value: Any) -> Any:
    """A number alone is the largest value."""
    return {"max": value} if not isinstance(value, dict) else value


class Limit(_Strict):
    """Of a figure of merit, both ends included.

    Attributes:
        min: least value.
        max: largest value.
    """

    min: float | None = Field(default=None, allow_inf_nan=False)
    max: float | None = Field(default=None, allow_inf_nan=False)


class Hil(_Strict):
    """The loop on the wall clock, and boards on a bus; see `harness.hil`.

    Attributes:
        overrun: what happens when the loop is late: `catch-up` (every sample has its tick, at
            once), `skip` (the newest sample only, in a longer tick) or `stop`.
        slack: how long after its time a sample is waited for [s].
        patience: how long the board's first sample is waited for [s].
        watchdog: how long the step of any part may take before the run is ended [s].
        board: whether the board is emulated: `python`, `c`, or `none` for a real one.
        log: format of the log of raw frames, `candump`, `blf` or `none`.
        priority: of the loop's thread, 1 to 99; 0 for an ordinary one.
        limits: of figures of merit and of counts of faults, by their names, which `--junit` judges;
            a number is the largest value. See `harness.hil.verdict`.
    """

    overrun: Literal["catch-up", "skip", "stop"] = "catch-up"
    slack: _Positive = 3e-3
    patience: _Positive = 5.0
    watchdog: _Positive = 0.5
    board: Literal["none", "python", "c"] = "none"
    log: Literal["candump", "blf", "none"] = "candump"
    priority: int = Field(default=50, ge=0, le=99)
    limits: dict[str, Annotated[Limit, BeforeValidator(_at_most)]] = Field(default_factory=dict)


class _Common(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    step_limit: _Positive = 10.0
    motion: str | None = None
    innovation_size: int | None = Field(default=None, ge=1)
    stands_for: dict[str, Any] = Field(default_factory=dict)


class _File(_Strict):
    title: str = ""
    seconds: _Positive
    step: _Positive
    settle: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    seed: int = Field(default=1, ge=0)
    part: dict[str, _Common]
    wire: list[_Wire] = Field(default_factory=list)
    signals: Signals = Signals()
    change: list[Change] = Field(default_factory=list)
    fault: list[Fault] = Field(default_factory=list)
    hil: Hil = Hil()
    sweep: Sweep | None = None
    variant: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True)
class PartTable:
    """One part as the scenario describes it.

    Attributes:
        kind: key of `harness.parts.kinds()`.
        settings: the kind's own settings, `kind` among them.
        step_limit: wall-clock time that one call may take [s].
        motion: recording to stream into it.
        innovation_size: degrees of freedom of its corrections, if it does not say itself.
        stands_for: what it was before a scenario made another kind of it; None if it always was.
    """

    kind: str
    settings: Mapping[str, Any]
    step_limit: float
    motion: Path | None
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
    """

    name: str
    given: str
    title: str
    seconds: float
    step: float
    settle: float
    seed: int
    parts: Mapping[str, PartTable]
    wires: tuple[Wire, ...]
    signals: Signals
    hil: Hil
    changes: tuple[Change, ...]
    faults: tuple[Fault, ...]
    sweep: Sweep | None
    table: Mapping[str, Any]
    texts: tuple[tuple[str, str], ...]
    overrides: Mapping[str, Any] = field(default_factory=dict)
    variant: str | None = None
    variants: tuple[str, ...] = ()


def available() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(Path(str(item)).stem for item in _SHIPPED.iterdir() if item.name[-5:] == ".toml")


def load(
    scenario: str | os.PathLike[str],
    overrides: Mapping[str, Any] | None = None,
    variant: str | None = None,
) -> Scenario:
    """Read, merge and check a scenario.

    Args:
        scenario: path of a TOML file, or the name of a shipped one.
        overrides: values by dotted key, `part.hand.seed`, put in place of the file's.
        variant: which of its variants; the scenario without any if left out.

    Raises:
        ProblemsError: everything that is wrong with the scenario.
        SteadytipError: a file is missing or not TOML, or extends itself; no such variant.
    """
    path = _locate(scenario, Path())
    table, texts = _read(path, ())
    variants = table.pop("variant", {})
    if variant is not None:
        if variant not in variants:
            hint = nearest(variant, variants) if variants else "it has none."
            raise SteadytipError(f"{path.name} has no variant '{variant}'; {hint}")
        table = merged(table, variants[variant])
    return _checked(
        table, dict(overrides or {}), path, os.fspath(scenario), texts, variant, variants
    )


def varied(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """A scenario with some of its values replaced, as `load` replaces them.

    Args:
        scenario: to be changed.
        values: by dotted key.

    Raises:
        ProblemsError: everything that is wrong with them.
    """
    return _checked(
        dict(scenario.table),
        dict(values),
        Path(scenario.name),
        scenario.given,
        scenario.texts,
        scenario.variant,
        dict.fromkeys(scenario.variants),
    )


def nested(overrides: Mapping[str, Any], problems: list[str]) -> dict[str, Any]:
    """Values by dotted key as tables in tables.

    Args:
        overrides: values by dotted key.
        problems: keys that contradict each other are told here.
    """
    tables: dict[str, Any] = {}
    for dotted, value in overrides.items():
        *path, last = dotted.split(".")
        table = tables
        for key in path:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                problems.append(f"override '{dotted}' = {value!r} contradicts another override")
                table = {}
        table[last] = value
    return tables


def _checked(
    table: dict[str, Any],
    overrides: dict[str, Any],
    path: Path,
    given: str,
    texts: tuple[tuple[str, str], ...],
    variant: str | None,
    variants: Mapping[str, Any],
) -> Scenario:
    problems: list[str] = []
    if overrides:
        table = merged(table, _resolved(nested(overrides, problems), Path(), "overrides"))
    parts = table.get("part")
    if isinstance(parts, dict):
        problems += [text for name, part in parts.items() for text in _kind_problems(name, part)]
    try:
        checked = _File.model_validate(table)
    except ValidationError as error:
        problems += [_sentence(entry) for entry in error.errors()]
    else:
        problems += [
            f"fault on '{fault.wire}': {fault.trouble}" for fault in checked.fault if fault.trouble
        ]
        problems += checked.sweep.problems() if checked.sweep else []
    if problems:
        raise ProblemsError(path.name, problems)
    return Scenario(
        name=path.stem,
        given=given,
        table=table,
        title=checked.title or path.stem,
        seconds=checked.seconds,
        step=checked.step,
        settle=checked.settle,
        seed=checked.seed,
        parts={name: _part(part) for name, part in checked.part.items()},
        wires=tuple(Wire(w.source, w.target, w.delay) for w in checked.wire),
        signals=checked.signals,
        hil=checked.hil,
        changes=tuple(checked.change),
        faults=tuple(checked.fault),
        sweep=checked.sweep,
        texts=texts,
        overrides=overrides,
        variant=variant,
        variants=tuple(variants),
    )


def _locate(scenario: str | os.PathLike[str], folder: Path) -> Path:
    path = Path(scenario)
    if len(path.parts) == 1 and not path.suffix:
        shipped = Path(str(_SHIPPED / f"{path.name}.toml"))
        if not shipped.is_file():
            raise SteadytipError(
                f"no scenario is called '{path.name}'; {nearest(path.name, available())}\n"
                "A scenario of your own is given by its path, ending in .toml."
            )
        return shipped
    path = folder / path
    if not path.is_file():
        raise SteadytipError(f"scenario file {path} does not exist")
    return path


def _read(path: Path, seen: tuple[Path, ...]) -> tuple[dict[str, Any], tuple[tuple[str, str], ...]]:
    """Table of a scenario with everything that it extends, and the texts of all files."""
    if path.resolve() in seen:
        chain = " -> ".join(item.name for item in (*seen, path))
        raise SteadytipError(f"{path.name}: 'extends' goes round in a circle: {chain}")
    try:
        text = path.read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SteadytipError(f"{path} is not TOML: {error}") from None
    except OSError as error:
        raise SteadytipError(f"{path} cannot be read: {error.strerror}") from None
    bases = table.pop("extends", [])
    if isinstance(bases, str):
        bases = [bases]
    if not isinstance(bases, list) or not all(isinstance(base, str) for base in bases):
        raise SteadytipError(f"{path.name}: 'extends' names scenarios, not {bases!r}")
    below: dict[str, Any] = {}
    texts: dict[tuple[str, str], None] = {}  # in order, each once
    for base in bases:
        found, read = _read(_locate(base, path.parent), (*seen, path.resolve()))
        below = merged(below, found)
        texts |= dict.fromkeys(read)
    texts[path.name, text] = None
    return merged(below, _resolved(table, path.parent, path.name)), tuple(texts)


def _resolved(table: dict[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """The table with the paths in its parts made independent of where it stands."""
    parts = table.get("part", {})
    if not isinstance(parts, dict) or not all(isinstance(part, dict) for part in parts.values()):
        raise SteadytipError(f"{where}: 'part' holds tables, as in [part.hand]")

    variants = table.get("variant", {})
    if not isinstance(variants, dict) or not all(isinstance(v, dict) for v in variants.values()):
        raise SteadytipError(f"{where}: 'variant' holds tables, as in [variant.NAME.part.hand]")

    def resolved(key: str, value: Any) -> Any:
        return str(folder / value) if isinstance(value, str) and _is_path(key, value) else value

    changed: dict[str, Any] = {
        "part": {
            name: {key: resolved(key, value) for key, value in part.items()}
            for name, part in parts.items()
        },
        "variant": {
            name: _resolved(variant, folder, f"{where}, variant {name}")
            for name, variant in variants.items()
        },
        "sweep": _with_paths(table.get("sweep"), folder),
    }
    return table | {key: value for key, value in changed.items() if key in table}


def _with_paths(sweep: Any, folder: Path) -> Any:
    motions = sweep.get("motions") if isinstance(sweep, dict) else None
    if not isinstance(motions, list):
        return sweep
    return sweep | {"motions": [str(folder / m) if isinstance(m, str) else m for m in motions]}


def _is_path(key: str, value: str) -> bool:
    # A bare word after a kind's key is a name, as in `fmu = "Hand"`: no path.
    if key in kinds():
        return is_path(value)
    return key in {"motion", "parameters"}


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`above` laid over `below`: tables merge, wires by their end, the rest is replaced."""
    laid = dict(below)
    for key, value in above.items():
        old = laid.get(key)
        if key == "wire" and isinstance(old, list) and isinstance(value, list):
            laid[key] = [wire for wire in old if not _ends_as(wire, value)] + value
        elif key == "vary" and isinstance(old, dict) and isinstance(value, dict):
            laid[key] = old | value  # what is said of a variable is not mixed
        elif key == "part" and isinstance(old, dict):
            laid[key] = old | {n: _merge_part(old.get(n, {}), p) for n, p in value.items()}
        elif isinstance(old, dict) and isinstance(value, dict):
            laid[key] = merged(old, value)
        else:
            laid[key] = value
    return laid


def _ends_as(wire: Any, others: list[Any]) -> bool:
    ends = [other.get("to") for other in others if isinstance(other, dict)]
    return isinstance(wire, dict) and wire.get("to") in ends


def _merge_part(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    # Another kind of part has other settings: nothing of the old one fits.
    known = kinds().keys()
    changes_kind = any(key in known and key not in below for key in above)
    if not changes_kind or not below:
        return merged(below, above)
    return {"stands_for": {k: v for k, v in below.items() if k != "stands_for"}, **above}


def _kind_problems(name: str, part: Mapping[str, Any]) -> Iterable[str]:
    found = [key for key in kinds() if key in part]
    if "." in name or not name:
        yield f"part '{name}': a name has at least one letter and no dot"
    before = part.get("stands_for")
    if isinstance(before, dict) and len([key for key in kinds() if key in before]) != 1:
        yield f"part '{name}': 'stands_for' does not say what it was: one of {', '.join(kinds())}"
    if not found:
        yield (
            f"part '{name}' does not say what it is: add one of {', '.join(kinds())}"
            f"{_hint(part, kinds())}"
        )
    elif len(found) > 1:
        yield f"part '{name}' is several things at once ({', '.join(found)}): keep one"


def _hint(part: Mapping[str, Any], known: Iterable[str]) -> str:
    hints = {key: nearest(key, known) for key in part}
    close = [f"'{key}': {hint}" for key, hint in hints.items() if hint.startswith("did")]
    return f" ({'; '.join(close)})" if close else ""


_MODELS: dict[str, type[BaseModel]] = {
    "": _File,
    "wire": _Wire,
    "signals": Signals,
    "hil": Hil,
    "hil.limits": Limit,
    "change": Change,
    "fault": Fault,
    "sweep": Sweep,
    "sweep.fault": FaultRange,
}


def _sentence(entry: Any) -> str:
    """One of pydantic's errors in our words."""
    place = [item for item in entry["loc"] if item not in {"str", "list[str]"}]
    key = ".".join(f"{item}" for item in place)
    if entry["type"] == "extra_forbidden":
        within = ["" if len(place) == 1 else ".".join(map(str, place[:n])) for n in (2, 1)]
        model = next(_MODELS[key] for key in within if key in _MODELS)
        known = [entry.alias or name for name, entry in model.model_fields.items()]
        if model is _File:
            known.append("extends")
        return f"unknown key '{key}'; {nearest(str(place[-1]), known)}"
    if entry["type"] == "missing":
        return f"'{key}' is missing"
    return f"'{key}' = {entry['input']!r}: {entry['msg'][:1].lower()}{entry['msg'][1:]}"


def _part(part: _Common) -> PartTable:
    settings = dict(part.model_extra or {})
    (kind,) = (key for key in kinds() if key in settings)
    before = part.stands_for
    return PartTable(
        kind=kind,
        settings=settings,
        step_limit=part.step_limit,
        motion=Path(part.motion) if part.motion is not None else None,
        innovation_size=part.innovation_size,
        stands_for=_part(_Common.model_validate(before)) if before else None,
    )
