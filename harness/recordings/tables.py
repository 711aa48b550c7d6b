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
from typing import TYPE_CHECKING

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest
from harness.common.files import reason, replacing
from harness.common.types import FloatArray
from harness.recordings.text_table import TextTable, as_csv, cut, read_text_table
from harness.recordings.units import KNOWN_UNITS, TIMES, factor_to_si, plain_unit

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = [
    "TIME",
    "ColumnMapping",
    "DataTable",
    "FoundColumn",
    "Role",
    "find_columns",
    "find_time",
    "read_table",
    "write_table",
]

_HEADING = re.compile(r"^\s*(?P<name>.*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?\s*$")
_SUFFIX = re.compile(r"^(?P<name>.+?)[_ ]+(?:in[_ ]+)?(?P<unit>[a-zA-Zµμ]+)$")


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
        origins: what was taken off the values of a column, in its unit, by index of the column.
    """

    path: Path
    headings: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: FloatArray
    row: str = "line"
    above: int = 0
    broken: Mapping[int, str] = field(default_factory=dict)
    origins: Mapping[int, float] = field(default_factory=dict)

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
        unit, factor = _unit(table, role, index, mapping.units.get(role.quantity or role.name))
        text = f"{table.describe(index)} in {unit}"
        signals[role.name] = FoundColumn(table.numbers(index) * factor, text, index)
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
        if (found := _parquet_numbers(column.combine_chunks())) is not None:
            fields.append(field_)
            columns.append(found)
    if not columns:
        raise SteadytipError(f"recording {path} has no numeric column")
    names, own = _split([field_.name for field_ in fields])
    below = [
        column.unit or (field_.metadata or {}).get(b"unit", b"").decode()
        for field_, column in zip(fields, columns, strict=True)
    ]
    units = tuple(unit or other for unit, other in zip(own, below, strict=True))
    lines = np.arange(1.0, len(table) + 1)
    values = np.column_stack([column.values for column in columns])
    origins = {i: column.origin for i, column in enumerate(columns) if column.origin}
    return DataTable(path, names, units, values, lines, "row", origins=origins)


def _parquet_numbers(column: pa.Array) -> _Numbers | None:
    """Return the numbers of a column, dates as seconds since the first; None if it has none."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_time(kind):
        wide = pa.timestamp("ns") if pa.types.is_timestamp(kind) else pa.duration("ns")
        if pa.types.is_time(kind):
            wide = pa.time64("ns")
        whole = column.cast(wide).cast(pa.int64()).to_numpy(zero_copy_only=False)
        return _Numbers((whole - whole[0]) * 1e-9, unit="s", origin=float(whole[0]) * 1e-9)
    if pa.types.is_integer(kind) and len(column) and column[0].as_py() is not None:
        first = column[0].as_py()
        if abs(first) > 2**53 and not column.null_count:
            whole = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
            return _Numbers((whole - first).astype(float), origin=float(first))
    try:
        numbers = column.cast(pa.float64(), safe=False)
    except pa.ArrowException:
        return None
    return None if pa.types.is_boolean(kind) else _Numbers(numbers.to_numpy(zero_copy_only=False))


def _read_text(path: Path, fewest: int, needed: str) -> DataTable:
    text = read_text_table(path, fewest, needed)
    if text is None:
        return DataTable(path, (), (), np.empty((0, 0)), np.empty(0))
    headings, units = _headings(text.above, text.delimiter, text.width)
    columns = [_numbers(cells) for cells in _cells(path, text)]
    broken = {}
    for index, column in enumerate(columns):
        if column.broken is not None:
            row, cell = column.broken
            named = f" ('{headings[index]}')" if headings[index] else ""
            shown = f"'{cell}' is not a number" if cell else "nothing stands there"
            broken[index] = (
                f"recording {path}, line {text.lines[row]}, column {index + 1}{named}: {shown}; "
                "remove the line or complete it"
            )
    return DataTable(
        path,
        headings,
        tuple(column.unit or unit for column, unit in zip(columns, units, strict=True)),
        np.column_stack([column.values for column in columns]),
        np.array(text.lines, float),
        above=len(text.above),
        broken=broken,
        origins={i: column.origin for i, column in enumerate(columns) if column.origin},
    )


