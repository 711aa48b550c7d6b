"""C sources of a model: the recorded functions and the table of its variables.

Together with `shell.c` they are the whole FMU: `fmu.c` includes the other three.
"""

import math
import re
import tempfile
import textwrap
from collections import Counter
from collections.abc import Collection, Sequence
from functools import cache, lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any

import casadi as ca

from fmu_src.kit.container import Container
from fmu_src.kit.model import Model, symbols_in
from fmu_src.kit.records import Field, Scalar
from fmu_src.pack.codegen import container_wiring as wiring
from fmu_src.pack.codegen.optimise import optimise, rewrite

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


LONG_SPAN = 8
"""Values without limits in a row that are looked at together."""
LONG_SLOPE = 100_000
"""Characters of C beyond which a slope is compiled as it is written."""
_OPTIMISE = """
#ifdef __clang__
#pragma clang optimize {}
#endif
"""


@cache
def shell() -> str:
    """Return the source text of the FMI shell."""
    return (Path(__file__).parent / "shell.c").read_text(encoding="utf-8")


def _called(model: Model) -> dict[str, ca.Function]:
    """Return the functions of a model, or of a container's members, by their names in C."""
    if not isinstance(model, Container):
        return _recorded(model, model.derivatives)
    return {n: f for m in model.members for n, f in _recorded(m.model, False).items()}


@cache
def _recorded(model: Model, slope: bool) -> dict[str, ca.Function]:
    found = {}
    recorded = {"step": model.step_function, "derive": model.derive_function}
    if slope:
        recorded["slope"] = model.directional_derivative
    for name, function in recorded.items():
        # Never plain `step`: glibc exports a function of that name.
        called = f"{model.name}_{name}"
        arguments = symbols_in(function)
        found[called] = ca.Function(called, arguments, function.call(arguments, True, False))
    return found


@lru_cache(maxsize=8)
def functions(model: Model) -> str:
    """Generate the C99 functions that the shell calls, with the operation counts in front.

    CasADi writes more than that: sparsity patterns, and functions that tell of them. They are left
    out, so that no compiler complains of unused ones.

    Raises:
        SteadytipError: CasADi has written a text of another form than is known here.
    """
    called = _called(model)
    options: Any = {"casadi_int": "int", "with_header": False}
    generator = ca.CodeGenerator("functions.c", options)
    for function in called.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        text = (Path(folder) / "functions.c").read_text(encoding="utf-8")
    text = rewrite(_EXPORTED, lambda m: _if_called(m, called), text, "CASADI_SYMBOL_EXPORT ")
    text = rewrite(_HEAD, lambda m: m[1] + _UNUSED, text, "casadi_real** arg")
    text = optimise(text)
    # Some patterns name others, as a macro; what nothing names goes.
    while (short := _PATTERN.sub(partial(_named, Counter(_NAME.findall(text))), text)) != text:
        text = short
    if model.derivatives:
        text = _unoptimised_slope(text, list(called))
    if isinstance(model, Container):
        text += wiring.wiring(model, work_sizes(model))
    counts = [f" * {name}: {f.n_instructions()} operations" for name, f in called.items()]
    title = "/* Generated from the recorded model; do not edit."
    return "\n".join([title, *counts, " */", text])


def _unoptimised_slope(text: str, names: list[str]) -> str:
    """Switch the compiler's optimiser off for what only the slope needs, where that is long.

    It would take most of a long model's time for derivatives that few importers ask for.
    """
    others = max(text.find(f"int {name}(") for name in names[:-1])
    end = text.find("\n}\n", others) + len("\n}\n")
    if len(text) - end < LONG_SLOPE:
        return text
    off, on = map(_OPTIMISE.format, ("off", "on"))
    return f"{text[:end]}{off}{text[end:]}{on}"


def _named(times: Counter[str], found: re.Match[str]) -> str:
    """Return the definition of a sparsity pattern if its name stands elsewhere, too; else ""."""
    return found[0] if times[found[2]] > 1 else ""


def _if_called(found: re.Match[str], names: Collection[str]) -> str:
    """Return an exported function as a static one if it is called; else ""."""
    return found[0].replace("CASADI_SYMBOL_EXPORT", "static") if found[1] in names else ""


