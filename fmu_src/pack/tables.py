"""Tables of a model's variables, and the page of all models made of them: `fmu_src/MODELS.md`.

`python -m fmu_src.pack.tables` writes the page, with `--check` it fails where it is out of date.
"""

import difflib
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from fmu_src.kit import Model
from fmu_src.kit.records import Field, Record
from fmu_src.pack import load_model, model_names

PAGE = Path(__file__).parents[1] / "MODELS.md"
_TITLES = {"parameters": "Parameters", "inputs": "Inputs", "outputs": "Outputs"}


def page() -> str:
    """The whole page."""
    models = [load_model(name) for name in model_names()]
    lines = [
        "# Models",
        "Generated from the models (`make tables`); do not edit. SI units on every port. Arrays are"
        " one row: on ports their elements are `name_x`, `name_1`, among parameters `name[1]`.",
        "",
        "| model | what it is | sample period | a sample |",
        "| --- | --- | --- | --- |",
    ]
    for model in models:
        period = f"{model.sample_period * 1e3:g} ms"
        count = model.operations(model.step_function)
        link = f"[{model.name}](#{model.name.lower()})"
        lines.append(f"| {link} | {model.summary} | {period} | {count} |")
    for model in models:
        lines += _section(model)
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Row:
    """A field as people read it: name, shape, unit, start values, limits, what it is."""

    name: str
    shape: str
    unit: str
    start: str
    limits: str
    sentence: str


def rows(record: type[Record], prefix: str = "") -> Iterator[Row]:
    """Fields of a record, nested ones under their dotted path."""
    for name, field in record.fields.items():
        if not isinstance(field, Field):
            yield from rows(field, f"{prefix}{name}.")
            continue
        low, high = (
            "" if math.isinf(value) else f"{value:.6g}" for value in (field.min, field.max)
        )
        yield Row(
            name=prefix + name,
            shape=" x ".join(map(str, field.shape)),
            unit=(field.unit or "1") if field.kind == "Real" else field.kind,
            start=_start(field.start),
            limits=f"{low} .. {high}" if low or high else "",
            sentence=field.description + (" Tunable." if field.tunable else ""),
        )


def source(model: Model) -> str:
    """Path of the model's module in the project."""
    return sys.modules[model.step.__module__].__name__.replace(".", "/") + ".py"


def _section(model: Model) -> Iterator[str]:
    yield from ("", f"## {model.name}", f"{model.summary}. Source: `{source(model)}`.")
    for attribute, title in _TITLES.items():
        lines = [_line(row) for row in rows(getattr(model, attribute))]
        if lines:
            yield from (
                "",
                f"| {title} | unit | start | range | |",
                "| --- | --- | --- | --- | --- |",
                *lines,
            )


def _line(row: Row) -> str:
    shape = f" ({row.shape})" if row.shape else ""
    return f"| `{row.name}`{shape} | {row.unit} | {row.start} | {row.limits} | {row.sentence} |"


def _start(values: Iterable[float]) -> str:
    """Start values, runs of equal ones written once."""
    runs = [(value, len(list(same))) for value, same in groupby(values)]
    if len(runs) > 12:
        return "see source"
    return ", ".join(f"{value:.6g}" + (f" x {n}" if n > 1 else "") for value, n in runs)


def main() -> int:
    """Write or check the page; 0 when it is up to date."""
    new = page()
    old = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(new, encoding="utf-8")
        return 0
    if new != old:
        print("".join(difflib.unified_diff(old.splitlines(True), new.splitlines(True), n=0)))
        print(f"{PAGE.name} is out of date; run `make tables`")
    return new != old


if __name__ == "__main__":
    sys.exit(main())
