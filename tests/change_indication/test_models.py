"""Interface, generated C and reference results of every model's FMU."""

import hashlib
import zipfile

import numpy as np
import pytest
from fmpy import read_model_description

from fmu_src.pack import build
from tests.change_indication.conftest import Check
from tests.conftest import by_model

FACTS = (
    *("name", "valueReference", "type", "causality", "variability", "initial", "start"),
    *("min", "max", "unit", "dimensions"),
)
"""What of a variable a change must not touch unnoticed; its description is free."""


@pytest.mark.parametrize("name", by_model())
def test_an_fmu_differs_in_its_texts_only(name, unchanged: Check) -> None:
    path = build([name])[name]
    description = read_model_description(path)
    with zipfile.ZipFile(path) as archive:
        functions = archive.read("sources/functions.c")
        (results,) = [file for file in archive.namelist() if file.endswith("_ref.csv")]
        rows = np.loadtxt(archive.open(results), delimiter=",", skiprows=1)
        headings = archive.read(results).decode().splitlines()[0]
    interface = [
        tuple(str(getattr(variable, fact, None)) for fact in FACTS)
        for variable in description.modelVariables
    ]
    figures: dict[str, float | str] = {
        "variables": len(interface),
        "sha256 of the interface": _digest(repr(interface).encode()),
        "sha256 of functions.c": _digest(functions),
    }
    for column, heading in zip(rows.T, headings.replace('"', "").split(","), strict=True):
        figures[f"rms of {heading}"] = float(np.sqrt(np.mean(column**2)))
    unchanged(f"models/{name}", figures)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
