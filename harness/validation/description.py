"""The description: items C1 to C13, as far as the archive's XML alone tells."""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import datetime

from harness.validation.checks import FILES, Failure, Note, Skip
from harness.validation.files import DESCRIPTION, VERSION, Fmu
from harness.validation.variables import TRUE

_LEGAL: dict[tuple[str, str], set[str | None]] = {
    ("parameter", "fixed"): {"exact"},
    ("parameter", "tunable"): {"exact"},
    ("calculatedParameter", "fixed"): {"calculated", "approx"},
    ("calculatedParameter", "tunable"): {"calculated", "approx"},
    ("input", "discrete"): {None},
    ("input", "continuous"): {None},
    ("output", "constant"): {"exact"},
    ("output", "discrete"): {"calculated", "exact", "approx"},
    ("output", "continuous"): {"calculated", "exact", "approx"},
    ("local", "constant"): {"exact"},
    ("local", "fixed"): {"calculated", "approx"},
    ("local", "tunable"): {"calculated", "approx"},
    ("local", "discrete"): {"calculated", "exact", "approx"},
    ("local", "continuous"): {"calculated", "exact", "approx"},
    ("independent", "continuous"): {None},
}
"""`initial` by causality and variability (FMI 2.0.5, 2.2.7)."""
_CATEGORIES = {
    *("logEvents", "logSingularLinearSystems", "logNonlinearSystems", "logDynamicStateSelection"),
    *("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal"),
    *("logStatusPending", "logAll"),
}
_SINGLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@FILES.check("C1.schema", "error", "the description keeps to the schema of FMI 2.0")
def _schema(fmu: Fmu) -> Iterator[str]:
    version = fmu.parsed().get("fmiVersion")
    if version != VERSION:
        raise Failure(f"fmiVersion is {version}; only FMI {VERSION} is checked here")
    yield from _judged_by_fmpy(fmu, structure=False)


@FILES.check(
    "C1.rules", "error", "names, start values and structure keep the rules that fmpy knows"
)
def _rules(fmu: Fmu) -> Iterator[str]:
    fmu.simulation  # noqa: B018 - skips where there is none
    if not list(_judged_by_fmpy(fmu, structure=False)):
        yield from _judged_by_fmpy(fmu, structure=True)


def _judged_by_fmpy(fmu: Fmu, structure: bool) -> Iterator[str]:
    from fmpy import read_model_description
    from fmpy.model_description import ValidationError

    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as archive:
        archive.writestr(DESCRIPTION, fmu.content(DESCRIPTION))
    memory.seek(0)
    try:
        read_model_description(
            memory, validate_variable_names=structure, validate_model_structure=structure
        )
    except ValidationError as error:
        yield from error.problems
    except Exception as error:  # fmpy and lxml raise a dozen kinds here
        yield f"fmpy cannot read it: {error}"


@FILES.check("C2.identity", "warning", "the description says what the model is, and who made it")
def _identity(fmu: Fmu) -> Iterator[str]:
    for name in (
        *("description", "author", "version", "copyright", "license", "generationTool"),
        "variableNamingConvention",
    ):
        if not fmu.root.get(name):
            yield f"attribute {name} is missing"
    date = fmu.root.get("generationDateAndTime", "")
    try:
        datetime.fromisoformat(date)
        good = bool(_DATE.fullmatch(date))
    except ValueError:
        good = False
    if not good:
        yield f"generationDateAndTime = '{date}' should read as 2026-01-31T12:00:00Z"


@FILES.check("C2.event_indicators", "warning", "a co-simulation FMU counts no event indicators")
def _event_indicators(fmu: Fmu) -> Iterator[str]:
    if fmu.root.find("ModelExchange") is not None:
        raise Skip("the FMU is for model exchange, too")
    if fmu.root.get("numberOfEventIndicators", "0").strip() != "0":
        yield f"numberOfEventIndicators = {fmu.root.get('numberOfEventIndicators')}; leave it out"


@FILES.check("C3.capabilities", "error", "capabilities do not contradict each other")
def _capabilities(fmu: Fmu) -> Iterator[str]:
    if fmu.flag("canSerializeFMUstate") and not fmu.flag("canGetAndSetFMUstate"):
        yield "canSerializeFMUstate needs canGetAndSetFMUstate"


@FILES.check("C3.drop_in", "warning", "the FMU claims what a host hopes for")
def _drop_in(fmu: Fmu) -> Iterator[str]:
    for name, wanted in (
        *(("needsExecutionTool", False), ("canRunAsynchronuously", False)),
        *(("canBeInstantiatedOnlyOncePerProcess", False), ("canGetAndSetFMUstate", True)),
        ("canSerializeFMUstate", True),
    ):
        if fmu.flag(name) != wanted:
            yield f"{name} is {str(not wanted).lower()}"


