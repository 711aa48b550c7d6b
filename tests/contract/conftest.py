"""Every model's FMU in both flavours, built once, and a thin instance to drive them with."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import fmi2
from fmpy.fmi2 import FMU2Slave
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription

from fmu_src.pack import build
from fmu_src.pack.discovery import load_model
from tests.conftest import by_model

FLAVOURS = ("native", "python")
KINDS = ("Real", "Integer", "Boolean")


class Instance:
    """An FMU in stepping mode, all variables as one vector in the order of value references."""

    def __init__(self, path: Path, folder: Path, name: str = "instance", **values: float) -> None:
        self.description = _description(path, path.stat().st_mtime_ns)
        self.variables = self.description.modelVariables
        self._named = {variable.name: variable for variable in self.variables}
        self._of_kind = {
            kind: [i for i, v in enumerate(self.variables) if v.type == kind] for kind in KINDS
        }
        self.messages: list[str] = []
        self.fmu = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu.instantiate(callbacks=self._callbacks())
        self.fmu.setupExperiment(startTime=0.0)
        for variable in self.variables:
            if variable.name in values:
                self.set(variable, values[variable.name])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time = 0.0
        self.period = float(self.description.defaultExperiment.stepSize)

    def _callbacks(self) -> object:
        callbacks = fmi2.fmi2CallbackFunctions()

        def log(_env, _instance, _status, _category, message) -> None:
            self.messages.append(message.decode())

        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        addLoggerProxy(ctypes.byref(callbacks))  # puts the printf arguments in
        return callbacks

    def set(self, variable, value: float) -> None:
        setter = getattr(self.fmu, "set" + variable.type)
        setter([variable.valueReference], [value if variable.type == "Real" else int(value)])

    def apply(self, inputs: dict[str, float]) -> None:
        chosen = [(self._named[name], value) for name, value in inputs.items()]
        for kind in KINDS:
            of_kind = [(v.valueReference, value) for v, value in chosen if v.type == kind]
            if of_kind:
                references, values = zip(*of_kind, strict=True)
                cast = float if kind == "Real" else int
                getattr(self.fmu, "set" + kind)(list(references), list(map(cast, values)))

    def step(self, h: float | None = None) -> None:
        h = h or self.period
        self.fmu.doStep(self.time, h)
        self.time += h

    def values(self) -> np.ndarray:
        result = np.empty(len(self.variables))
        for kind, places in self._of_kind.items():
            references = [self.variables[i].valueReference for i in places]
            result[places] = getattr(self.fmu, "get" + kind)(references) if places else []
        return result

    def outputs(self) -> np.ndarray:
        chosen = [v.causality == "output" for v in self.variables]
        return self.values()[chosen]

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()


@cache
def _description(path: Path, changed: int) -> ModelDescription:
    """Read once: there is an instance for each case, and reading takes longer than most of them."""
    return fmpy.read_model_description(path, validate=False)


@pytest.fixture(scope="session", params=by_model())
def model(request: pytest.FixtureRequest):
    """Each model in turn."""
    return load_model(request.param)


@pytest.fixture(scope="session")
def paths(model) -> dict[str, Path]:
    """FMUs of the model by flavour."""
    return {flavour: build([model.name], flavour)[model.name] for flavour in FLAVOURS}


@pytest.fixture(scope="session")
def folders(paths, tmp_path_factory) -> dict[str, Path]:
    """Unpacked FMUs by flavour."""
    found = {}
    for flavour, path in paths.items():
        folder = tmp_path_factory.mktemp(f"{path.stem}_{flavour}")
        fmpy.extract(str(path), str(folder))
        found[flavour] = folder
    return found


@pytest.fixture
def start(paths, folders) -> Iterator[Callable[..., Instance]]:
    """Start instances of the model; they are freed after the test."""
    started = []

    def one(flavour: str = "native", **values: float) -> Instance:
        instance = Instance(paths[flavour], folders[flavour], f"i{len(started)}", **values)
        started.append(instance)
        return instance

    yield one
    for instance in started:
        instance.fmu.freeInstance()


@pytest.fixture
def inputs(model) -> Callable[[int], dict[str, float]]:
    """Inputs for sample k: a smooth, bounded walk inside the declared ranges."""
    scalars = list(model.inputs.scalars())

    def at(k: int) -> dict[str, float]:
        found = {}
        for i, scalar in enumerate(scalars):
            field = scalar.field
            if field.kind == "Boolean":
                found[scalar.name] = float(k % 200 < 150)
                continue
            low, high = field.min, field.max
            reach = min(scalar.start - low, high - scalar.start, 1e-4 + 0.1 * abs(scalar.start))
            reach = reach if np.isfinite(reach) and reach > 0 else 1e-4
            wave = np.sin(0.06 * k + i) + 0.3 * np.sin(0.002 * k * (i + 1))
            found[scalar.name] = scalar.start + reach * wave / 1.3
        return found

    return at
