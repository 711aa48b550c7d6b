"""`modelDescription.xml` of a model, from its records.

Value references number the variables through the groups of `Model.variables`; the C shell and the
Python slave use the same numbers. The GUID is a hash of this text and of the C sources.
"""

import hashlib
import uuid
from collections.abc import Mapping

import casadi as ca
import numpy as np
from lxml import etree

from fmu_src import RELEASED, __version__
from fmu_src.kit.model import Model
from fmu_src.kit.records import Scalar
from fmu_src.kit.units import OFFSETS, base_exponents

LICENSE = "Apache-2.0"
COPYRIGHT = f"Copyright {RELEASED[:4]} the authors of Steadytip"
DEFAULT_SAMPLES = 1000
"""Samples of the default experiment, which the reference results are of."""
DISPLAY_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"um": 1e6, "mm": 1e3},
    "m/s": {"mm/s": 1e3},
    "rad": {"deg": 180 / np.pi},
    "rad/s": {"deg/s": 180 / np.pi},
    "rad/s2": {"deg/s2": 180 / np.pi},
    "T": {"uT": 1e6},
}
"""What people read instead of a unit, with the factor from it; the first is shown by default."""
LOG_CATEGORIES = {
    "logStatusWarning": "Parameters that the model goes on with, but should not have.",
    "logStatusDiscard": "Values that were refused and not taken.",
    "logStatusError": "Calls that could not be carried out.",
    "logAll": "All messages.",
}
_PLACEHOLDER = "guid"


def describe(model: Model, guid: str, capabilities: Mapping[str, str], sources: list[str]) -> bytes:
    """Write the model description.

    Args:
        model: what to describe.
        guid: as compiled into the binary.
        capabilities: attributes of `CoSimulation` in which flavours differ.
        sources: source files to list, in order of compilation.
    """
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=guid,
        description=model.summary,
        author="Steadytip",
        version=__version__,
        copyright=COPYRIGHT,
        license=LICENSE,
        generationTool=f"Steadytip {__version__}",
        generationDateAndTime=RELEASED,
        variableNamingConvention="structured",
    )
    simulation = etree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        **capabilities,
    )
    if sources:
        files = etree.SubElement(simulation, "SourceFiles")
        for name in sources:
            etree.SubElement(files, "File", name=name)
    _units(root, model)
    categories = etree.SubElement(root, "LogCategories")
    for name, sentence in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=sentence)
    etree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(DEFAULT_SAMPLES * model.sample_period),
        stepSize=repr(model.sample_period),
    )
    variables = etree.SubElement(root, "ModelVariables")
    reference = 0
    for causality, scalars in model.variables.items():
        for scalar in scalars:
            if scalar.field.listed:
                _variable(variables, scalar, reference, causality)
            reference += 1
    _structure(root, model)
    return to_xml(root)


def to_xml(root: etree._Element) -> bytes:
    """Return a document as indented UTF-8 text."""
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def content_guid(model: Model, texts: Mapping[str, str]) -> str:
    """Compute a GUID that changes with all that makes the FMU: variables, equations, shell."""
    digest = hashlib.sha256(describe(model, _PLACEHOLDER, {}, []))
    for name in sorted(texts):
        digest.update(f"\n{name}\n{texts[name]}".encode())
    return "{" + str(uuid.UUID(bytes=digest.digest()[:16])) + "}"


def _units(root: etree._Element, model: Model) -> None:
    used = sorted(
        {
            scalar.field.unit
            for group in model.variables.values()
            for scalar in group
            if scalar.field.listed and scalar.field.unit
        }
    )
    if not used:
        return
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name in used:
        unit = etree.SubElement(definitions, "Unit", name=name)
        exponents = base_exponents(name)
        if exponents is not None:
            base = {symbol: str(power) for symbol, power in exponents.items()}
            base |= {"offset": repr(OFFSETS[name])} if name in OFFSETS else {}
            etree.SubElement(unit, "BaseUnit", **base)
        for other, factor in DISPLAY_UNITS.get(name, {}).items():
            etree.SubElement(unit, "DisplayUnit", name=other, factor=repr(factor))


