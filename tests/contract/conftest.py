"""Every model's FMU in both flavours, built once, and a thin instance to drive them with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import fmpy
import pytest

from fmu_src.pack import build
from fmu_src.pack.discovery import load_model
from steadytip.testing import FmuUnderTest, inputs_of
from tests.conftest import by_model

FLAVOURS = ("native", "python")


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
def start(paths, folders) -> Iterator[Callable[..., FmuUnderTest]]:
    """Start instances of the model; they are freed after the test."""
    started = []

    def one(flavour: str = "native", **values: float) -> FmuUnderTest:
        instance = FmuUnderTest(paths[flavour], folders[flavour], f"i{len(started)}", **values)
        started.append(instance)
        return instance

    yield one
    for instance in started:
        instance.fmu.freeInstance()


@pytest.fixture
def inputs(model) -> Callable[[int], dict[str, float]]:
    """Inputs for sample k: a smooth, bounded walk inside the declared ranges."""
    return inputs_of(model)
