"""modelDescription.xml as importers want it; the names say which line of the checklist is meant.

What FMPy checks is left to it (`test_c01_...`). These tests read the XML itself.
"""

import math
import re
import zipfile
from pathlib import Path
from types import SimpleNamespace

import fmpy
import numpy as np
import pytest
from fmpy.validation import _validate_variable_names, validate_fmu
from lark import Lark
from lxml import etree

from fmu_src import __version__
from fmu_src.kit.units import BASE, OFFSETS, base_exponents
from fmu_src.pack.fmu.description import LOG_CATEGORIES
from tests.contract.conftest import FLAVOURS

_SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"
_ORDER = [
    "CoSimulation",
    "UnitDefinitions",
    "LogCategories",
    "DefaultExperiment",
    "ModelVariables",
    "ModelStructure",
]
_STANDARD_CATEGORIES = {
    "logEvents",
    "logStatusWarning",
    "logStatusDiscard",
    "logStatusError",
    "logStatusFatal",
    "logStatusPending",
    "logAll",
}
# causality, variability, initial, start value (FMI 2.0.5, 2.2.7)
_LEGAL = {
    ("parameter", "fixed", "exact", True),
    ("parameter", "tunable", "exact", True),
    ("calculatedParameter", "tunable", "calculated", False),
    ("input", "discrete", None, True),
    ("output", "discrete", "calculated", False),
    ("local", "discrete", "calculated", False),
}
_IDENTIFIER = r"[A-Za-z_]\w*"
_STRUCTURED = re.compile(
    rf"{_IDENTIFIER}(\[\d+(,\d+)*\])?(\.{_IDENTIFIER}(\[\d+(,\d+)*\])?)*$", re.ASCII
)
_PARSED: set[str] = set()


@pytest.fixture(params=FLAVOURS)
def flavour(request) -> str:
    return request.param


@pytest.fixture
def root(paths, flavour):
    with zipfile.ZipFile(paths[flavour]) as archive:
        return etree.fromstring(archive.read("modelDescription.xml"))


@pytest.fixture
def variables(root) -> list[tuple[etree._Element, etree._Element]]:
    """Every variable and its typed element."""
    return [(node, node[0]) for node in root.find("ModelVariables")]


def _of(variables, *causalities: str) -> list[int]:
    """1-based indices of the variables with these causalities."""
    found = enumerate(variables, 1)
    return [index for index, (node, _) in found if node.get("causality") in causalities]


@pytest.fixture
def fast_names(monkeypatch) -> None:
    """FMPy's parser takes some 15 ms for a name: each pattern of names goes through it once.

    Its grammar knows runs of digits only, never which digits or how many, so a name is legal if and
    only if it is with `1` for each of its numbers.
    """
    parse = Lark.parse

    def once(parser: Lark, name: str) -> None:
        pattern = re.sub(r"\d+", "1", name)
        if pattern not in _PARSED:
            parse(parser, pattern)
            _PARSED.add(pattern)

    monkeypatch.setattr(Lark, "parse", once)


def test_c01_wrong_names_are_still_found(fast_names) -> None:
    names = {"a1.b[12,3]": True, "a[1": False, "1a": False, "a[1.2]": False, "a..b": False}
    variables = [SimpleNamespace(name=name, sourceline=1) for name in names]
    described = SimpleNamespace(variableNamingConvention="structured", modelVariables=variables)
    problems = _validate_variable_names(described)
    wrong = [name for name, legal in names.items() if not legal]
    assert len(problems) == len(wrong)
    assert all(name in problem for name, problem in zip(wrong, problems, strict=True))


def test_c01_schema_and_fmpy_find_no_problem(paths, flavour, root, fast_names) -> None:
    etree.XMLSchema(etree.parse(_SCHEMA)).assertValid(root)
    assert validate_fmu(str(paths[flavour])) == []


