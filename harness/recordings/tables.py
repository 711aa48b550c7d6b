"""Tables of numbers that somebody recorded: text or Parquet, and the role of each column.

A text table is separated by commas, semicolons, tabs or blanks, with or without headings. Lines
above the headings are skipped. A decimal comma is understood if the separator is another one.
Columns are found by their headings (`time [s], volts [V], stroke [um]`), or chosen by name or
number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fmu_src.device.design import STANDARD_GRAVITY
from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.files import reason, replacing
from harness.common.types import FloatArray

__all__ = [
    "ANGLES",
    "LENGTHS",
    "QUANTITIES",
    "TEMPERATURES",
    "TIME",
    "TIMES",
    "VOLTAGES",
    "ColumnMapping",
    "DataTable",
    "FoundColumn",
    "Role",
    "find_columns",
    "find_time",
    "read_table",
    "write_table",
]

LENGTHS: Mapping[str, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
VOLTAGES: Mapping[str, float] = {"V": 1.0, "mV": 1e-3, "kV": 1e3}
TIMES: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": math.pi / 180}
TEMPERATURES: Mapping[str, float] = {"degC": 1.0}
_ACCELERATIONS = {"m/s2": 1.0, "mg": 1e-3 * STANDARD_GRAVITY, "g": STANDARD_GRAVITY}
_RATES = {"rad/s": 1.0, "deg/s": math.pi / 180}
_FIELDS = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "G": 1e-4}
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
"""For each SI unit, the known units by name and their factors to it."""

_KNOWN_UNITS = {unit for units in QUANTITIES.values() for unit in units}
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
    """A signal that a column can hold.

    Attributes:
        name: name in messages, and of the option that chooses the column.
        headings: headings that name it, in lower case, the best one first.
        units: factors to SI by the name of the unit.
        assumed: unit of a column that does not say its unit; empty if the unit is mandatory.
        optional: True if a table may lack the column.
        quantity: name of the option that gives the unit, without `-unit`; `name` by default.
        option: option that chooses the column; `name` by default.
    """

    name: str
    headings: tuple[str, ...]
    units: Mapping[str, float]
    assumed: str = ""
    optional: bool = False
    quantity: str = ""
    option: str = ""

    @property
    def choice(self) -> str:
        """Option of the command line that chooses the column."""
        return f"--{self.option or self.name}"


TIME = Role("time", ("time", "t", "timestamp", "seconds"), TIMES, "s", optional=True)
"""Role of the time of each row."""


@dataclass(frozen=True)
class ColumnMapping:
    """Column mapping given by the user, for tables whose headings are not enough.

    Attributes:
        columns: name or number (from 1) of a column by role; None to find it.
        units: unit of a column by quantity; None to take it from the heading.
        rate: samples in a second, for a table without time [Hz].
    """

    columns: Mapping[str, str | None] = field(default_factory=dict)
    units: Mapping[str, str | None] = field(default_factory=dict)
    rate: float | None = None


@dataclass(frozen=True)
class FoundColumn:
    """A column that has a role.

    Attributes:
        values: (rows,) in SI.
        text: the column and its unit, for messages.
        index: index of the column from 0; -1 for a time that no column holds.
    """

    values: FloatArray
    text: str
    index: int


@dataclass(frozen=True)
class DataTable:
    """Numbers of a file, before any conversion of units.

    Attributes:
        path: the file.
        headings: names of the columns; empty strings if there are none.
        units: units of the columns; empty strings if the file does not say them.
        values: (rows, columns); NaN in cells without a number.
        lines: number of each row in the file, from 1.
        row: "line" or "row", for messages.
        above: number of lines above the numbers that are not blank.
        broken: message about the first cell without a number, by index of the column.
    """

    path: Path
    headings: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: FloatArray
    row: str = "line"
    above: int = 0
    broken: Mapping[int, str] = field(default_factory=dict)

    def describe(self, index: int) -> str:
        """Return the number and the name of a column."""
        name = self.headings[index]
        return f"column {index + 1}" + (f" '{name}'" if name else "")

    def place(self, row: int) -> str:
        """Return the name of a row, counted from 0, for messages."""
        return f"{self.row} {int(self.lines[row])}"

    def is_text(self, index: int) -> bool:
        """Return True if a column holds no numbers at all."""
        return bool(np.isnan(self.values[:, index]).all())

    def numbers(self, index: int) -> FloatArray:
        """Return the numbers of a column, (rows,).

        Raises:
            SteadytipError: a cell holds no number.
        """
        if index in self.broken:
            raise SteadytipError(self.broken[index])
        return self.values[:, index]

    @property
    def columns(self) -> str:
        """Descriptions of all columns."""
        return ", ".join(map(self.describe, range(len(self.headings))))


def read_table(
    path: Path,
    fewest: int = 2,
    needed: str = "two are needed, voltage and displacement",
    fewest_rows: int = 2,
) -> DataTable:
    """Read a table; nothing is repaired.

    Args:
        path: text table or Parquet (`.parquet`).
        fewest: least number of columns that hold numbers.
        needed: the same as a clause, for messages.
        fewest_rows: least number of rows, for the message about a table without any.

    Raises:
        SteadytipError: the file does not exist, has no columns of numbers or no rows, or its rows
            have different lengths.
    """
    if not path.is_file():
        what = "is a folder; name a file in it" if path.is_dir() else "does not exist"
        raise SteadytipError(f"recording {path} {what}")
    parquet = path.suffix == ".parquet"
    table = _read_parquet(path) if parquet else _read_text(path, fewest, needed)
    if not len(table.values):
        raise SteadytipError(f"recording {path} has 0 samples; at least {fewest_rows} are needed")
    return table


def find_columns(
    table: DataTable, roles: Sequence[Role], mapping: ColumnMapping | None = None
) -> dict[str, FoundColumn]:
    """Find the column of each role: by the user's choice, by heading or unit, or by position.

    Args:
        table: the table.
        roles: wanted roles, in the order in which columns without headings are assigned.
        mapping: choices of the user. The role `TIME` is skipped if it has a rate.

    Returns:
        Columns by name of the role; optional roles may be absent.

    Raises:
        SteadytipError: a column does not exist, is ambiguous, holds a cell without a number, has
            two roles, or has a missing or unknown unit.
    """
    mapping = mapping or ColumnMapping()
    if mapping.rate is not None:
        if mapping.columns.get("time") is not None:
            raise SteadytipError("--time and --rate exclude each other; keep the one that is right")
        roles = [role for role in roles if role is not TIME]
    found = {
        role.name: _chosen_column(table, role, choice)
        for role in roles
        if (choice := mapping.columns.get(role.name)) is not None
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
    taken: dict[int, Role] = {}
    for role in roles:
        if role.name not in found:
            continue
        other = taken.setdefault(found[role.name], role)
        if other is not role:
            raise SteadytipError(
                f"recording {table.path}: {table.describe(found[role.name])} cannot be {other.name}"
                f" and {role.name}; give {other.choice} and {role.choice} (there are: "
                f"{table.columns})"
            )
    signals = {}
    for index, role in taken.items():
        unit = _unit(table, role, index, mapping.units.get(role.quantity or role.name))
        text = f"{table.describe(index)} in {unit}"
        signals[role.name] = FoundColumn(table.numbers(index) * role.units[unit], text, index)
    return signals


def find_time(
    table: DataTable, found: Mapping[str, FoundColumn], mapping: ColumnMapping
) -> FoundColumn:
    """Return the time of each row, from its column or from the rate.

    Args:
        table: the table.
        found: columns that were found, with the role `TIME` among those wanted.
        mapping: choices of the user.

    Raises:
        SteadytipError: there is neither a column of time nor a rate, or the rate is not positive.
    """
    rate = mapping.rate
    if rate is not None:
        if not (math.isfinite(rate) and rate > 0):
            raise SteadytipError(f"--rate {rate:g}: must be above 0 Hz")
        return FoundColumn(np.arange(len(table.values)) / rate, f"rows at {rate:g} Hz", -1)
    if TIME.name not in found:
        raise SteadytipError(
            f"recording {table.path} has no column that is called time; give --rate HZ, or --time "
            f"NAME (there are: {table.columns})"
        )
    return found[TIME.name]


def write_table(
    path: Path, headings: Sequence[str], table: FloatArray, formats: Sequence[str]
) -> Path:
    """Write a recording as CSV, or as Parquet if the name of the file ends in `.parquet`.

    Args:
        path: file to write.
        headings: one for each column, as in `volts [V]`.
        table: (rows, columns).
        formats: formats of the columns in CSV, as in `%.5f`.

    Raises:
        SteadytipError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            if path.suffix == ".parquet":
                import pyarrow as pa
                from pyarrow import parquet

                columns = {name: table[:, i] for i, name in enumerate(headings)}
                parquet.write_table(pa.table(columns), part)
            else:
                np.savetxt(part, table, list(formats), ",", header=",".join(headings), comments="")
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
    return path


