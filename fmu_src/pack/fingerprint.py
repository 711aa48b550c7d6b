"""Find the source files that an FMU is made of, without importing a model.

An FMU is a function of its models' modules, of all that these import from the project, of the
package that packs, and of the tools it calls. Imports are read off the text; what looks like an
import and is none does no harm.
"""

import hashlib
import importlib.metadata
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import PurePosixPath

from fmu_src.pack.discovery import NOT_MODELS, TEXTS, module_of

_ALWAYS = ("fmu_src/__init__.py", "fmu_src/errors.py", *NOT_MODELS)
"""In every FMU, beside what its models import."""
_TOOLS = ("casadi", "numpy", "ziglang", "pythonfmu")
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+(\.*[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))",
    re.M,
)
_NAME = re.compile(r"[\w.]+")


def made_of(names: Iterable[str]) -> tuple[str, ...]:
    """Return the files that FMUs of some models, or of a container of them, are made of, sorted.

    Raises:
        SteadytipError: no such model.
    """
    found = {file for file in TEXTS if file.startswith(_ALWAYS)}
    waiting = {file for name in names for file in _files(module_of(name))}
    while waiting:
        found |= waiting
        waiting = {imported for file in waiting for imported in _imports(file)} - found
    return tuple(sorted(found))


def digest(files: Iterable[str], *words: str) -> str:
    """Hash the content of some files, the tools' versions, and some words."""
    tools = [f"{tool} {_version(tool)}" for tool in _TOOLS]
    found = hashlib.sha256("\n".join([*words, *tools]).encode())
    for file in files:
        found.update(f"\n{file}\n{_content(file)}".encode())
    return found.hexdigest()[:32]


@cache
def _content(file: str) -> str:
    return hashlib.sha256(TEXTS[file].encode()).hexdigest()


@cache
def _imports(file: str) -> frozenset[str]:
    """Return the files of the project that a file imports, directly."""
    if not file.endswith(".py"):
        return frozenset()
    package = ".".join(PurePosixPath(file).parent.parts)
    modules = set()
    for base, names, plain in _IMPORT.findall(TEXTS[file]):
        if plain:
            modules.update(_NAME.findall(plain))
            continue
        if dots := len(base) - len(base.lstrip(".")):
            above = package.split(".")[: 1 - dots or None]
            base = ".".join([*above, *filter(None, [base[dots:]])])
        # Names may be modules, too.
        modules.update([base, *(f"{base}.{name}" for name in _NAME.findall(names))])
    return frozenset(found for module in modules for found in _files(module))


def _files(module: str) -> Iterator[str]:
    """Yield the file of a module of the project and those of the packages that it is in."""
    steps = module.split(".")
    for count in range(1, len(steps) + 1):
        stem = "/".join(steps[:count])
        yield from (file for file in (f"{stem}.py", f"{stem}/__init__.py") if file in TEXTS)


@cache
def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "none"