def test_c01_elements_stand_in_the_order_of_the_standard(root) -> None:
    assert [child.tag for child in root] == [tag for tag in _ORDER if root.find(tag) is not None]
    assert {"CoSimulation", "LogCategories", "DefaultExperiment"} <= {child.tag for child in root}


def test_c02_root_says_what_it_is_by_whom_and_under_which_terms(model, root) -> None:
    assert root.get("fmiVersion") == "2.0"
    assert root.get("modelName") == model.name
    assert re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", root.get("guid"))
    assert root.get("description") == model.summary
    assert root.get("version") == __version__
    assert __version__ in root.get("generationTool")
    assert root.get("license") == "Apache-2.0"
    assert root.get("copyright").startswith("Copyright 20")
    assert root.get("author")
    assert re.fullmatch(r"\d{4}(-\d\d){2}T\d\d:\d\d:\d\dZ", root.get("generationDateAndTime"))
    assert root.get("variableNamingConvention") == "structured"
    assert root.get("numberOfEventIndicators", "0") == "0"


def test_c03_capabilities_are_those_that_are_tested(model, root, flavour) -> None:
    simulation = root.find("CoSimulation")
    assert simulation.get("modelIdentifier") == model.name
    assert re.fullmatch(_IDENTIFIER, model.name, re.ASCII)
    said = {name: value for name, value in simulation.attrib.items() if name[0] in "cnp"}
    always = {
        "canHandleVariableCommunicationStepSize",
        "canGetAndSetFMUstate",
        "canSerializeFMUstate",
        "canNotUseMemoryManagementFunctions",
    }
    also = {"native": {"providesDirectionalDerivative"}, "python": {"needsExecutionTool"}}[flavour]
    if not model.derivatives:
        also -= {"providesDirectionalDerivative"}
    # Each of them has its tests beside this file; what nobody tests must not be claimed.
    assert {name for name, value in said.items() if value == "true"} == always | also


def test_c04_units_are_defined_once_by_their_dimension(root, variables) -> None:
    units = root.findall("UnitDefinitions/Unit")
    names = [unit.get("name") for unit in units]
    used = {typed.get("unit") for _, typed in variables} - {None}
    assert len(set(names)) == len(names)
    assert set(names) == used
    for unit in units:
        base = unit.find("BaseUnit")
        wanted = base_exponents(unit.get("name"))
        assert (base is None) == (wanted is None)
        if base is not None:
            assert {key: int(base.get(key)) for key in BASE if base.get(key)} == wanted
            assert float(base.get("factor", "1")) == 1
            assert float(base.get("offset", "0")) == OFFSETS.get(unit.get("name"), 0)
        shown = [display.get("name") for display in unit.findall("DisplayUnit")]
        assert len(set(shown)) == len(shown)
        assert all(float(d.get("factor", "1")) > 0 for d in unit.findall("DisplayUnit"))


def test_c04_display_units_belong_to_the_unit(root, variables) -> None:
    shown = {
        unit.get("name"): [d.get("name") for d in unit.findall("DisplayUnit")]
        for unit in root.findall("UnitDefinitions/Unit")
    }
    for node, typed in variables:
        if typed.get("displayUnit"):
            assert typed.get("displayUnit") in shown[typed.get("unit")], node.get("name")
        if typed.get("unit") == "rad":
            assert typed.get("displayUnit") == "deg"


def test_c05_types_are_not_declared_beside_the_variables(root, variables) -> None:
    assert root.find("TypeDefinitions") is None
    assert not any(typed.get("declaredType") for _, typed in variables)


def test_c06_log_categories_are_standard_and_the_ones_declared(root) -> None:
    names = [category.get("name") for category in root.findall("LogCategories/Category")]
    assert names == list(LOG_CATEGORIES)
    assert len(set(names)) == len(names)
    assert set(names) <= _STANDARD_CATEGORIES


