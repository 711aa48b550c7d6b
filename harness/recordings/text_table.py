"""Cut the text of a table into cells, whichever program wrote it.

Read are UTF-8, UTF-16 with or without a byte order mark, and Windows' Western code page; commas,
semicolons, tabs, bars or blanks between cells; cells in quotes; comments, blank lines and a
preamble above the numbers; a row of units below the headings.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fmu_src.errors import SteadytipError
from harness.common.files import reason

__all__ = ["COMMENT", "TextTable", "as_csv", "cut", "decode", "is_number", "read_text_table"]

COMMENT = "#%"
"""Characters that begin a comment."""
_PREAMBLE = 200  # lines above the numbers, at most
_DELIMITERS = (";", "\t", ",", "|", None)  # None: blanks
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark is its beginning
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.I)
_TIME = re.compile(r"(\d{4}-\d\d-\d\d[T ])?\d\d:\d\d(:\d\d([.,]\d+)?)?\s*(Z|[+-]\d\d:?\d\d)?")


@dataclass(frozen=True)
class TextTable:
    """Cells of a text.

    Attributes:
        delimiter: what stands between cells; None for blanks.
        above: lines above the first row of numbers, without signs of comments.
        rows: texts of the rows, cells still together.
        lines: number of each row's line, from 1.
        width: number of columns.
    """

    delimiter: str | None
    above: tuple[str, ...]
    rows: tuple[str, ...]
    lines: tuple[int, ...]
    width: int


def read_text_table(path: Path, fewest: int, needed: str) -> TextTable | None:
    """Read a text and find the rows of numbers in it.

    Args:
        path: the file.
        fewest: least number of columns that hold numbers.
        needed: the same as a clause, for messages.

    Returns:
        The table; None if there are headings and no rows.

    Raises:
        SteadytipError: the file cannot be read, is no text, or has no rows of numbers.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SteadytipError(f"recording {path} cannot be read: {reason(error)}") from None
    text = decode(path, content)
    rows = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not rows:
        raise SteadytipError(f"recording {path} is empty")
    if len(rows) == 1 and not any(map(is_number, re.split(r"[;,\s]+", rows[0][1]))):
        return None
    begin, delimiter = _begin(path, rows, fewest, needed)
    above = tuple(line.strip().lstrip(COMMENT).strip() for _, line in rows[:begin])
    body = [(n, line) for n, line in rows[begin:] if line.lstrip()[0] not in COMMENT]
    first = body[0][1]
    width = len(cut(first, delimiter))
    if delimiter and first.rstrip().endswith(delimiter):
        # The last cell of the first row may be empty below a heading.
        width += any(len(cut(line, delimiter)) == width + 1 for line in above)
    lines, texts = zip(*body, strict=True)
    return TextTable(delimiter, above, texts, lines, width)


def decode(path: Path, content: bytes) -> str:
    """Return the text of a file, by its byte order mark or by what it can be.

    Statistics of letters, as detectors of encodings use them, take a table with one µ for Chinese:
    they are not asked.

    Raises:
        SteadytipError: it is no text.
    """
    encodings = [name for mark, name in _MARKS.items() if content.startswith(mark)][:1]
    if not encodings and b"\0" in content[:4096]:
        # Every second byte of a table in UTF-16 is zero.
        head = content[: len(content[:4096]) // 2 * 2]
        share = [head[k::2].count(0) / max(1, len(head[k::2])) for k in (0, 1)]
        encodings = ["utf-16-le"] * (share[1] > 0.9) + ["utf-16-be"] * (share[0] > 0.9)
    elif not encodings:
        encodings = ["utf-8", "cp1252", "latin-1"]
    for encoding in encodings:
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise SteadytipError(
        f"recording {path} is not a text table; save it as CSV, or as Parquet with that ending"
    )


def cut(line: str, delimiter: str | None, width: int = 1) -> list[str]:
    """Return the cells of a line, without an empty last one if there are more than `width`."""
    if delimiter is None:
        return [cell.strip('"') for cell in line.split()]
    if '"' in line:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        cells = line.split(delimiter)
    cells = [cell.strip() for cell in cells]
    return cells[:-1] if len(cells) > width and not cells[-1] else cells


def is_number(text: str) -> bool:
    """Return whether a cell is a number, with a decimal point or comma."""
    return _NUMBER.fullmatch(text.strip()) is not None


def _begin(
    path: Path, rows: Sequence[tuple[int, str]], fewest: int, needed: str
) -> tuple[int, str | None]:
    """Find the first row of numbers and the delimiter."""
    # A row with one number may be cut short by the wrong delimiter: two or more come first.
    for least in sorted({2, fewest}, reverse=True):
        for index, (_, line) in enumerate(rows[:_PREAMBLE]):
            if line.lstrip()[0] in COMMENT:
                continue
            best = max(_DELIMITERS, key=lambda delimiter: _score(line, delimiter, least))
            if _score(line, best, least)[0]:
                return index, best
    raise SteadytipError(
        f"recording {path} has no numeric columns in its first {min(len(rows), _PREAMBLE)} lines "
        f"(line {rows[0][0]}: '{rows[0][1].strip()[:60]}'); {needed}, separated by commas, "
        "semicolons, tabs or blanks"
    )


def _score(line: str, delimiter: str | None, least: int) -> tuple[bool, float, int]:
    """Rate a delimiter: enough numbers at all, then their share of the cells, then how many."""
    cells = cut(line, delimiter)
    values = sum(is_number(cell) or _TIME.fullmatch(cell) is not None for cell in cells)
    # A column that nobody uses may hold texts; a comma at the end of a cell separates.
    stray = sum(cell.endswith((",", ";")) for cell in cells)
    return values >= least and not stray, values / len(cells), values


def as_csv(table: TextTable) -> bytes:
    """Return the rows as bytes, with one delimiter between two cells and none behind the last."""
    rows: Iterable[str] = table.rows
    end = table.delimiter
    if end is None:
        rows = ("\t".join(cut(row, None)) for row in rows)
    elif any(row.rstrip(" ").endswith(end) for row in rows):
        rows = (
            row.rstrip(" ")[:-1]
            if row.rstrip(" ").endswith(end) and len(cut(row, end, len(row))) > table.width
            else row
            for row in rows
        )
    return "\n".join(rows).encode("utf-8")