def work_sizes(model: Model) -> dict[str, int]:
    """Return the sizes of arrays with which every function of a model can work."""
    called = _called(model).values()
    return {
        "SZ_ARG": max(f.sz_arg() for f in called),
        "SZ_RES": max(f.sz_res() for f in called),
        "SZ_IW": max(f.sz_iw() for f in called),
        "SZ_W": max(f.sz_w() for f in called),
    }


def _spans(fields: list[Field], first: int) -> list[tuple[int, int, int]]:
    """Find runs of values that have limits (0), and long ones of values that have none (1).

    Returns:
        First place, place after the last, and 0 or 1, for each run.
    """
    found: list[tuple[int, int, int]] = []
    at = first
    for free, run in groupby(field.min == -math.inf and field.max == math.inf for field in fields):
        end = at + len(list(run))
        loose = int(free and end - at >= LONG_SPAN)
        if found and found[-1][2] == loose == 0:
            found[-1] = (found[-1][0], end, 0)
        else:
            found.append((at, end, loose))
        at = end
    return found


def _bounds(name: str, spans: Sequence[tuple[int, int, int]], fields: Sequence[Field]) -> str:
    limited = [field for start, end, loose in spans if not loose for field in fields[start:end]]
    values = [_bound(field.min if name == "low" else field.max) for field in limited]
    rows = textwrap.fill(", ".join([*values, "0"]), 100)
    return f"static const double {name.upper()}[] = {{\n{rows}\n}};"


def _pairs(name: str, pairs: Sequence[tuple[int, int]]) -> str:
    rows = ", ".join(f"{{{a}, {b}}}" for a, b in [*pairs, (0, 0)])
    return f"static const int {name}[][2] = {{{rows}}};"


def header(model: Model, guid: str) -> str:
    """Write `model.h`: sizes, names, and the variables in the order of the value references."""
    groups = model.variables
    sizes = {
        letter: len(groups[causality])
        for letter, causality in zip(
            "PDUYX", ("parameter", "calculatedParameter", "input", "output", "local"), strict=True
        )
    }
    work = work_sizes(model)
    if isinstance(model, Container):
        work = wiring.sizes(model, work)
    every = [scalar.field for group in groups.values() for scalar in group]
    first = len(every) - sizes["Y"] - sizes["X"]
    spans = _spans(every[first:], first)
    start = "start" if model.starts_apart else "step"
    latches = model.initial_latches
    lines = [
        "/* Generated from the model's records; do not edit. */",
        "#include <float.h>",
        f'#define MODEL_GUID "{guid}"',
        f"#define MODEL_PERIOD {model.sample_period!r}",
        f"#define MODEL_STEP {model.name}_step",
        f"#define MODEL_DERIVE {model.name}_derive",
        f"#define MODEL_START {model.name}_{start}",
        *([f"#define MODEL_SLOPE {model.name}_slope"] if model.derivatives else []),
        *(f"#define N_{letter} {size}" for letter, size in sizes.items()),
        f"#define N_R {model.draws}",
        f"#define N_STREAMS {len(model.noise_streams)}",
        f"#define N_SPANS {len(spans)}",
        f"#define N_LATCHES {len(latches)}",
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
        "/* Where the seed of a stream of draws lies, and how many it gives a sample. */",
        _pairs("STREAM", model.noise_streams),
        "/* Runs of computed values that have limits, or none. */",
        "static const struct { int from, to, loose; } SPAN[N_SPANS + 1] = {",
        *(f"    {{{', '.join(map(str, span))}}}," for span in spans),
        "    {0, 0, 0}",
        "};",
        "/* Limits of those that have them, one after the other. */",
        *(_bounds(name, spans, every) for name in ("low", "high")),
        "/* Outputs and the states that they are put into when initialisation ends. */",
        _pairs("LATCH", latches),
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
    """Return every file of the FMU's `sources/`, by name."""
    return {
        ENTRY: _ENTRY_TEXT,
        "functions.c": functions(model),
        "model.h": header(model, guid),
        "shell.c": shell(),
    }
