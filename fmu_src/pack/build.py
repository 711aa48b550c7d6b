"""Find the models and build their FMUs, each only when its content has changed."""

import difflib
import importlib
import pkgutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path

from fmu_src.errors import SteadytipError
from fmu_src.kit import Model
from fmu_src.pack import cache as store
from fmu_src.pack import fingerprint as sources
from fmu_src.pack.fmu import archive, native

FLAVOURS = ("native", "python")
_NOT_MODELS = ("fmu_src.kit", "fmu_src.pack")
_BUILD = Path("build")


@cache
def _modules() -> dict[str, str]:
    """Module of each model, by the model's name; a module with a `MODEL` is one."""
    found = {}
    for package in sources.PACKAGES:
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
    for home in sources.homes(name):
        found = getattr(importlib.import_module(home), "MODEL", None)
        if isinstance(found, Model) and found.name == name:
            return found
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

    A stamp beside each FMU holds a digest of the sources that it is made of, so that an FMU known
    to be up to date costs no import of its model. One that was built of the same sources before is
    kept, and so is each compiled library.

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
            folder / f"{name}.fmu", [name], partial(load_model, name), flavour, platforms, progress
        )
        for name in wanted
    }


def build_file(
    path: Path,
    models: Sequence[str],
    load: Callable[[], Model],
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
    plan: str = "",
) -> Path:
    """Build one FMU, if it is missing or older than its content.

    Args:
        path: of the FMU.
        models: names of those that it is made of.
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
    content = sources.digest(sources.made_of(models), flavour, plan)
    if _is_current(path, content, platforms):
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with _alone(path.with_suffix(".lock")):
        if not _is_current(path, content, platforms):
            built = ",".join(platforms or ["any"])
            made = partial(_made, load, flavour, platforms, progress)
            archive.place(path, store.recall(_BUILD / "c" / "fmus", f"{content}-{built}", made))
            path.with_suffix(".stamp").write_text(f"{content} {built}", encoding="utf-8")
    return path


def _is_current(path: Path, content: str, platforms: list[str]) -> bool:
    """Whether an FMU was built of that, and for these platforms; for more will do."""
    stamp = path.with_suffix(".stamp")
    if not (path.is_file() and stamp.is_file()):
        return False
    built, _, targets = stamp.read_text(encoding="utf-8").partition(" ")
    return built == content and set(platforms) <= set(targets.split(","))


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Until another process that holds the lock has built, where the system has such locks."""
    with lock.open("w") as file:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _made(
    load: Callable[[], Model],
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
) -> bytes:
    from fmu_src.pack.codegen import c_source as csource
    from fmu_src.pack.docs import documents
    from fmu_src.pack.fmu import description, python_flavour

    model = load()
    progress(model.name)
    guid = description.content_guid(model, csource.sources(model, ""))
    if flavour == "python":
        files = python_flavour.files(model, guid)
    else:
        files = native.files(model, guid, platforms, _BUILD / "c")
    return archive.packed({**files, **documents.files(model, flavour)})
