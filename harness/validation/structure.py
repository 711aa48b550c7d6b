"""The description's ModelStructure: item C12."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from harness.validation.checks import FILES, Skip
from harness.validation.files import Fmu
from harness.validation.variables import ScalarVariable

_KINDS = {"dependent", "constant", "fixed", "tunable", "discrete"}
_SECTIONS = ("Outputs", "Derivatives", "InitialUnknowns")


def _indices(fmu: Fmu, section: str) -> list[int]:
    found = []
    for unknown in fmu.root.iterfind(f"ModelStructure/{section}/Unknown"):
        text = unknown.get("index", "")
        if not text.isdigit():
            raise Skip(f"an index in {section} is no number")
        found.append(int(text))
    return found


def _compared(
    scalars: list[ScalarVariable], section: str, found: list[int], wanted: list[int]
) -> Iterator[str]:
    names = {scalar.index: scalar.name for scalar in scalars}
    for index in sorted(set(wanted) - set(found)):
        yield f"{section} lacks '{names[index]}' (index {index})"
    for index in sorted(set(found) - set(wanted)):
        yield f"{section} holds '{names.get(index, '?')}' (index {index}), which does not belong"
    if len(set(found)) != len(found):
        yield f"{section} names a variable twice"


@FILES.check("C12.outputs", "error", "ModelStructure/Outputs are all outputs, and only they")
def _outputs(fmu: Fmu) -> Iterator[str]:
    scalars = fmu.scalars
    wanted = [s.index for s in scalars if s.causality == "output"]
    yield from _compared(scalars, "Outputs", _indices(fmu, "Outputs"), wanted)


@FILES.check("C12.initial_unknowns", "error", "InitialUnknowns are what initialisation computes")
def _initial_unknowns(fmu: Fmu) -> Iterator[str]:
    scalars = fmu.scalars
    computed = {"calculated", "approx"}
    derivatives = set(_indices(fmu, "Derivatives"))
    states = {
        int(s.typed.get("derivative"))
        for s in scalars
        if s.index in derivatives and (s.typed.get("derivative") or "").isdigit()
    }
    wanted = [
        s.index
        for s in scalars
        if s.initial in computed
        and (s.causality in {"output", "calculatedParameter"} or s.index in derivatives | states)
    ]
    yield from _compared(scalars, "InitialUnknowns", _indices(fmu, "InitialUnknowns"), wanted)


@FILES.check("C12.ascending", "error", "indices and dependencies are in ascending order")
def _ascending(fmu: Fmu) -> Iterator[str]:
    for section in ("Outputs", "InitialUnknowns"):
        indices = _indices(fmu, section)
        if indices != sorted(indices):
            yield f"the indices of {section} are not ascending: {indices[:8]}"
    for section, unknown in _unknowns(fmu):
        numbers = _dependencies(unknown)
        if numbers != sorted(set(numbers)):
            yield f"{section}, index {unknown.get('index')}: dependencies {numbers[:8]}"


@FILES.check("C12.dependencies", "error", "dependencies exist, and their kinds are as many")
def _legal_dependencies(fmu: Fmu) -> Iterator[str]:
    count = len(fmu.scalars)
    for section, unknown in _unknowns(fmu):
        where = f"{section}, index {unknown.get('index')}"
        numbers = _dependencies(unknown)
        if any(not 1 <= number <= count for number in numbers):
            yield f"{where}: a dependency is not among 1 to {count}"
        kinds = unknown.get("dependenciesKind")
        if kinds is not None:
            if unknown.get("dependencies") is None:
                yield f"{where}: dependenciesKind without dependencies"
            elif len(kinds.split()) != len(numbers):
                yield f"{where}: {len(numbers)} dependencies, {len(kinds.split())} kinds"
            for kind in sorted(set(kinds.split()) - _KINDS):
                yield f"{where}: the kind '{kind}' does not exist"


@FILES.check("C12.stated", "warning", "outputs state what they depend on")
def _stated(fmu: Fmu) -> Iterator[str]:
    silent = [
        u.get("index")
        for s, u in _unknowns(fmu)
        if s == "Outputs" and u.get("dependencies") is None
    ]
    if silent:
        yield (
            f"outputs with the indices {', '.join(map(str, silent[:8]))} state no dependencies, so "
            "importers assume all of them and may see algebraic loops"
        )


def _unknowns(fmu: Fmu) -> Iterator[tuple[str, Any]]:
    for section in _SECTIONS:
        for unknown in fmu.root.iterfind(f"ModelStructure/{section}/Unknown"):
            yield section, unknown


def _dependencies(unknown: Any) -> list[int]:
    return [int(text) for text in (unknown.get("dependencies") or "").split() if text.isdigit()]
