"""Tables of numbers that somebody recorded: text or Parquet, and which column is what.

A text table is comma, semicolon, tab or blank separated, with or without headings; lines above
them are skipped, a decimal comma is understood where the separator is another one. Columns are
found by their headings (`time [s], volts [V], stroke [um]`) or chosen by name or number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.device.design import STANDARD_GRAVITY
from harness.common.errors import SteadytipError, nearest
from harness.common.types import FloatArray

__all__ = [
    "ANGLES",
    "LENGTHS",
    "QUANTITIES",
    "TEMPERATURES",
    "TIMES",
    "VOLTAGES",
    "Role",
    "Table",
    "find_columns",
    "read_table",
]

LENGTHS: Mapping[str, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
VOLTAGES: Mapping[str, float] = {"V": 1.0, "mV": 1e-3, "kV": 1e3}
TIMES: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": math.pi / 180}
TEMPERATURES: Mapping[str, float] = {"degC": 1.0}
_ACCELERATIONS = {"m/s2": 1.0, "mg": 1e-3 * STANDARD_GRAVITY, "g": STANDARD_GRAVITY}
_RATES = {"rad/s": 1.0, "deg/s": math.pi / 180}
_FIELDS = {"T": 1.0, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4}
QUANTITIES: Mapping[str, Mapping[str, float]] = {
    "m": LENGTHS,
    "V": VOLTAGES,
    "s": TIMES,
    "rad": ANGLES,
    "degC": TEMPERATURES,
    "m/s2": _ACCELERATIONS,
    "rad/s": _RATES,
    "T": _FIELDS,
}
"""Factors to SI by the unit's name, of each SI unit."""

_KNOWN_UNITS = tuple(unit for units in QUANTITIES.values() for unit in units)
_HEADING = re.compile(r"^\s*(?P<name>.*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?\s*$")
_SUFFIX = re.compile(r"^(?P<name>.+?)[_ ]+(?:in[_ ]+)?(?P<unit>[a-zA-Zµμ]+)$")
_PREAMBLE = 200  # lines above the numbers, at most
_COMMENT = "#%"
_SPELLINGS = {
    **{"volt": "V", "volts": "V", "v": "V", "mv": "mV", "kv": "kV"},
    **{"degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad"},
    **{"°c": "degC", "celsius": "degC", "degc": "degC", "dps": "deg/s", "°/s": "deg/s"},
    **{"m/s^2": "m/s2", "m/s²": "m/s2", "ut": "uT", "nt": "nT"},
    **{"sec": "s", "seconds": "s", "micron": "um", "microns": "um", "metre": "m", "meter": "m"},
}


@dataclass(frozen=True)
class Role:
    """What a column can be.

    Attributes:
        name: in messages, and as the option that chooses the column.
        words: headings that it is known by, best first.
        units: factors to SI by the unit's name.
        assumed: unit where nothing says one; empty if that is a mistake.
        column: name or number (from 1) of the column; None to find it.
        unit: one of the units; None for what the heading says.
        optional: whether a table may do without.
        option: that chooses the column, where its name is another; the same of the unit.
        unit_option: see `option`.
    """

    name: str
    words: tuple[str, ...]
    units: Mapping[str, float]
    assumed: str = ""
    column: str | None = None
    unit: str | None = None
    optional: bool = False
    option: str = ""
    unit_option: str = ""

    @property
    def choice(self) -> str:
        """What chooses the column on the command line."""
        return f"--{self.option or self.name}"


@dataclass(frozen=True)
class Table:
    """Numbers as a file has them.

    Attributes:
        path: the file.
        headings: names of the columns; empty where there are none.
        units: as the file says them; empty where it does not.
        values: (rows, columns); NaN in columns of texts.
        lines: number of each row in the file, from 1.
        row: what such a number counts.
    """

    path: Path
    headings: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: FloatArray
    row: str = "line"

    def column(self, index: int) -> str:
        """A column in words."""
        name = self.headings[index]
        return f"column {index + 1}" + (f" '{name}'" if name else "")

    def is_text(self, index: int) -> bool:
        """Whether a column holds no numbers at all."""
        return bool(np.isnan(self.values[:, index]).all())

    @property
    def columns(self) -> str:
        """All columns in words."""
        return ", ".join(self.column(index) for index in range(len(self.headings)))


def read_table(
    path: Path, fewest: int = 2, needed: str = "two are needed, voltage and displacement"
) -> Table:
    """Read a table; nothing is repaired.

    Args:
        path: the file.
        fewest: columns of numbers that it has at least.
        needed: the same in words.

    Raises:
        SteadytipError: no such file, no columns of numbers, ragged rows, or texts between numbers.
    """
    if not path.is_file():
        what = "is a folder; name a file in it" if path.is_dir() else "does not exist"
        raise SteadytipError(f"recording {path} {what}")
    return _read_parquet(path) if path.suffix == ".parquet" else _read_text(path, fewest, needed)


