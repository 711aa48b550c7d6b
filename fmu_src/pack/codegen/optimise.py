"""Optimise the C code that CasADi writes.

A result that a function puts out and uses for nothing else is first written into its work vector,
then copied. Here it is written where it goes. Arguments and results of a function never overlap,
and functions that work by elements tell the compiler so: it can then compute neighbours two at a
time, for a result never changes an argument.

CasADi's functions accept null pointers for arguments, which then count as zeros. The shell passes
all arguments, so that test is left out. `fmin` and `fmax` spend five instructions on values that
are not a number. Here one comparison is enough, because what is not finite ends a run anyway.

All of this is done by patterns of CasADi's text. A construct that is there, but not in the form
that its pattern expects, ends the build: another version of CasADi may write another text.
"""

import re
from collections.abc import Callable
from importlib.metadata import version

from fmu_src.errors import SteadytipError

_FUNCTION = re.compile(
    r"^static int (\w+)(\(const casadi_real\*\* arg,[^\n]*\) ?)\{\n(.*?)^\}\n", re.M | re.S
)
_OUTPUT = re.compile(
    r"^  (?:if \(res\[\d+\]\) )?casadi_copy\((w\d+), \d+, (res\[\d+\])((?:\+\d+)?)\);\n", re.M
)
_ARGUMENT = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_RESULT = re.compile(r"if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]=")
_VECTOR = re.compile(r"^ *a\d+ *= *[^;\n]*\b(arg\[)|\b(res\[)\d+\](?:\[|\s*!=)", re.M)
"""An element of an argument or a result, in whatever form."""
_EXTREME = re.compile(r"return (?:fmin|(fmax))\(x, y\);")
_COPIED = re.compile(r"casadi_copy\(w\d+,[^\n]*\bres\[")
# Values of two arrays that are never the same.
_LOOP = "for (i=0; i<n; ++i) *y++ = *x++;"
_BLOCK = "(void)i; memcpy(y, x, (size_t)n * sizeof *y);"
_PRODUCT = re.compile(
    r"^void casadi_mtimes_dense\(.*?(^ +for \(j=0; j<nrow_x; \+\+j\) \{\n.*?^      \}\n)",
    re.M | re.S,
)
_ROWS = """\
static inline void casadi_rows(const casadi_real* x, casadi_int nrow, casadi_int ncol,
    const casadi_real* y, casadi_real* z, const casadi_int count) {
  casadi_real sums[8];
  casadi_int j, k;
  for (j=0; j<count; ++j) sums[j] = z[j];
  for (k=0; k<ncol; ++k)
    for (j=0; j<count; ++j) sums[j] += x[j + k*nrow] * y[k];
  for (j=0; j<count; ++j) z[j] = sums[j];
}

"""
_BY_ROWS = """\
      j = 0;
      for (; nrow_x-j>=8; j+=8) casadi_rows(x+j, nrow_x, ncol_x, y+i*ncol_x, z+i*nrow_x+j, 8);
      for (; nrow_x-j>=4; j+=4) casadi_rows(x+j, nrow_x, ncol_x, y+i*ncol_x, z+i*nrow_x+j, 4);
      for (; nrow_x-j>=1; j+=1) casadi_rows(x+j, nrow_x, ncol_x, y+i*ncol_x, z+i*nrow_x+j, 1);
"""


def optimise(text: str) -> str:
    """Return the same C with fewer copies, and with arguments that never overlap with results.

    Raises:
        SteadytipError: CasADi has written a construct in another form than is known here.
    """
    text = rewrite(_FUNCTION, _optimised_function, text, "(const casadi_real** arg, ")
    text = rewrite(
        _EXTREME, lambda m: f"return x {'>' if m[1] else '<'} y ? x : y;", text, "fmin(", "fmax("
    )
    text = rewrite(
        _PRODUCT, lambda m: _ROWS + m[0].replace(m[1], _BY_ROWS), text, "void casadi_mtimes_dense("
    )
    text = rewrite(re.compile(re.escape(_LOOP)), lambda _: _BLOCK, text, "void casadi_copy(")
    return "#include <string.h>\n" + text


def rewrite(
    pattern: re.Pattern[str],
    replacement: Callable[[re.Match[str]], str],
    text: str,
    *constructs: str,
) -> str:
    """Replace every match of a pattern in CasADi's text.

    Args:
        pattern: what to replace.
        replacement: gives the new text.
        text: C code.
        constructs: texts of which each is found only where the pattern must match.

    Raises:
        SteadytipError: the text holds a construct, and the pattern matches nowhere.
    """
    text_after, count = pattern.subn(replacement, text)
    found = [construct for construct in constructs if construct in text]
    if found and not count:
        raise _unknown_form(found[0])
    return text_after


def _unknown_form(construct: str) -> SteadytipError:
    return SteadytipError(
        f"CasADi {version('casadi')} writes '{construct}' in a form that the optimiser of the"
        " generated C code does not know; install a version from 3.7 up to and without 3.9, or"
        " adapt fmu_src/pack/codegen/optimise.py"
    )


def _optimised_function(function: re.Match[str]) -> str:
    return _with_vectors(function) or _without_copies(function[0])


def _with_vectors(function: re.Match[str]) -> str:
    """Give a function that works by elements its vectors as arguments; "" for another function."""
    name, head, body = function.groups()
    vectors = {
        f"{letter}{place}": (kind, f"{vector}[{place}]")
        for letter, kind, vector, pattern in (
            ("u", "const casadi_real", "arg", _ARGUMENT),
            ("y", "casadi_real", "res", _RESULT),
        )
        for place in sorted({int(place) for place, _ in pattern.findall(body)})
    }
    if "/* #0:" in body:
        return ""
    body = _ARGUMENT.sub(r"u\1[\2]", body)
    body = _RESULT.sub(r"if (y\1!=0) y\1[\2]=", body)
    if left := _VECTOR.search(body):
        raise _unknown_form(left[1] or left[2])
    if not vectors:
        return ""
    taken = "".join(f", {kind}* restrict {short}" for short, (kind, _) in vectors.items())
    given = "".join(f", {vector}" for _, vector in vectors.values())
    inner = f"static int {name}_apart{head.rstrip().removesuffix(')')}{taken}) {{\n{body}}}\n"
    call = f"  return {name}_apart(arg, res, iw, w, mem{given});\n"
    return f"{inner}static int {name}{head}{{\n{call}}}\n"


def _without_copies(function: str) -> str:
    """Let results that are only put out be written where they go."""
    copies = list(_OUTPUT.finditer(function))
    if len(copies) != len(_COPIED.findall(function)):
        raise _unknown_form("casadi_copy")
    for found in copies:
        place, result, offset = found.groups()
        # It is declared, filled once by a call or piece by piece, and copied.
        declared = re.search(rf"\*{place}=(w\+\d+)", function)
        filled = re.search(rf"(?:res1\[\d+\]|rr)={place};", function)
        if not (declared and filled and len(re.findall(rf"\b{place}\b", function)) == 3):
            continue
        there = f"*{place}={result} ? {result}{offset} : {declared[1]}"
        function = function.replace(declared[0], there).replace(found[0], "")
    return function
