"""C sources of a model: the recorded functions and the table of its variables.

Together with `shell.c` they are the whole FMU: `fmu.c` includes the other three.
"""

import math
import re
import tempfile
from collections import Counter
from collections.abc import Collection
from functools import cache, partial
from pathlib import Path
from typing import Any

import casadi as ca

from fmu_src.kit import Model
from fmu_src.kit.model import symbols_in
from fmu_src.kit.records import Field, Scalar

ENTRY = "fmu.c"
SINGLE_PRECISION = "STEADYTIP_FLOAT"
"""Preprocessor symbol for microcontrollers: everything but time in `float`."""
_ENTRY_TEXT = f"""\
/* All of the FMU in one translation unit. */
#if defined({SINGLE_PRECISION})
#include <tgmath.h>
typedef float Real;
#else
#include <math.h>
typedef double Real;
#endif
#define casadi_real Real
#include "functions.c"
#include "shell.c"
"""
# Parts of CasADi's text: an exported function with its body, a sparsity pattern, a function's head.
_EXPORTED = re.compile(
    r"^CASADI_SYMBOL_EXPORT [^;{]*?(\w+)\([^;{]*\) ?\{([^\n]*\}|.*?\n\})\n", re.M | re.S
)
_PATTERN = re.compile(r"^(static const casadi_int |#define )(casadi_s\d+)\b.*\n", re.M)
_NAME = re.compile(r"\bcasadi_s\d+\b")
_HEAD = re.compile(r"^(.*\(const casadi_real\*\* arg, casadi_real\*\* res, .*\) ?\{\n)", re.M)
_UNUSED = "  (void)arg; (void)res; (void)iw; (void)w; (void)mem;\n"


LONG_SLOPE = 100_000
"""Characters of C beyond which a slope is compiled as it is written."""
_OPTIMISE = """
#ifdef __clang__
#pragma clang optimize {}
#endif
"""


@cache
def shell() -> str:
    """Source text of the FMI shell."""
    return (Path(__file__).parent / "shell.c").read_text(encoding="utf-8")


@cache
def _called(model: Model) -> dict[str, ca.Function]:
    """What the shell calls, under the names that it has in C."""
    found = {}
    for name, function in (
        ("step", model.step_function),
        ("derive", model.derive_function),
        ("slope", model.slope_function),
    ):
        # Never plain `step`: glibc exports a function of that name.
        called = f"{model.name}_{name}"
        arguments = symbols_in(function)
        found[called] = ca.Function(called, arguments, function.call(arguments, True, False))
    return found


def functions(model: Model) -> str:
    """C99 of what the shell calls, with the operation counts in front.

    CasADi writes more than that: sparsity patterns, and functions that tell of them. They are left
    out, so that no compiler complains of unused ones.
    """
    called = _called(model)
    options: Any = {"casadi_int": "int", "with_header": False}
    generator = ca.CodeGenerator("functions.c", options)
    for function in called.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        text = (Path(folder) / "functions.c").read_text(encoding="utf-8")
    text = _EXPORTED.sub(lambda found: _kept(found, called), text)
    text = _HEAD.sub(rf"\1{_UNUSED}", text)
    # Some patterns name others, as a macro; what nothing names goes.
    while (short := _PATTERN.sub(partial(_named, Counter(_NAME.findall(text))), text)) != text:
        text = short
    text = _quick_to_compile(text, list(called))
    counts = [f" * {name}: {f.n_instructions()} operations" for name, f in called.items()]
    title = "/* Generated from the recorded model; do not edit."
    return "\n".join([title, *counts, " */", text])


def _quick_to_compile(text: str, names: list[str]) -> str:
    """The same, what only the slope needs left as it is written, where that is long.

    An optimiser takes most of a long model's time for derivatives that few importers ask for.
    """
    others = max(text.find(f"int {name}(") for name in names[:-1])
    end = text.find("\n}\n", others) + len("\n}\n")
    if len(text) - end < LONG_SLOPE:
        return text
    off, on = map(_OPTIMISE.format, ("off", "on"))
    return f"{text[:end]}{off}{text[end:]}{on}"


def _named(times: Counter[str], found: re.Match[str]) -> str:
    """The definition of a sparsity pattern if its name stands elsewhere, too; else nothing."""
    return found[0] if times[found[2]] > 1 else ""


def _kept(found: re.Match[str], names: Collection[str]) -> str:
    return found[0].replace("CASADI_SYMBOL_EXPORT", "static") if found[1] in names else ""


def _is_loose(field: Field) -> bool:
    return not field.listed and field.min == -math.inf and field.max == math.inf


def header(model: Model, guid: str) -> str:
    """`model.h`: sizes, names and the table of variables in the order of the value references."""
    groups = model.variables
    sizes = {
        letter: len(groups[causality])
        for letter, causality in zip(
            "PDUYX", ("parameter", "calculatedParameter", "input", "output", "local"), strict=True
        )
    }
    called = _called(model).values()
    work = {
        "SZ_ARG": max(f.sz_arg() for f in called),
        "SZ_RES": max(f.sz_res() for f in called),
        "SZ_IW": max(f.sz_iw() for f in called),
        "SZ_W": max(f.sz_w() for f in called),
    }
    names = [scalar.name for scalar in groups["parameter"]]
    every = [scalar.field for group in groups.values() for scalar in group]
    loose = len(every)  # from here on there is only memory that nobody sees, without limits
    while loose and _is_loose(every[loose - 1]):
        loose -= 1
    lines = [
        "/* Generated from the model's records; do not edit. */",
        "#include <float.h>",
        f'#define MODEL_GUID "{guid}"',
        f"#define MODEL_PERIOD {model.sample_period!r}",
        f"#define MODEL_STEP {model.name}_step",
        f"#define MODEL_DERIVE {model.name}_derive",
        f"#define MODEL_SLOPE {model.name}_slope",
        *(f"#define N_{letter} {size}" for letter, size in sizes.items()),
        f"#define N_R {model.draws}",
        f"#define AT_LOOSE {loose}",
        *([f"#define AT_SEED {names.index('seed')}"] if model.draws else []),
        *(f"#define {name} {size}" for name, size in work.items()),
        "typedef enum { REAL, INTEGER, BOOLEAN, STRING } Type;",
        "typedef struct {",
        "    const char *name, *unit;",
        "    Type type;",
        "    int tunable;",
        "    double start, min, max;",
        "    const char *warning;",
        "} Variable;",
        "static const Variable VARIABLE[N_P + N_D + N_U + N_Y + N_X + 1] = {",
        *(_row(scalar) for group in groups.values() for scalar in group),
        '    {"", "", STRING, 0, 0, 0, 0, ""}',
        "};",
    ]
    return "\n".join(lines) + "\n"


def _row(scalar: Scalar) -> str:
    field = scalar.field
    unit = f" {field.unit}" if field.unit else ""
    low, high = (_bound(value) for value in (field.min, field.max))
    return (
        f'    {{"{scalar.name}", "{unit}", {field.kind.upper()}, {int(field.tunable)},'
        f' {scalar.start!r}, {low}, {high}, "{field.warning}"}},'
    )


def _bound(value: float) -> str:
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(value)


def sources(model: Model, guid: str) -> dict[str, str]:
    """Every file of the FMU's `sources/`, by name."""
    return {
        ENTRY: _ENTRY_TEXT,
        "functions.c": functions(model),
        "model.h": header(model, guid),
        "shell.c": shell(),
    }