def _variable(parent: etree._Element, scalar: Scalar, reference: int, causality: str) -> None:
    field = scalar.field
    attributes = {
        "name": scalar.name,
        "valueReference": str(reference),
        "description": field.description,
        "causality": causality,
        "variability": "discrete",
    }
    if causality == "parameter":
        attributes["variability"] = "tunable" if field.tunable else "fixed"
        attributes["initial"] = "exact"
    elif causality == "calculatedParameter":
        attributes["variability"] = "tunable"
        attributes["initial"] = "calculated"
    elif causality != "input":
        attributes["initial"] = "calculated"
    node = etree.SubElement(parent, "ScalarVariable", **attributes)
    typed = etree.SubElement(node, field.kind)
    if field.unit and field.kind == "Real":
        typed.set("unit", field.unit)
        # Parameters measure the instrument, in metres; what moves does so by micrometres.
        if field.unit in DISPLAY_UNITS and (field.unit != "m" or "arameter" not in causality):
            typed.set("displayUnit", next(iter(DISPLAY_UNITS[field.unit])))
    if field.kind != "Boolean":
        for bound, value in (("min", field.min), ("max", field.max)):
            if np.isfinite(value):
                typed.set(bound, _literal(field.kind, value))
    if causality in ("parameter", "input"):
        typed.set("start", _literal(field.kind, scalar.start))


def _literal(kind: str, value: float) -> str:
    if kind == "Real":
        return repr(float(value))
    return str(int(value)) if kind == "Integer" else str(bool(value)).lower()


def _structure(root: etree._Element, model: Model) -> None:
    """Add outputs and initial unknowns with the dependencies that the functions really have.

    Those of the outputs hold over a step of one sample: on an input that only moves the state, an
    output depends from the next sample on. Noise makes outputs depend on the seed.
    """
    groups = model.variables
    counts = [len(groups[name]) for name in ("parameter", "calculatedParameter", "input")]
    first_derived, first_input = counts[0] + 1, sum(counts[:2]) + 1
    first_output = sum(counts) + 1
    of_inputs = _rows(model.step_function.jac_sparsity(1, 2), first_input)
    of_parameters = _rows(model.step_function.jac_sparsity(1, 0), 1)
    through_derived = _rows(model.step_function.jac_sparsity(1, 1), first_derived)
    derived_of = _rows(model.derive_function.jac_sparsity(0, 0), 1)
    of_draws = _rows(model.step_function.jac_sparsity(1, 4), 0)
    seeds = [seed + 1 for seed, count in model.noise_streams for _ in range(count)]

    structure = etree.SubElement(root, "ModelStructure")
    if groups["output"]:
        outputs = etree.SubElement(structure, "Outputs")
        for row in range(len(groups["output"])):
            _unknown(outputs, first_output + row, of_inputs[row])
    if counts[1] or groups["output"]:
        initial = etree.SubElement(structure, "InitialUnknowns")
        for row in range(counts[1]):
            _unknown(initial, first_derived + row, derived_of[row])
        for row in range(len(groups["output"])):
            indirect = {p for d in through_derived[row] for p in derived_of[d - first_derived]}
            known = {*of_inputs[row], *of_parameters[row], *indirect}
            known |= {seeds[draw] for draw in of_draws[row]}
            _unknown(initial, first_output + row, sorted(known))


def _rows(sparsity: ca.Sparsity, first: int) -> list[list[int]]:
    """Return the column indices of the non-zeros of each row, counted from `first`."""
    found: list[list[int]] = [[] for _ in range(sparsity.size1())]
    rows, columns = sparsity.get_triplet()
    for row, column in zip(rows, columns, strict=True):
        found[row].append(first + column)
    return [sorted(row) for row in found]


def _unknown(parent: etree._Element, index: int, dependencies: list[int]) -> None:
    kinds = " ".join(["dependent"] * len(dependencies))
    etree.SubElement(
        parent,
        "Unknown",
        index=str(index),
        dependencies=" ".join(map(str, dependencies)),
        dependenciesKind=kinds,
    )
