"""The page of all models: `fmu_src/MODELS.md`.

`python -m fmu_src.pack.models_page` writes it; with `--check` it fails where it is out of date.
"""

import difflib
import sys
from collections.abc import Iterator
from pathlib import Path

from fmu_src.kit.model import Model
from fmu_src.pack.discovery import load_model, model_names
from fmu_src.pack.docs.variables import VariableRow, rows, source

PAGE = Path(__file__).parents[1] / "MODELS.md"


_TITLES = {"parameters": "Parameters", "inputs": "Inputs", "outputs": "Outputs"}


def page() -> str:
    """Return the whole page, in Markdown."""
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


def _line(row: VariableRow) -> str:
    shape = f" ({row.shape})" if row.shape else ""
    return f"| `{row.name}`{shape} | {row.unit} | {row.start} | {row.limits} | {row.sentence} |"


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