def find_columns(table: Table, roles: Sequence[Role]) -> dict[str, tuple[FloatArray, str]]:
    """Columns by role: those chosen, then those that headings or units tell, then the first ones.

    Args:
        table: as read.
        roles: what is wanted, in the order in which columns without headings are taken.

    Returns:
        For each role that was found its values in SI, (rows,), and the column with its unit in
        words.

    Raises:
        SteadytipError: no such column, several that could be meant, one column for two roles, or a
            unit that is missing or unknown.
    """
    found = {
        role.name: _chosen(table, role, role.column) for role in roles if role.column is not None
    }
    for role in roles:
        index = None if role.name in found else _by_heading(table, role, set(found.values()))
        if index is not None:
            found[role.name] = index
    count = len(table.headings)
    free = [i for i in range(count) if i not in found.values() and not table.is_text(i)]
    for role in roles:
        if role.name in found or role.optional:
            continue
        if any(table.headings) or not free:
            raise SteadytipError(
                f"recording {table.path}: no column is called like {role.name}; choose it with "
                f"{role.choice} (there are: {table.columns})"
            )
        found[role.name] = free.pop(0)
    taken: dict[int, str] = {}
    choices = {role.name: role.choice for role in roles}
    for name, index in found.items():
        if index in taken:
            raise SteadytipError(
                f"recording {table.path}: {table.column(index)} cannot be {taken[index]} and "
                f"{name}; give {choices[taken[index]]} and {choices[name]} (there are: "
                f"{table.columns})"
            )
        taken[index] = name
    signals = {}
    for role in roles:
        if role.name in found:
            index = found[role.name]
            unit = _unit(table, role, index)
            words = f"{table.column(index)} in {unit}"
            signals[role.name] = (table.values[:, index] * role.units[unit], words)
    return signals