@FILES.check("C4.units", "error", "units are defined once, with sound exponents and factors")
def _units(fmu: Fmu) -> Iterator[str]:
    names = [unit.get("name") for unit in fmu.root.iterfind("UnitDefinitions/Unit")]
    for name, count in _repeated(names):
        yield f"unit '{name}' is defined {count} times"
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        shown = [display.get("name") for display in unit.iterfind("DisplayUnit")]
        for name, count in _repeated(shown):
            yield f"display unit '{name}' of '{unit.get('name')}' is defined {count} times"
        for element in (*unit.iterfind("BaseUnit"), *unit.iterfind("DisplayUnit")):
            try:
                factor = float(element.get("factor", "1"))
            except ValueError:
                continue
            if factor == 0.0 or not math.isfinite(factor):
                yield f"the factor of '{element.get('name') or unit.get('name')}' is {factor}"
    for scalar in fmu.scalars:
        unit, shown_unit = scalar.inherited("unit"), scalar.inherited("displayUnit")
        if scalar.type == "Real" and unit is not None and unit not in names:
            yield f"unit '{unit}' of '{scalar.name}' is not defined"
        if shown_unit and not unit:
            yield f"'{scalar.name}' has a displayUnit, but no unit"


@FILES.check("C4.base_units", "warning", "every unit says what it is made of, and is used")
def _base_units(fmu: Fmu) -> Iterator[str]:
    used = {scalar.inherited("unit") for scalar in fmu.scalars}
    made: dict[str, tuple[str | None, ...]] = {}
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        name, base = unit.get("name", ""), unit.find("BaseUnit")
        if base is None:
            yield f"unit '{name}' has no BaseUnit, so that importers cannot compare it"
        else:
            made[name] = tuple(base.get(part, "0") for part in _BASE)
        if name not in used:
            yield f"unit '{name}' is not used"
    if not made and not used - {None}:
        raise Skip("there are no units")


@FILES.check("C5.types", "error", "declared types exist, fit, and have names of their own")
def _types(fmu: Fmu) -> Iterator[str]:
    scalars = fmu.scalars
    names = [t.get("name") for t in fmu.root.iterfind("TypeDefinitions/SimpleType")]
    for name, count in _repeated(names):
        yield f"type '{name}' is declared {count} times"
    variables = {scalar.name for scalar in scalars}
    for name in sorted(variables & set(names)):
        yield f"'{name}' is both a type and a variable"
    for scalar in scalars:
        declared = scalar.typed.get("declaredType")
        if declared is None:
            continue
        if scalar.declared is None:
            yield f"the type '{declared}' of '{scalar.name}' does not exist"
        elif scalar.declared.tag != scalar.type:
            yield f"'{scalar.name}' is {scalar.type}, its type '{declared}' {scalar.declared.tag}"
    for name, typed in fmu.types.items():
        items = [item.get("value") for item in typed.iterfind("Item")]
        if len(set(items)) != len(items):
            yield f"two items of the enumeration '{name}' have one value"


@FILES.check("C6.categories", "error", "log categories are unique")
def _categories(fmu: Fmu) -> Iterator[str]:
    names = [c.get("name") for c in fmu.root.iterfind("LogCategories/Category")]
    for name, count in _repeated(names):
        yield f"log category '{name}' is declared {count} times"


@FILES.check("C6.standard", "warning", "log categories are declared and have the standard's names")
def _standard_categories(fmu: Fmu) -> Iterator[str]:
    names = {c.get("name") for c in fmu.root.iterfind("LogCategories/Category")}
    if not names:
        yield "there are no LogCategories, so a host cannot choose what it hears"
    for name in sorted(names - _CATEGORIES):
        yield f"log category '{name}' is not one of the standard's"


@FILES.check("C7.experiment", "warning", "the default experiment is there and in order")
def _experiment(fmu: Fmu) -> Iterator[str]:
    start, stop, step, tolerance = (
        fmu.experiment(name) for name in ("startTime", "stopTime", "stepSize", "tolerance")
    )
    if step is None:
        yield "DefaultExperiment has no stepSize, so a host has to guess the sample period"
    elif step <= 0.0:
        yield f"stepSize = {step:g} s"
    if stop is not None and stop <= (start or 0.0):
        yield f"stopTime = {stop:g} s is not after startTime = {start or 0.0:g} s"
    elif stop is not None and step is not None and step >= stop - (start or 0.0):
        yield f"stepSize = {step:g} s is not less than the whole experiment"
    if tolerance is not None and tolerance < 0.0:
        yield f"tolerance = {tolerance:g}"


@FILES.check("C8.unique", "error", "names of variables are unique")
def _unique(fmu: Fmu) -> Iterator[str]:
    for name, count in _repeated(scalar.name for scalar in fmu.scalars):
        yield f"{count} variables are called '{name}'"


@FILES.check("C8.ports", "warning", "inputs and outputs are single identifiers")
def _ports(fmu: Fmu) -> Iterator[str]:
    for scalar in fmu.scalars:
        if scalar.causality in {"input", "output"} and not _SINGLE.fullmatch(scalar.name):
            yield f"{scalar.causality} '{scalar.name}' becomes a bus or a renamed port in Simulink"


