"""Find the models: modules with a line `MODEL = Model("Name", ...)`.

Models are found in this project and in the packages that other distributions name in the entry
point group `GROUP`. Names are read off the source text, so that no model is imported that nobody
asks for.
"""

import difflib
import importlib
import importlib.metadata
import re
from functools import cache
from pathlib import Path
from types import ModuleType

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model

GROUP = "steadytip.models"
_BUILT_IN = ("fmu_src", "plants")
NOT_MODELS = ("fmu_src/kit/", "fmu_src/pack/")
"""Folders without models."""
_DEFINITION = re.compile(
    r"^MODEL\b(?:[^=\n]*=\s*[\w.]+\(\s*(?:name\s*=\s*)?[\"'](\w+)[\"'])?", re.M
)


def _packages() -> tuple[ModuleType, ...]:
    """Import the packages that hold models: ours, and those of the entry point group `GROUP`."""
    others = {point.value for point in importlib.metadata.entry_points(group=GROUP)}
    return tuple(map(importlib.import_module, (*_BUILT_IN, *sorted(others - {*_BUILT_IN}))))


def _read() -> dict[str, str]:
    """Read every source file of the packages, by its path below their common folder."""
    found = {}
    for package in _packages():
        root = Path(str(package.__file__)).parent
        for file in sorted(root.rglob("*")):
            if file.suffix in (".py", ".c", ".j2"):
                name = file.relative_to(root.parent).as_posix()
                found[name] = file.read_text(encoding="utf-8")
    return found


TEXTS = _read()
"""Taken on import, before any model is: sources that change later must not pass for those built."""


@cache
def _defined(file: str) -> str | None:
    """Return the name of the model that a source file defines, or None."""
    if not file.endswith(".py") or file.startswith(NOT_MODELS):
        return None
    found = _DEFINITION.search(TEXTS[file])
    if found is None or found[1]:
        return found and found[1]
    # The name is not written there: ask the module.
    model = getattr(importlib.import_module(_dotted(file)), "MODEL", None)
    return model.name if isinstance(model, Model) else None


def _dotted(file: str) -> str:
    return file.removesuffix(".py").replace("/", ".")


def model_files() -> dict[str, str]:
    """Return the source file of each model by the model's name."""
    return {name: file for file in TEXTS if (name := _defined(file))}


def model_names() -> list[str]:
    """Return the names of all models, sorted."""
    return sorted(model_files())


def module_of(name: str) -> str:
    """Return the dotted name of the module that defines a model.

    Raises:
        SteadytipError: no such model; the message names the nearest.
    """
    files = model_files()
    if name not in files:
        near = difflib.get_close_matches(name, files, 1)
        hint = f"; the nearest is '{near[0]}'" if near else ""
        raise SteadytipError(f"no model '{name}'{hint}. There are: {', '.join(sorted(files))}")
    return _dotted(files[name])


def load_model(name: str) -> Model:
    """Import a model.

    Raises:
        SteadytipError: no such model; the message names the nearest.
    """
    model: Model = importlib.import_module(module_of(name)).MODEL
    return model
