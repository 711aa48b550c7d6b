"""What CasADi's C does beside its computing, and what costs more than that: left out, or done well.

A result that a function puts out and uses for nothing else is first written into its work vector,
then copied. Here it is written where it goes. Arguments and results of a function never overlap,
and functions that work by elements tell the compiler so: then it need not fear that a result
changes an argument, and computes neighbours two at a time.

Any argument may be left out, for zeros; here none is, but those that hold nothing. And the least of
two numbers is told from one that is not a number, which takes five instructions for one; here what
is not finite ends a run anyway.
"""

import re

_FUNCTION = re.compile(
    r"^static int (\w+)(\(const casadi_real\*\* arg,[^\n]*\) ?)\{\n(.*?)^\}\n", re.M | re.S
)
_OUTPUT = re.compile(
    r"^  (?:if \(res\[\d+\]\) )?casadi_copy\((w\d+), \d+, (res\[\d+\])((?:\+\d+)?)\);\n", re.M
)
_ARGUMENT = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_RESULT = re.compile(r"if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]=")
_EXTREME = re.compile(r"return (?:fmin|(fmax))\(x, y\);")
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


def lean(text: str) -> str:
    """The same C with fewer copies, arguments that are there and never overlap with results."""
    text = _FUNCTION.sub(lambda found: _apart(found) or _put_out(found[0]), text)
    text = _EXTREME.sub(lambda found: f"return x {'>' if found[1] else '<'} y ? x : y;", text)
    text = _PRODUCT.sub(lambda found: _ROWS + found[0].replace(found[1], _BY_ROWS), text)
    return "#include <string.h>\n" + text.replace(_LOOP, _BLOCK)


def _apart(function: re.Match[str]) -> str:
    """A function that works by elements, with its vectors as arguments; empty for another one."""
    name, head, body = function.groups()
    vectors = {
        f"{letter}{place}": (kind, f"{vector}[{place}]")
        for letter, kind, vector, pattern in (
            ("u", "const casadi_real", "arg", _ARGUMENT),
            ("y", "casadi_real", "res", _RESULT),
        )
        for place in sorted({int(place) for place, _ in pattern.findall(body)})
    }
    if not vectors or "/* #0:" in body:
        return ""
    body = _ARGUMENT.sub(r"u\1[\2]", body)
    body = _RESULT.sub(r"if (y\1!=0) y\1[\2]=", body)
    taken = "".join(f", {kind}* restrict {short}" for short, (kind, _) in vectors.items())
    given = "".join(f", {vector}" for _, vector in vectors.values())
    inner = f"static int {name}_apart{head.rstrip().removesuffix(')')}{taken}) {{\n{body}}}\n"
    call = f"  return {name}_apart(arg, res, iw, w, mem{given});\n"
    return f"{inner}static int {name}{head}{{\n{call}}}\n"


def _put_out(function: str) -> str:
    for found in list(_OUTPUT.finditer(function)):
        place, result, offset = found.groups()
        # It is declared, filled once by a call or piece by piece, and copied.
        declared = re.search(rf"\*{place}=(w\+\d+)", function)
        filled = re.search(rf"(?:res1\[\d+\]|rr)={place};", function)
        if not (declared and filled and len(re.findall(rf"\b{place}\b", function)) == 3):
            continue
        there = f"*{place}={result} ? {result}{offset} : {declared[1]}"
        function = function.replace(declared[0], there).replace(found[0], "")
    return function
