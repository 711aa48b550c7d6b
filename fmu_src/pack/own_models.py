"""Models of a user's own: read from a file outside the project, and known by their content.

A file is run as Python runs a script, with its folder in front of the import path. A model is known
by what was recorded of it, not by the file's text: whatever it takes from elsewhere, a neighbouring
module or a table of numbers, makes another digest when it changes.
"""

import hashlib
import math
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import casadi as ca

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.kit.places import failure, namespace, place_of
from fmu_src.model_files import split_model_file
from fmu_src.pack.docs.variables import source
from fmu_src.pack.fmu.description import describe

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,31}")
_GUID = "{00000000-0000-0000-0000-000000000000}"


def load_models(value: str) -> list[Model]:
    """Return the models that a file of the user's defines, or the one that is named behind it.

    Args:
        value: `lowpass.py`, or `lowpass.py:LowPass`.

    Raises:
        SteadytipError: the file is not there, fails, or defines no such model; or a step fails: the
            message names file and line.
    """
    path, wanted = split_model_file(value)
    models = _defined(path)
    if wanted:
        models = {name: model for name, model in models.items() if name == wanted} or _none(
            path, wanted, models
        )
    return list(models.values())


def load_own_model(value: str) -> Model:
    """Return the one model that a file of the user's defines, or the one named behind it.

    Raises:
        SteadytipError: see `load_models`; or there are several.
    """
    models = load_models(value)
    if len(models) > 1:
        names = [model.name for model in models]
        raise SteadytipError(
            f"{value} defines the models {', '.join(names)}: say which, as in '{value}:{names[0]}'"
        )
    return models[0]


def check(model: Model) -> Model:
    """Return a model that an FMU can be made of.

    Raises:
        SteadytipError: its name is none for an FMU, its sample period is none, two variables have
            one name, its step fails, or computes with a number that is none.
    """
    place = f"model '{model.name}' ({place_of(model.step)})"
    if not _NAME.fullmatch(model.name):
        raise SteadytipError(
            f"{place}: the name must begin with a letter, go on with letters, digits and _, and"
            " have at most 32 characters"
        )
    if not (math.isfinite(model.sample_period) and model.sample_period > 0):
        raise SteadytipError(
            f"{place}: sample_period = {model.sample_period} s must be finite and above 0"
        )
    names = Counter(scalar.name for group in model.variables.values() for scalar in group)
    twice = [name for name, count in names.items() if count > 1]
    if twice:
        raise SteadytipError(
            f"{place}: several of its variables are called {', '.join(twice)}; parameters, inputs"
            " and outputs share one list of names"
        )
    for function in (model.step_function, model.derive_function):
        if _holds_nan(function):
            raise SteadytipError(
                f"{place}: computes with nan, a number that is none. A function of `math` or a"
                " conversion by `float` gives nan of a symbol: take the one of casadi, as `ca.sin`"
            )
    return model


def recorded_digest(model: Model) -> str:
    """Hash all that a model's FMU is made of beside the project's sources, hexadecimal."""
    found = hashlib.sha256(describe(model, _GUID, {}, []))
    functions = [model.step_function, model.derive_function, model.start_function]
    if model.derivatives:
        functions.append(model.directional_derivative)
    for function in functions:
        found.update(function.serialize().encode())
    said = (model.documentation, source(model), model.noise_streams, model.initial_latches)
    found.update(repr((*said, model.matrix, model.derivatives)).encode())
    return found.hexdigest()[:32]


def _holds_nan(function: ca.Function) -> bool:
    if not function.is_a("SXFunction"):
        return False  # matrices refuse to be numbers
    return any(
        function.instruction_id(k) == ca.OP_CONST and math.isnan(function.instruction_constant(k))
        for k in range(function.n_instructions())
    )


def _none(path: Path, wanted: str, models: Mapping[str, Model]) -> dict[str, Model]:
    raise SteadytipError(f"{path} defines no model '{wanted}'. There are: {', '.join(models)}")


def _defined(path: Path) -> dict[str, Model]:
    """Run a file and return its models by name: `MODEL`, and all that its own steps make."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise SteadytipError(f"{path} cannot be read: {error.strerror}") from None
    content = hashlib.sha256(text + str(path.resolve()).encode()).hexdigest()[:16]
    module = ModuleType(f"{path.stem}_{content}")
    module.__file__ = str(path)
    module.__package__ = ""
    # Records and dataclasses look their module up by its name.
    sys.modules[module.__name__] = module
    with _importing_from(path.resolve().parent):
        try:
            exec(compile(text, str(path), "exec"), module.__dict__)
        except SystemExit as error:
            raise SteadytipError(f"{path} ends the program (exit {error.code})") from None
        except Exception as error:
            raise SteadytipError(failure(error, lambda: None)) from error
        models: dict[str, Model] = {}
        for name, found in vars(module).items():
            own = isinstance(found, Model) and (
                name == "MODEL" or namespace(found.step).get("__name__") == module.__name__
            )
            if own and models.setdefault(found.name, found) is not found:
                raise SteadytipError(f"{path} defines two models '{found.name}': rename one")
        for model in models.values():
            check(model)  # records it, as long as what it imports late can be found
    if not models:
        raise SteadytipError(
            f"{path} defines no model: it needs a line 'MODEL = Model(\"Name\", step, ...)'; see"
            " 'A model is one file' in the README"
        )
    return models


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Import from a folder first; what came from it is forgotten, for the next file's namesake."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).resolve().is_relative_to(folder) and "." not in name:
                _forget(name)


def _forget(package: str) -> None:
    for name in [n for n in sys.modules if n == package or n.startswith(f"{package}.")]:
        del sys.modules[name]
