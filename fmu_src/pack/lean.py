"""What CasADi's C does beside its computing, and what costs more than that: left out, or done well.

A result that a function puts out and uses for nothing else is first written into its work vector,
then copied. Here it is written where it goes. Arguments and results of a function never overlap.

Any argument may be left out, for zeros; here none is, but those that hold nothing.
"""

import re

_FUNCTION = re.compile(r"^static int \w+\(const casadi_real\*\* arg,.*?^\}\n", re.M | re.S)
_OUTPUT = re.compile(
    r"^  (?:if \(res\[\d+\]\) )?casadi_copy\((w\d+), \d+, (res\[\d+\])((?:\+\d+)?)\);\n", re.M
)
_ARGUMENT = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
# Values of two arrays that are never the same.
_LOOP = "for (i=0; i<n; ++i) *y++ = *x++;"
_BLOCK = "(void)i; memcpy(y, x, (size_t)n * sizeof *y);"


def lean(text: str) -> str:
    """The same C with fewer copies, blocks moved as such, and no look for missing arguments."""
    text = _FUNCTION.sub(lambda found: _put_out(found[0]), text)
    text = _ARGUMENT.sub(r"arg[\1][\2]", text)
    return "#include <string.h>\n" + text.replace(_LOOP, _BLOCK)


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
