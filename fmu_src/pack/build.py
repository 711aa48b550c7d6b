"""Find the models and build their FMUs, each only when its content has changed."""

import difflib
import hashlib
import importlib
import importlib.metadata
import pkgutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path

import fmu_src
import plants
from fmu_src.kit import Model, SteadytipError
from fmu_src.pack import archive, native

FLAVOURS = ("native", "python")
_PACKAGES = (fmu_src, plants)
_NOT_MODELS = ("fmu_src.kit", "fmu_src.pack")
_BUILD = Path("build")


@cache
def _modules() -> dict[str, str]:
    """Module of each model, by the model's name; a module with a `MODEL` is one."""
    found = {}
    for package in _PACKAGES:
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if info.ispkg or info.name.startswith(_NOT_MODELS):
                continue
            model = getattr(importlib.import_module(info.name), "MODEL", None)
            if isinstance(model, Model):
                found[model.name] = info.name
    return found


def model_names() -> list[str]:
    """Names of all models, sorted."""
    return sorted(_modules())


def load_model(name: str) -> Model:
    """The model of that name.

    Raises:
        SteadytipError: there is none; names the nearest.
    """
    modules = _modules()
    if name not in modules:
        near = difflib.get_close_matches(name, modules, 1)
        hint = f"; the nearest is '{near[0]}'" if near else ""
        raise SteadytipError(f"no model '{name}'{hint}. There are: {', '.join(sorted(modules))}")
    model: Model = importlib.import_module(modules[name]).MODEL
    return model


def build(
    names: Iterable[str] | None = None,
    flavour: str = "native",
    out: Path | None = None,
    progress: Callable[[str], None] = lambda name: None,
    targets: Collection[str] | None = None,
) -> dict[str, Path]:
    """Build FMUs that are missing or older than their content.

    A stamp beside each FMU holds a digest of all sources, so that an FMU known to be up to date
    costs no import of its model, and the GUID, so that it is compiled again only when its own
    content has changed.

    Args:
        names: models; all by default.
        flavour: `native` (C, this platform) or `python`.
        out: folder of the FMUs; `build/fmus/<flavour>` by default.
        progress: called with a model's name before it is built; not for one that is up to date.
        targets: platforms of a native FMU, by folder name, or `all`; this one by default.

    Returns:
        Path of each FMU.

    Raises:
        SteadytipError: an unknown model, flavour or target, or a compiler that refuses.
    """
    if flavour not in FLAVOURS:
        raise SteadytipError(f"flavour '{flavour}' must be one of {', '.join(FLAVOURS)}")
    folder = out or _BUILD / "fmus" / flavour
    wanted = model_names() if names is None else names
    platforms = native.chosen(targets) if flavour == "native" else []
    return {
        name: build_file(
            folder / f"{name}.fmu", partial(load_model, name), flavour, platforms, progress
        )
        for name in wanted
    }


def build_file(
    path: Path,
    load: Callable[[], Model],
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
    plan: str = "",
) -> Path:
    """Build one FMU, if it is missing or older than its content.

    Args:
        path: of the FMU.
        load: gives the model; called only when something has changed.
        flavour: `native` or `python`.
        platforms: of a native FMU, by folder name.
        progress: called with the model's name before it is built.
        plan: digest of what the model is made of, beside the sources.

    Returns:
        The path.

    Raises:
        SteadytipError: what `load` raises, or a compiler that refuses.
    """
    everything = _SOURCES + plan
    sources, _, _, enough = _known(path, platforms)
    if sources == everything and enough:
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with _alone(path.with_suffix(".lock")):
        return _build_alone(path, load, flavour, platforms, progress, everything)


def _known(path: Path, platforms: list[str]) -> tuple[str, str, str, bool]:
    """What an FMU was built of, and for, and whether that will do for some platforms."""
    stamp = path.with_suffix(".stamp")
    known = stamp.read_text(encoding="utf-8").split() if path.is_file() and stamp.is_file() else []
    sources, packing, built = (*known, "", "", "")[:3]
    # An FMU for more platforms than are asked for will do.
    return sources, packing, built, bool(known) and set(platforms) <= set(built.split(","))


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Until another process that holds the lock has built, where the system has such locks."""
    with lock.open("w") as file:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _build_alone(
    path: Path,
    load: Callable[[], Model],
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
    everything: str,
) -> Path:
    from fmu_src.pack import csource, description, documents, python_flavour

    sources, packing, built, enough = _known(path, platforms)
    if sources == everything and enough:
        return path
    model = load()
    guid = description.content_guid(model, csource.sources(model, ""))
    # What makes an FMU of a model, beside the model: this package and the tools it calls.
    wanted = _digest((importlib.import_module("fmu_src.pack"),), guid)
    if packing != wanted or not enough:
        progress(model.name)
        if flavour == "python":
            files = python_flavour.files(model, guid)
        else:
            files = native.files(model, guid, platforms, _BUILD / "c")
        archive.write(path, {**files, **documents.files(model, flavour)})
        built = ",".join(platforms or ["any"])
    path.with_suffix(".stamp").write_text(f"{everything} {wanted} {built}", encoding="utf-8")
    return path


def _digest(packages: Iterable[object], *words: str) -> str:
    """Hash of every source file of some packages, the tools' versions, and some words."""
    tools = [f"{tool} {_version(tool)}" for tool in ("casadi", "ziglang", "pythonfmu")]
    found = hashlib.sha256("\n".join([*words, *tools]).encode())
    for package in packages:
        root = Path(str(package.__file__)).parent  # type: ignore[attr-defined]
        for file in sorted(root.rglob("*")):
            if file.suffix in (".py", ".c"):
                found.update(f"\n{file.relative_to(root).as_posix()}\n".encode())
                found.update(file.read_bytes())
    return found.hexdigest()[:32]


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "none"


_SOURCES = _digest(_PACKAGES)
"""Taken on import, before any model is: sources that change later must not pass for those built."""