def _read_parquet(path: Path) -> DataTable:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        # Not `parquet.read_table`: it looks for data sets of many files, and loads Pandas.
        with parquet.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"recording {path} is not Parquet: {error}") from None
    fields, columns = [], []
    for field_, column in zip(table.schema, table.columns, strict=True):
        try:
            numbers = column.cast(pa.float64(), safe=False)
        except pa.ArrowException:
            continue
        if not pa.types.is_boolean(field_.type):
            fields.append(field_)
            columns.append(numbers.to_numpy())
    if not columns:
        raise SteadytipError(f"recording {path} has no numeric column")
    names, own = _split([field_.name for field_ in fields])
    below = [(field_.metadata or {}).get(b"unit", b"").decode() for field_ in fields]
    units = tuple(unit or other for unit, other in zip(own, below, strict=True))
    lines = np.arange(1.0, len(table) + 1)
    return DataTable(path, names, units, np.column_stack(columns), lines, "row")


def _read_text(path: Path, fewest: int, needed: str) -> DataTable:
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
    if len(rows) == 1 and not any(map(_is_number, re.split(r"[;,\s]+", rows[0][1]))):
        return DataTable(path, (), (), np.empty((0, 0)), np.empty(0))
    begin, delimiter, comma = _begin(path, rows, fewest, needed)
    above = [line.strip().lstrip(_COMMENT).strip() for _, line in rows[:begin]]
    width = len(_cut(rows[begin][1], delimiter))
    if rows[begin][1].rstrip().endswith(delimiter or "\n"):
        # The last cell of the first row may be empty below a heading.
        width += any(len(_cut(line, delimiter)) == width + 1 for line in above)
    headings, units = _headings(above, delimiter, width)
    body = [(n, line) for n, line in rows[begin:] if line.lstrip()[0] not in _COMMENT]
    values, broken = _numbers(path, body, delimiter, comma, headings)
    lines = np.array([float(n) for n, _ in body])
    return DataTable(path, headings, units, values, lines, above=begin, broken=broken)