def _read_parquet(path: Path) -> Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"recording {path} is not Parquet: {error}") from None
    names, units, columns = [], [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        if pa.types.is_floating(field.type) or pa.types.is_integer(field.type):
            name, unit = _split(field.name)
            names.append(name)
            units.append(unit or (field.metadata or {}).get(b"unit", b"").decode())
            columns.append(column.to_numpy().astype(float))
    if not columns:
        raise SteadytipError(f"recording {path} has no numeric column")
    lines = np.arange(1.0, len(table) + 1)
    return Table(path, tuple(names), tuple(units), np.column_stack(columns), lines, "row")


def _read_text(path: Path, fewest: int, needed: str) -> Table:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SteadytipError(f"recording {path} cannot be read: {error.strerror}") from None
    if b"\0" in content[:4096]:
        raise SteadytipError(
            f"recording {path} is not a text table; save it as CSV, or as Parquet with that ending"
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # every byte has a meaning there, µ among them
    rows = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not rows:
        raise SteadytipError(f"recording {path} is empty")
    begin, delimiter, comma = _begin(path, rows, fewest, needed)
    headings, units = _headings(rows[:begin], delimiter, len(_cut(rows[begin][1], delimiter)))
    body = [(n, line) for n, line in rows[begin:] if line.lstrip()[0] not in _COMMENT]
    values = _numbers(path, body, delimiter, comma, headings)
    return Table(path, headings, units, values, np.array([float(n) for n, _ in body]))


def _begin(
    path: Path, rows: Sequence[tuple[int, str]], fewest: int, needed: str
) -> tuple[int, str | None, bool]:
    """First row of numbers, the separator, and whether there are decimal commas."""
    # A row with one number may be cut short by the wrong separator: two or more come first.
    for least in sorted({2, fewest}, reverse=True):
        for index, (_, line) in enumerate(rows[:_PREAMBLE]):
            if line.lstrip()[0] in _COMMENT:
                continue
            for delimiter in (";", "\t", ",", None):
                fields = _cut(line, delimiter)
                if len(fields) < least:
                    continue
                comma = delimiter != "," and any("," in field for field in fields)
                numbers = [_is_number(f.replace(",", ".") if comma else f) for f in fields]
                # Texts may stand beside the numbers, in a column that nobody asks for.
                if sum(numbers) >= least:
                    return index, delimiter, comma
    raise SteadytipError(
        f"recording {path} has no numeric columns in its first {min(len(rows), _PREAMBLE)} lines "
        f"(line {rows[0][0]}: '{rows[0][1].strip()[:60]}'); {needed}, separated by commas, "
        "semicolons, tabs or blanks"
    )


def _cut(line: str, delimiter: str | None, width: int = 1) -> list[str]:
    """Fields of a line; a separator at its end begins no field where there are `width` without."""
    fields = [field.strip().strip('"') for field in line.split(delimiter)]
    return fields[:-1] if delimiter and len(fields) > width and not fields[-1] else fields


def _headings(
    above: Sequence[tuple[int, str]], delimiter: str | None, width: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns from the lines above the numbers."""
    units = [""] * width
    for _, line in reversed(above):
        line = line.strip().lstrip(_COMMENT).strip()
        if delimiter is None:
            # Blanks stand inside `x [mm]` too: a bracket belongs to the word before it.
            fields = re.findall(r"[^\s\[\](),;]+(?:\s*[\[(][^\])]*[\])])?", line)
        else:
            fields = _cut(line, delimiter)
        if len(fields) != width:
            continue
        split = [_split(field) for field in fields]
        bare = [_plain_unit(field.strip("[]() ")) for field in fields]
        known = set(_KNOWN_UNITS)
        if all(word in known or not word for word in bare) and not any(units):
            units = bare  # a line of units below that of the names
            continue
        names = tuple(name for name, _ in split)
        return names, tuple(unit or below for (_, unit), below in zip(split, units, strict=True))
    return ("",) * width, tuple(units)


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of `stroke [um]`, `stroke (um)`, `stroke_um`."""
    found = _HEADING.match(heading)
    name, unit = (found["name"], found["unit"] or "") if found else (heading, "")
    suffix = _SUFFIX.match(name)
    if not unit and suffix:
        plain = _plain_unit(suffix["unit"])
        if plain in _KNOWN_UNITS:  # `time_s` has a unit, `pos_z` has none
            return suffix["name"], plain
    return name, _plain_unit(unit)


def _plain_unit(unit: str) -> str:
    plain = unit.replace("µ", "u").replace("μ", "u").strip()
    return _SPELLINGS.get(plain.lower(), plain)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(
    path: Path,
    body: Sequence[tuple[int, str]],
    delimiter: str | None,
    comma: bool,
    headings: Sequence[str],
) -> FloatArray:
    """All columns; one that holds texts becomes NaN, and is refused only when it is chosen."""
    width = len(headings)
    lines = [line.replace(",", ".") for _, line in body] if comma else [line for _, line in body]
    try:
        fast = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None)
        if fast.shape[1] == width:
            return fast
    except ValueError:
        pass  # something is no number: find out where, slowly
    values = np.full((len(lines), width), np.nan)
    texts = {
        index for index, field in enumerate(_cut(lines[0], delimiter)) if not _is_number(field)
    }
    for row, ((number, _), line) in enumerate(zip(body, lines, strict=True)):
        fields = _cut(line, delimiter, width)
        if len(fields) != width:
            raise SteadytipError(
                f"recording {path}, line {number}: {len(fields)} columns instead of {width}; "
                "remove the line or complete it"
            )
        for index, field in enumerate(fields):
            if index in texts:
                continue
            if not _is_number(field):
                named = f" ('{headings[index]}')" if headings[index] else ""
                shown = f"'{field}' is not a number" if field else "nothing stands there"
                raise SteadytipError(
                    f"recording {path}, line {number}, column {index + 1}{named}: {shown}; remove "
                    "the line or complete it"
                )
            values[row, index] = float(field)
    return values


def _chosen(table: Table, role: Role, text: str) -> int:
    names = [name.lower() for name in table.headings]
    if text and text.lower() in names:
        index = names.index(text.lower())
    elif text.isdecimal() and 1 <= int(text) <= len(names):
        index = int(text) - 1
    else:
        hint = f"; {nearest(text, filter(None, table.headings))}" if any(names) else ""
        raise SteadytipError(
            f"recording {table.path}: {role.choice} {text} is no column{hint} (there are: "
            f"{table.columns})"
        )
    if table.is_text(index):
        raise SteadytipError(
            f"recording {table.path}: {role.choice} {text} holds no numbers; choose another one "
            f"(there are: {table.columns})"
        )
    return index


def _by_heading(table: Table, role: Role, taken: set[int]) -> int | None:
    parts = [
        {*re.split(r"[^a-z]+", name.lower()), *re.split(r"[^a-z0-9]+", name.lower())}
        for name in table.headings
    ]
    for word in role.words:
        called = [i for i, words in enumerate(parts) if word in words and i not in taken]
        if len(called) > 1:
            raise SteadytipError(
                f"recording {table.path}: {len(called)} columns are called like {role.name}; "
                f"choose one with {role.choice} (there are: "
                f"{', '.join(map(table.column, called))})"
            )
        if called:
            return called[0]
    # A unit says it, too, where it is the only one of its kind.
    fitting = [i for i, unit in enumerate(table.units) if unit in role.units and i not in taken]
    return fitting[0] if len(fitting) == 1 else None


def _unit(table: Table, role: Role, index: int) -> str:
    unit = table.units[index] if role.unit is None else _plain_unit(role.unit)
    cure = f"give --{role.unit_option or role.name + '-unit'} {'|'.join(role.units)}"
    if not unit and not role.assumed:
        raise SteadytipError(
            f"recording {table.path}: {table.column(index)}, read as {role.name}, does not say its "
            f"unit; {cure}, or write it into the heading as in '{role.words[0]} [um]'"
        )
    unit = unit or role.assumed
    if unit not in role.units:
        raise SteadytipError(
            f"recording {table.path}: {table.column(index)}, read as {role.name}, is in '{unit}'; "
            f"{cure}"
        )
    return unit