def test_c07_default_experiment_steps_by_the_sample_period(model, root) -> None:
    experiment = root.find("DefaultExperiment")
    start, stop, step = (
        float(experiment.get(name)) for name in ("startTime", "stopTime", "stepSize")
    )
    assert step == model.sample_period
    assert start < stop
    assert step < stop - start
    assert float(experiment.get("tolerance", "0")) >= 0


def test_c08_names_are_unique_legal_and_flat_on_ports(variables) -> None:
    names = [node.get("name") for node, _ in variables]
    assert len(set(names)) == len(names)
    for node, _ in variables:
        flat = node.get("causality") in ("input", "output")
        pattern = re.compile(_IDENTIFIER + "$", re.ASCII) if flat else _STRUCTURED
        assert pattern.match(node.get("name")), node.get("name")


def test_c08_array_indices_are_contiguous_from_one(variables) -> None:
    indices: dict[str, list[tuple[int, ...]]] = {}
    for node, _ in variables:
        found = re.fullmatch(r"(.+)\[([\d,]+)\]", node.get("name"))
        if found:
            index = tuple(map(int, found[2].split(",")))
            indices.setdefault(found[1], []).append(index)
    for name, found in indices.items():
        shape = np.max(found, axis=0)
        assert len(set(found)) == len(found) == math.prod(shape), name
        assert np.min(found) == 1, name


def test_c09_causality_variability_initial_and_start_are_legal(variables) -> None:
    for node, typed in variables:
        said = (node.get("causality"), node.get("variability"), node.get("initial"))
        assert (*said, typed.get("start") is not None) in _LEGAL, node.get("name")
        assert not set(node.attrib) & {"canHandleMultipleSetPerTimeInstant"}
        assert not set(typed.attrib) & {"derivative", "reinit"}


def test_c10_limits_and_starts_are_finite_ordered_and_exact(model, variables) -> None:
    scalars = [s for group in model.variables.values() for s in group if s.field.listed]
    for (node, typed), scalar in zip(variables, scalars, strict=True):
        name, field = node.get("name"), scalar.field
        if typed.tag == "Boolean":
            assert typed.get("start") in (None, "true", "false")
            continue
        said = {key: float(typed.get(key)) for key in ("min", "max", "start") if typed.get(key)}
        assert all(map(math.isfinite, said.values())), name
        low, high = said.get("min", -math.inf), said.get("max", math.inf)
        assert (low, high) == (field.min, field.max), name
        assert low < high, name
        if "start" in said:
            # To the last bit.
            assert said["start"] == scalar.start, name
            assert low <= said["start"] <= high, name
        assert float(typed.get("nominal", "1")) > 0, name


def test_c10_start_values_are_those_compiled_in(start, flavour) -> None:
    """Nothing is set; all is read in initialisation mode."""
    instance = start(flavour)
    instance.fmu.reset()
    instance.fmu.setupExperiment(startTime=0.0)
    instance.fmu.enterInitializationMode()
    values = instance.values()
    for variable, value in zip(instance.variables, values, strict=True):
        if variable.start is not None:
            said = {"true": 1.0, "false": 0.0}.get(variable.start)
            assert value == (float(variable.start) if said is None else said), variable.name
    assert np.isfinite(values).all()


def test_c11_no_two_variables_share_a_value_reference_of_their_type(variables) -> None:
    keys = [(typed.tag, node.get("valueReference")) for node, typed in variables]
    assert len(set(keys)) == len(keys)


def test_c12_structure_lists_all_unknowns_in_order(root, variables) -> None:
    structure = root.find("ModelStructure")
    assert [child.tag for child in structure] == ["Outputs", "InitialUnknowns"]
    outputs = [int(u.get("index")) for u in structure.find("Outputs")]
    assert outputs == _of(variables, "output")
    initial = [int(u.get("index")) for u in structure.find("InitialUnknowns")]
    assert initial == _of(variables, "calculatedParameter", "output")