@FILES.check("C8.arrays", "warning", "array indices run from 1 without gaps")
def _arrays(fmu: Fmu) -> Iterator[str]:
    arrays: dict[str, list[int]] = {}
    for scalar in fmu.scalars:
        found = re.fullmatch(r"(.*)\[(\d+)\]", scalar.name)
        if found:
            arrays.setdefault(found[1], []).append(int(found[2]))
    for name, indices in arrays.items():
        if sorted(indices) != list(range(1, len(indices) + 1)):
            yield f"'{name}' has the indices {sorted(indices)[:6]}"


@FILES.check("C9.legal", "error", "causality, variability, initial and start go together")
def _legal(fmu: Fmu) -> Iterator[str]:
    independent = 0
    for scalar in fmu.scalars:
        pair, initial = (scalar.causality, scalar.variability), scalar.initial
        has_start = scalar.typed.get("start") is not None
        independent += scalar.causality == "independent"
        if pair not in _LEGAL or initial not in _LEGAL[pair]:
            yield f"'{scalar.name}': {pair[0]}, {pair[1]}, initial {initial} is not allowed"
        elif scalar.element.get("initial") and scalar.causality in {"input", "independent"}:
            yield f"'{scalar.name}': an {scalar.causality} has no 'initial'"
        needs = initial in {"exact", "approx"} or scalar.causality == "input"
        if needs and not has_start:
            yield f"'{scalar.name}' needs a start value"
        if has_start and not needs:
            yield f"'{scalar.name}' must not have a start value"
        if scalar.variability == "continuous" and scalar.type != "Real":
            yield f"'{scalar.name}' is {scalar.type} and cannot be continuous"
        if scalar.typed.get("derivative") and scalar.type != "Real":
            yield f"'{scalar.name}' is {scalar.type} and cannot be a derivative"
    if independent > 1:
        yield f"{independent} variables are independent"


@FILES.check("C9.model_exchange_only", "warning", "attributes of model exchange are left out")
def _model_exchange_only(fmu: Fmu) -> Iterator[str]:
    if fmu.root.find("ModelExchange") is not None:
        raise Skip("the FMU is for model exchange, too")
    for scalar in fmu.scalars:
        if scalar.element.get("canHandleMultipleSetPerTimeInstant") is not None:
            yield f"'{scalar.name}' has canHandleMultipleSetPerTimeInstant"
        if scalar.typed.get("reinit", "false") in TRUE:
            yield f"'{scalar.name}' has reinit"


@FILES.check("C10.limits", "error", "min <= start <= max, all of them finite numbers")
def _limits(fmu: Fmu) -> Iterator[str]:
    for scalar in fmu.scalars:
        if scalar.type not in {"Real", "Integer", "Enumeration"}:
            continue
        low, high = scalar.number("min", -math.inf), scalar.number("max", math.inf)
        if not low <= high:
            yield f"'{scalar.name}': min = {low:g}, max = {high:g}"
        start = scalar.start
        if start is not None and not (math.isfinite(start) and low <= start <= high):
            yield f"'{scalar.name}' starts at {start!r}, outside [{low:g}, {high:g}]"
        nominal = scalar.inherited("nominal")
        if nominal is not None and not 0.0 < scalar.number("nominal", 0.0) < math.inf:
            yield f"'{scalar.name}': nominal = {nominal} has to be positive"


@FILES.check("C11.aliases", "error", "at most one alias can be set; all have one unit and start")
def _aliases(fmu: Fmu) -> Iterator[str]:
    scalars = fmu.scalars
    sets: dict[tuple[str, str | None], list[str]] = {}
    by_name = {scalar.name: scalar for scalar in scalars}
    for scalar in scalars:
        sets.setdefault((scalar.type, scalar.element.get("valueReference")), []).append(scalar.name)
    for names in sets.values():
        if len(names) < 2:
            continue
        group = [by_name[name] for name in names]
        shown = ", ".join(names[:4])
        if sum(s.causality in {"parameter", "input"} for s in group) > 1:
            yield f"the aliases {shown} can be set more than once"
        if len({s.inherited("unit") for s in group}) > 1:
            yield f"the aliases {shown} have different units"
        if sum(s.typed.get("start") is not None for s in group) > 1 and (
            group[0].variability != "constant"
        ):
            yield f"the aliases {shown} have more than one start value"


@FILES.check("C13.descriptions", "warning", "every variable has a description")
def _descriptions(fmu: Fmu) -> Iterator[str]:
    lacking = [s.name for s in fmu.scalars if not s.element.get("description")]
    if lacking:
        yield f"{len(lacking)} variables have none: {', '.join(lacking[:6])}"
    for element in fmu.root.iter():
        if "\N{REPLACEMENT CHARACTER}" in "".join(element.attrib.values()):
            yield f"line {element.sourceline}: a character was lost in some encoding"
    yield Note(f"{len(fmu.scalars)} variables")


def _repeated(names: Iterable[str]) -> Iterator[tuple[str, int]]:
    """Yield the names that stand there more than once, and how often."""
    return ((name, count) for name, count in Counter(names).items() if count > 1)
