"""Build the FMUs of models, each only when its content has changed."""

import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.model_files import is_model_file
from fmu_src.pack import cache, compiler, fingerprint
from fmu_src.pack.discovery import load_model, model_names
from fmu_src.pack.fmu import archive

__all__ = ["FLAVOURS", "build", "build_file", "load_model", "model_names"]

FLAVOURS = ("native", "python")
_BUILD = Path("build")


def build(
    models: str | Path | Model | Iterable[str | Path | Model] | None = None,
    flavour: str = "native",
    out: Path | None = None,
    progress: Callable[[str], None] = lambda name: None,
    targets: Collection[str] | None = None,
) -> dict[str, Path]:
    """Build FMUs that are missing or older than their content.

    A stamp beside each FMU holds a digest of the sources that it is made of, so that an FMU known
    to be up to date costs no import of its model. One that was built of the same sources before is
    kept, and so is each compiled library. A model of the user's own is known by what was recorded
    of it; the name of its FMU in `build/fmus` ends with a digest, so that one version of it never
    takes the place of another, nor of a model that comes along.

    Args:
        models: one or several; all that come along by default. A name, as in `models()`; a Python
            file of your own, `lowpass.py`, with all models that it defines, or one of them,
            `lowpass.py:LowPass`; or a `Model`, from a notebook or a script.
        flavour: `native` (C, this platform) or `python`.
        out: folder of the FMUs; `build/fmus/<flavour>` by default.
        progress: called with a model's name before it is built; not for one that is up to date.
        targets: platforms of a native FMU, by folder name, or `all`; this one by default.

    Returns:
        Path of each FMU, by the model's name.

    Raises:
        SteadytipError: an unknown model, flavour or target, a file or a step that fails, two models
            of one name, or a compiler that refuses.
    """
    if flavour not in FLAVOURS:
        raise SteadytipError(f"flavour '{flavour}' must be one of {', '.join(FLAVOURS)}")
    folder = out or _BUILD / "fmus" / flavour
    wanted = model_names() if models is None else models
    several = [wanted] if isinstance(wanted, str | Path | Model) else wanted
    platforms = compiler.select_targets(targets) if flavour == "native" else []
    chosen: dict[str, str | Model] = {}
    for name, model in (found for each in several for found in _found(each)):
        if chosen.setdefault(name, model) is not model and chosen[name] != model:
            raise SteadytipError(f"two models are called '{name}': build one at a time, or rename")
    return {
        name: build_file(
            folder / f"{name}.fmu", [name], partial(load_model, name), flavour, platforms, progress
        )
        if isinstance(model, str)
        else _build_own(model, folder, out is None, flavour, platforms, progress)
        for name, model in chosen.items()
    }


def _found(wanted: str | Path | Model) -> Iterator[tuple[str, str | Model]]:
    """Yield the name of each model that is meant, and the model itself if it is a user's own."""
    if isinstance(wanted, Model):
        from fmu_src.pack.own_models import check

        yield wanted.name, check(wanted)
    elif isinstance(wanted, Path) or is_model_file(wanted):
        if not is_model_file(str(wanted)):
            raise SteadytipError(f"{wanted} must be a Python file, as in lowpass.py")
        from fmu_src.pack.own_models import load_models

        yield from ((model.name, model) for model in load_models(str(wanted)))
    else:
        yield wanted, wanted


def _build_own(
    model: Model,
    folder: Path,
    versioned: bool,
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
) -> Path:
    """Build the FMU of a user's own model; see `build`."""
    from fmu_src.pack.own_models import recorded_digest

    digest = recorded_digest(model)
    path = folder / (f"{model.name}-{digest[:8]}.fmu" if versioned else f"{model.name}.fmu")
    return build_file(path, [], lambda: model, flavour, platforms, progress, digest)


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
    content = fingerprint.digest(fingerprint.made_of(models), flavour, plan)
    if _is_current(path, content, platforms):
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with _locked(path.with_suffix(".lock")):
        if not _is_current(path, content, platforms):
            built = ",".join(platforms or ["any"])
            make = partial(_package, load, flavour, platforms, progress)
            cache.write(path, cache.recall(_BUILD / "c" / "fmus", f"{content}-{built}", make))
            path.with_suffix(".stamp").write_text(f"{content} {built}", encoding="utf-8")
    return path


def _is_current(path: Path, content: str, platforms: list[str]) -> bool:
    """Tell whether an FMU was built of that content and, at least, for these platforms."""
    stamp = path.with_suffix(".stamp")
    if not (path.is_file() and stamp.is_file()):
        return False
    built, _, targets = stamp.read_text(encoding="utf-8").partition(" ")
    return built == content and set(platforms) <= set(targets.split(","))


@contextmanager
def _locked(lock: Path) -> Iterator[None]:
    """Wait until no other process builds the same FMU, where the system has such locks."""
    with lock.open("w") as file:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _package(
    load: Callable[[], Model],
    flavour: str,
    platforms: list[str],
    progress: Callable[[str], None],
) -> bytes:
    """Return the bytes of a model's FMU."""
    from fmu_src.pack.codegen import c_source
    from fmu_src.pack.docs import documents
    from fmu_src.pack.fmu import description, native, python_flavour

    model = load()
    progress(model.name)
    guid = description.content_guid(model, c_source.sources(model, ""))
    if flavour == "python":
        files = python_flavour.files(model, guid)
    else:
        files = native.files(model, guid, platforms)
    return archive.pack({**files, **documents.files(model, flavour)})
