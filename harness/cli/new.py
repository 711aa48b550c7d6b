"""The command `steadytip new`."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import console

_TEMPLATES = Path(__file__).parent / "templates"


class NewKind(StrEnum):
    """What a new model is the beginning of; each has two templates."""

    MODEL = "model"
    PLANT = "plant"
    ESTIMATOR = "estimator"


def new(
    kind: Annotated[NewKind, typer.Argument(help="What to begin with.")],
    name: Annotated[str, typer.Argument(help="Name of the model and its FMU: SlowDrift.")],
    out: Annotated[Path, typer.Option(help="Folder of the files.")] = Path(),
) -> None:
    """Write a small model of your own with its test, to be changed."""
    from fmu_src.errors import SteadytipError
    from harness.common.files import write_text

    if not re.fullmatch(r"[A-Za-z]\w{0,31}", name, re.ASCII):
        raise SteadytipError(
            f"name '{name}' must begin with a letter, go on with letters, digits and _, and have at"
            " most 32 characters"
        )
    module = module_name(name)
    taken = _importable(module)
    if taken:
        raise SteadytipError(
            f"name '{name}': its test could not import {module}.py, since Python has {taken}"
            " already; take another name"
        )
    paths = {f"{kind}.py.j2": out / f"{module}.py", f"test_{kind}.py.j2": out / f"test_{module}.py"}
    there = [str(path) for path in paths.values() if path.exists()]
    if there:
        raise SteadytipError(
            f"{', '.join(there)} exists and is kept: choose another name, or another folder by"
            " --out"
        )
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    for template, path in paths.items():
        text = environment.get_template(template).render(name=name, module=module)
        console.print(str(write_text(path, text)), highlight=False, soft_wrap=True)
    model = next(iter(paths.values()))
    console.print(
        f"build it with: steadytip build {model}; test it with: pytest {out}",
        style="dim",
        highlight=False,
        soft_wrap=True,
    )


def module_name(name: str) -> str:
    """Return the module's name for a model's.

    >>> module_name("SlowDrift"), module_name("EKFFilter")
    ('slow_drift', 'ekf_filter')
    """
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def _importable(module: str) -> str:
    """Return what a module's name stands for already; empty if for nothing."""
    import keyword
    import sys

    if keyword.iskeyword(module):
        return f"the keyword '{module}'"
    return f"a module '{module}'" if module in sys.stdlib_module_names else ""