def _begin(
    path: Path, rows: Sequence[tuple[int, str]], fewest: int, needed: str
) -> tuple[int, str | None, bool]:
    """Find the first row of numbers, the separator, and whether there are decimal commas."""
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
                # A column that nobody uses may hold texts.
                if sum(numbers) >= least:
                    return index, delimiter, comma
    raise SteadytipError(
        f"recording {path} has no numeric columns in its first {min(len(rows), _PREAMBLE)} lines "
        f"(line {rows[0][0]}: '{rows[0][1].strip()[:60]}'); {needed}, separated by commas, "
        "semicolons, tabs or blanks"
    )


def _cut(line: str, delimiter: str | None, width: int = 1) -> list[str]:
    """Cut a line into fields; drop the empty last one if there are more than `width`."""
    fields = [field.strip().strip('"') for field in line.split(delimiter)]
    return fields[:-1] if delimiter and len(fields) > width and not fields[-1] else fields


def _headings(
    above: Sequence[str], delimiter: str | None, width: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the columns from the lines above the numbers."""
    units = [""] * width
    for line in reversed(above):
        if delimiter is None:
            # `x [mm]` holds a blank, too: a bracket belongs to the word before it.
            fields = re.findall(r"[^\s\[\](),;]+(?:\s*[\[(][^\])]*[\])])?", line)
        else:
            fields = _cut(line, delimiter, width)
        if len(fields) != width:
            continue
        bare = [_plain_unit(field.strip("[]() ")) for field in fields]
        if _KNOWN_UNITS.issuperset(filter(None, bare)) and not any(units):
            units = bare  # a line of units below that of the names
            continue
        names, own = _split(fields)
        return names, tuple(unit or below for unit, below in zip(own, units, strict=True))
    return ("",) * width, tuple(units)


def _split(headings: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of headings as `stroke [um]`, `stroke (um)`, `stroke_um`."""
    found = [_HEADING.match(heading) for heading in headings]
    names = [match["name"] if match else text for match, text in zip(found, headings, strict=True)]
    units = [_plain_unit(match["unit"] or "") if match else "" for match in found]
    bare = set(names)
    for index, name in enumerate(names):
        suffix = None if units[index] else _SUFFIX.match(name)
        plain = _plain_unit(suffix["unit"]) if suffix else ""
        if suffix and plain in _KNOWN_UNITS:  # `time_s` has a unit, `pos_z` has none
            units[index] = plain
            if suffix["name"] not in bare:  # `x_m` beside `x [mm]` is another column
                names[index] = suffix["name"]
    return tuple(names), tuple(units)


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
) -> tuple[FloatArray, dict[int, str]]:
    """Return all values, and a message about the first cell without a number of each column."""
    width = len(headings)
    lines = [line.replace(",", ".") for _, line in body] if comma else [line for _, line in body]
    try:
        fast = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None)
        if fast.shape[1] == width:
            return fast, {}
    except ValueError:
        pass  # something is no number: find out where, slowly
    values, broken = np.full((len(lines), width), np.nan), dict[int, str]()
    for row, ((number, _), line) in enumerate(zip(body, lines, strict=True)):
        fields = _cut(line, delimiter, width)
        if len(fields) != width:
            raise SteadytipError(
                f"recording {path}, line {number}: {len(fields)} columns instead of {width}; "
                "remove the line or complete it"
            )
        for index, cell in enumerate(fields):
            if _is_number(cell):
                values[row, index] = float(cell)
            elif index not in broken:
                named = f" ('{headings[index]}')" if headings[index] else ""
                shown = f"'{cell}' is not a number" if cell else "nothing stands there"
                broken[index] = (
                    f"recording {path}, line {number}, column {index + 1}{named}: {shown}; remove "
                    "the line or complete it"
                )
    return values, broken