def _cells(path: Path, text: TextTable) -> list[pa.StringArray]:
    """Return the texts of the cells, column by column.

    Raises:
        SteadytipError: a row has more or fewer cells.
    """
    import pyarrow as pa
    from pyarrow import compute, csv

    names = [str(index) for index in range(text.width)]
    try:
        found = csv.read_csv(
            pa.BufferReader(as_csv(text)),
            csv.ReadOptions(column_names=names),
            csv.ParseOptions(delimiter=text.delimiter or "\t"),
            csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
    except pa.ArrowInvalid:
        for number, row in zip(text.lines, text.rows, strict=True):
            count = len(cut(row, text.delimiter, text.width))
            if count != text.width:
                raise SteadytipError(
                    f"recording {path}, line {number}: {count} columns instead of {text.width}; "
                    "remove the line or complete it"
                ) from None
        raise
    cells = [column.combine_chunks() for column in found.columns]
    return [compute.utf8_trim(column, characters=' \t"') for column in cells]


@dataclass(frozen=True)
class _Numbers:
    """Numbers of a column.

    Attributes:
        values: (rows,) NaN in cells without one; from the first one on for dates.
        unit: of dates; empty for numbers.
        origin: what was taken off `values`.
        broken: row and text of the first cell without a number.
    """

    values: FloatArray
    unit: str = ""
    origin: float = 0.0
    broken: tuple[int, str] | None = None


def _numbers(cells: pa.StringArray) -> _Numbers:
    """Read the cells of a column as numbers with a decimal point or comma, or as dates.

    Whether there are decimal commas is judged on the whole column: the first rows may be whole.
    """
    import pyarrow as pa
    from pyarrow import compute

    def matches(pattern: str) -> pa.BooleanArray:
        return compute.match_substring_regex(cells, pattern)

    if compute.all(matches(r"^\d{16,18}$|^[1-8]\d{18}$")).as_py():
        # As float64, a date in nanoseconds has steps of 256 ns.
        whole = compute.cast(cells, pa.int64()).to_numpy(zero_copy_only=False)
        return _Numbers((whole - whole[0]).astype(float), origin=float(whole[0]))
    comma = compute.any(matches(r"^[+-]?\d*,\d+([eE][+-]?\d+)?$")).as_py()
    if comma and not compute.any(matches(r"^[+-]?\d*\.\d+([eE][+-]?\d+)?$")).as_py():
        cells = compute.replace_substring(cells, ",", ".")
    good = matches(r"^[+-]?((\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|(?i:nan|inf|infinity))$")
    if not compute.any(good).as_py() and (dates := _dates(cells)) is not None:
        return dates
    plain = compute.utf8_ltrim(cells, characters="+")
    numbers = compute.cast(compute.if_else(good, plain, None), pa.float64())
    values = numbers.to_numpy(zero_copy_only=False)
    bad = np.flatnonzero(~good.to_numpy(zero_copy_only=False))
    broken = (int(bad[0]), cells[int(bad[0])].as_py()) if len(bad) else None
    return _Numbers(values, broken=broken)


def _dates(cells: pa.StringArray) -> _Numbers | None:
    """Return seconds since the first of some dates or times of day; None if they are neither."""
    import pyarrow as pa
    from pyarrow import compute

    local = compute.replace_substring_regex(cells, r"\s*(Z|[+-]\d\d:?\d\d)$", "")
    local = compute.replace_substring(local, ",", ".")
    for kind in (pa.timestamp("ns"), pa.time64("ns")):
        try:
            whole = compute.cast(compute.cast(local, kind), pa.int64()).to_numpy()
        except pa.ArrowException:
            continue
        return _Numbers((whole - whole[0]) * 1e-9, unit="s", origin=whole[0] * 1e-9)
    return None


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
            fields = cut(line, delimiter, width)
        if len(fields) != width:
            continue
        bare = [plain_unit(field.strip("[]() ")) for field in fields]
        if KNOWN_UNITS.issuperset(filter(None, bare)) and not any(units):
            units = bare  # a line of units below that of the names
            continue
        names, own = _split(fields)
        return names, tuple(unit or below for unit, below in zip(own, units, strict=True))
    return ("",) * width, tuple(units)


def _split(headings: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of headings as `stroke [um]`, `stroke (um)`, `stroke_um`."""
    found = [_HEADING.match(heading) for heading in headings]
    names = [match["name"] if match else text for match, text in zip(found, headings, strict=True)]
    units = [plain_unit(match["unit"] or "") if match else "" for match in found]
    bare = set(names)
    for index, name in enumerate(names):
        suffix = None if units[index] else _SUFFIX.match(name)
        plain = plain_unit(suffix["unit"]) if suffix else ""
        if suffix and plain in KNOWN_UNITS:  # `time_s` has a unit, `pos_z` has none
            units[index] = plain
            if suffix["name"] not in bare:  # `x_m` beside `x [mm]` is another column
                names[index] = suffix["name"]
    return tuple(names), tuple(units)


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
    names = [name.lower() for name in table.headings]
    for heading in role.headings:
        called = [i for i, name in enumerate(names) if name == heading and i not in taken]
        if not called:
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


def _unit(table: DataTable, role: Role, index: int, given: str | None) -> tuple[str, float]:
    """Return the unit of a column and its factor to SI."""
    unit = table.units[index] if given is None else plain_unit(given)
    cure = f"give --{role.quantity or role.name}-unit {'|'.join(role.units)}"
    if not unit and role is TIME:
        unit = _unit_of_dates(table, index)
    if not unit and not role.assumed:
        raise SteadytipError(
            f"recording {table.path}: {table.describe(index)}, read as {role.name}, does not say "
            f"its unit; {cure}, or write it into the heading as in '{role.headings[0]} [um]'"
        )
    unit = unit or role.assumed
    factor = factor_to_si(unit, role.units)
    if factor is None:
        raise SteadytipError(
            f"recording {table.path}: {table.describe(index)}, read as {role.name}, is in '{unit}';"
            f" {cure}"
        )
    return unit, factor


def _unit_of_dates(table: DataTable, index: int) -> str:
    """Return the unit in which a time since 1970 is a date between 2001 and 2096; or nothing."""
    first = abs(table.origins.get(index, 0.0) + float(table.values[0, index]))
    for unit, factor in TIMES.items():
        if 1e9 <= first * factor < 4e9:
            return unit
    return ""
