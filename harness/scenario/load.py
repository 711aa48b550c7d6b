"""Read, merge and check scenario files."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError, nearest
from harness.common.files import is_path
from harness.parts.kinds import kinds
from harness.parts.settings import settings_of
from harness.scenario.merge import merge_tables, nest_keys
from harness.scenario.old_names import with_new_names
from harness.scenario.problems import kind_problems, table_problems
from harness.scenario.schema import PartSettings, PartTable, Scenario, ScenarioTable, Wire

__all__ = ["available", "load", "with_values"]


_SHIPPED = files("harness.scenario") / "library"


def available() -> list[str]:
    """Return the names of the scenarios that come with the package."""
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
    notes: list[str] = []
    table, texts = _read(path, (), notes)
    variants = table.pop("variant", {})
    if variant is not None:
        if variant not in variants:
            hint = nearest(variant, variants) if variants else "it has none."
            raise SteadytipError(f"{path.name} has no variant '{variant}'; {hint}")
        table = merge_tables(table, variants[variant])
    given = os.fspath(scenario)
    return _checked(table, dict(overrides or {}), path, given, texts, variant, variants, notes)


def with_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Replace some values of a scenario, as `load` replaces them.

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
        list(scenario.notes),
    )


def _checked(
    table: dict[str, Any],
    overrides: dict[str, Any],
    path: Path,
    given: str,
    texts: tuple[tuple[str, str], ...],
    variant: str | None,
    variants: Mapping[str, Any],
    notes: list[str],
) -> Scenario:
    problems: list[str] = []
    if overrides:
        above = _resolved(nest_keys(overrides, problems), Path(), "overrides", notes)
        table = merge_tables(table, above)
    parts = table.get("part")
    if isinstance(parts, dict):
        problems += [text for name, part in parts.items() for text in kind_problems(name, part)]
    made: dict[str, PartTable] = {}
    try:
        checked = ScenarioTable.model_validate(table)
    except ValidationError as error:
        problems += table_problems(error)
    else:
        if not problems:
            made = _parts(checked.part, problems)
        problems += [
            f"fault on '{fault.wire}': {fault.trouble}" for fault in checked.fault if fault.trouble
        ]
        problems += checked.sweep.problems() if checked.sweep else []
        problems += _time_problems(checked)
    if problems:
        raise ProblemsError(path.name, problems)
    return Scenario(
        name=path.stem,
        given=given,
        table=table,
        title=checked.title or path.stem,
        seconds=checked.seconds,
        step_size=checked.step_size,
        warm_up=checked.warm_up,
        seed=checked.seed,
        parts=made,
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
        notes=tuple(notes),
    )


def _time_problems(table: ScenarioTable) -> Iterator[str]:
    """Yield what never happens because the run is too short for it."""
    if table.seconds < table.step_size:
        yield f"'seconds' = {table.seconds:g} holds no step of {table.step_size:g} s"
        return
    begins = [("change", change.at) for change in table.change]
    begins += [(f"fault on '{fault.wire}'", fault.at) for fault in table.fault]
    for what, at in begins:
        if at >= table.seconds:
            yield (
                f"{what} at {at:g} s never happens: the run ends at {table.seconds:g} s; make it "
                "longer, or take that out"
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


def _read(
    path: Path, seen: tuple[Path, ...], notes: list[str]
) -> tuple[dict[str, Any], tuple[tuple[str, str], ...]]:
    """Return the table of a scenario with all that it extends, and the texts of all files."""
    if path.resolve() in seen:
        chain = " -> ".join(item.name for item in (*seen, path))
        raise SteadytipError(f"{path.name}: 'extends' goes round in a circle: {chain}")
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors put a byte order mark first
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SteadytipError(f"{path} is not TOML: {error}{_backslash_hint(text)}") from None
    except UnicodeDecodeError as error:
        raise SteadytipError(f"{path} is not TOML: {error}; save it as UTF-8") from None
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
        found, read = _read(_locate(base, path.parent), (*seen, path.resolve()), notes)
        below = merge_tables(below, found)
        texts |= dict.fromkeys(read)
    texts[path.name, text] = None
    return merge_tables(below, _resolved(table, path.parent, path.name, notes)), tuple(texts)


def _resolved(table: dict[str, Any], folder: Path, where: str, notes: list[str]) -> dict[str, Any]:
    """Return the table under new names, its parts' paths independent of where it stands."""
    table = with_new_names(table, where, notes)
    parts = table.get("part", {})
    if not isinstance(parts, dict) or not all(isinstance(part, dict) for part in parts.values()):
        raise SteadytipError(f"{where}: 'part' holds tables, as in [part.hand]")

    variants = table.get("variant", {})
    if not isinstance(variants, dict) or not all(isinstance(v, dict) for v in variants.values()):
        raise SteadytipError(f"{where}: 'variant' holds tables, as in [variant.NAME.part.hand]")

    def resolved(key: str, value: Any) -> Any:
        if not isinstance(value, str) or not _is_path(key, value):
            return value
        return str(folder / portable_path(value, f"{where}: '{key}'"))

    changed: dict[str, Any] = {
        "part": {
            name: {key: resolved(key, value) for key, value in part.items()}
            for name, part in parts.items()
        },
        "variant": {
            name: _resolved(variant, folder, f"{where}, variant {name}", notes)
            for name, variant in variants.items()
        },
        "sweep": _with_paths(table.get("sweep"), folder),
    }
    return table | {key: value for key, value in changed.items() if key in table}


_BACKSLASH = re.compile(r'"[^"\n]*\\[^"\n]*"')


def _backslash_hint(text: str) -> str:
    """Return a hint about the first backslash in double quotes; empty if there is none."""
    for number, line in enumerate(text.splitlines(), start=1):
        found = _BACKSLASH.search(line.partition("#")[0])
        if found:
            plain = found[0].strip('"')
            return (
                f". In line {number} a backslash in double quotes begins an escape: write the path "
                f"in single quotes, '{plain}', or with forward slashes, "
                f'"{plain.replace(chr(92), "/")}"'
            )
    return ""


def portable_path(text: str, where: str) -> str:
    """Return a path in the way of this system; backslashes of Windows are taken for slashes.

    Raises:
        SteadytipError: it holds a control character, as escapes in double quotes make them.
    """
    if any(ord(c) < 32 for c in text):
        raise SteadytipError(
            f"{where} = {text!r} holds a control character: a backslash in double quotes begins an "
            "escape; write the path in single quotes, or with forward slashes"
        )
    return text.replace("\\", "/") if os.sep == "/" else text


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


def _parts(parts: Mapping[str, PartSettings], problems: list[str]) -> dict[str, PartTable]:
    made: dict[str, PartTable] = {}
    for name, part in parts.items():
        try:
            made[name] = _part(name, part)
        except ProblemsError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    return made


def _part(name: str, part: PartSettings) -> PartTable:
    settings = dict(part.model_extra or {})
    (kind,) = (key for key in kinds() if key in settings)
    before = part.stands_for
    return PartTable(
        kind=kind,
        settings=settings_of(kind, name, settings),
        step_limit=part.step_limit,
        motion=Path(part.motion) if part.motion is not None else None,
        accept=tuple(part.accept),
        repair=tuple(part.repair),
        columns=part.columns,
        innovation_size=part.innovation_size,
        stands_for=_part(name, PartSettings.model_validate(before)) if before else None,
    )