def _chosen_column(table: DataTable, role: Role, text: str) -> int:
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


def _by_heading(table: DataTable, role: Role, taken: set[int]) -> int | None:
    parts = [
        {*re.split(r"[^a-z]+", name.lower()), *re.split(r"[^a-z0-9]+", name.lower())}
        for name in table.headings
    ]
    for heading in role.headings:
        called = [i for i, found in enumerate(parts) if heading in found and i not in taken]
        if len(called) > 1:
            raise SteadytipError(
                f"recording {table.path}: {len(called)} columns are called like {role.name}; "
                f"choose one with {role.choice} (there are: "
                f"{', '.join(map(table.describe, called))})"
            )
        if called:
            return called[0]
    # A unit identifies a column, too, if it is the only one of its kind.
    fitting = [i for i, unit in enumerate(table.units) if unit in role.units and i not in taken]
    return fitting[0] if len(fitting) == 1 else None


def _unit(table: DataTable, role: Role, index: int, given: str | None) -> str:
    unit = table.units[index] if given is None else _plain_unit(given)
    cure = f"give --{role.quantity or role.name}-unit {'|'.join(role.units)}"
    if not unit and not role.assumed:
        raise SteadytipError(
            f"recording {table.path}: {table.describe(index)}, read as {role.name}, does not say "
            f"its unit; {cure}, or write it into the heading as in '{role.headings[0]} [um]'"
        )
    unit = unit or role.assumed
    if unit not in role.units:
        raise SteadytipError(
            f"recording {table.path}: {table.describe(index)}, read as {role.name}, is in '{unit}';"
            f" {cure}"
        )
    return unit