def test_c12_dependencies_are_ascending_knowns_with_a_kind_each(root, variables) -> None:
    inputs = set(_of(variables, "input"))
    knowns = {"Outputs": inputs, "InitialUnknowns": inputs | set(_of(variables, "parameter"))}
    for tag, known in knowns.items():
        for unknown in root.find(f"ModelStructure/{tag}"):
            # Present even where empty: a missing attribute would mean "on everything".
            dependencies = [int(index) for index in unknown.get("dependencies").split()]
            assert dependencies == sorted(set(dependencies))
            assert set(dependencies) <= known
            kinds = unknown.get("dependenciesKind").split()
            assert kinds == ["dependent"] * len(dependencies)


def _declared(root, tag: str) -> dict[int, set[int]]:
    return {
        int(unknown.get("index")): {int(index) for index in unknown.get("dependencies").split()}
        for unknown in root.find(f"ModelStructure/{tag}")
    }


def test_c12_outputs_change_with_no_other_inputs_over_a_step(root, start, inputs) -> None:
    """From three states, every input in turn is moved a little and a lot."""
    declared = _declared(root, "Outputs")
    rng = np.random.default_rng(7)
    instance = start()
    ports = [(i, v) for i, v in enumerate(instance.variables, 1) if v.causality == "input"]
    for k in range(120):
        instance.apply(inputs(k))
        if k % 50 == 17:
            here, time = instance.fmu.getFMUState(), instance.time
            instance.step()
            rest = instance.values()
            for index, variable in ports:
                low, high = float(variable.min or -1e3), float(variable.max or 1e3)
                held = rest[index - 1]
                tries = [held + 1e-6 * (high - low), rng.uniform(low, high), rng.uniform(low, high)]
                for value in (
                    [1 - held] if variable.type == "Boolean" else np.clip(tries, low, high)
                ):
                    instance.fmu.setFMUState(here)
                    instance.time = time
                    instance.set(variable, value)
                    instance.step()
                    moved = np.flatnonzero(instance.values() != rest) + 1
                    for output in set(moved.tolist()) & set(declared):
                        assert index in declared[output], (variable.name, output)
            instance.fmu.setFMUState(here)
            instance.fmu.freeFMUState(here)
            instance.time = time
        instance.step()


def test_c12_initial_values_change_with_no_other_knowns(root, start) -> None:
    """Every parameter and input in turn is moved, and all is read in initialisation mode."""
    declared = _declared(root, "InitialUnknowns")
    instance = start()

    def initial(variable=None, value: float = 0.0) -> np.ndarray:
        instance.fmu.reset()
        instance.fmu.setupExperiment(startTime=0.0)
        if variable is not None:
            instance.set(variable, value)
        instance.fmu.enterInitializationMode()
        return instance.values()

    rest = initial()
    for index, variable in enumerate(instance.variables, 1):
        if variable.causality not in ("parameter", "input"):
            continue
        held = rest[index - 1]
        up = float(variable.max or math.inf) - held
        down = held - float(variable.min or -math.inf)
        if variable.type == "Boolean":
            step = 1 - 2 * held
        else:
            size = 1e-3 * abs(held) + 1e-6 if variable.type == "Real" else 1.0
            step = min(size, up) if up >= down else -min(size, down)
        moved = initial(variable, held + step)
        assert moved[index - 1] != held
        for unknown in set((np.flatnonzero(moved != rest) + 1).tolist()) & set(declared):
            assert index in declared[unknown], (variable.name, unknown)


def test_c13_every_variable_has_a_description_and_physical_ones_a_unit(model, variables) -> None:
    scalars = [s for group in model.variables.values() for s in group if s.field.listed]
    for (node, typed), scalar in zip(variables, scalars, strict=True):
        assert node.get("description").strip(), node.get("name")
        assert node.get("description").isprintable(), node.get("name")
        assert typed.get("unit") == (scalar.field.unit if typed.tag == "Real" else None)
