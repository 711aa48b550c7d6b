"""Say where a function that somebody wrote for a model has failed, in one line for a person."""

import functools
import inspect
import linecache
import re
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

_NOT_THE_AUTHORS = tuple(
    str(Path(str(file)).resolve().parent) for file in (__file__, ca.__file__, np.__file__)
)

_INSIDE = re.compile(r"^\S*casadi\S*:\d+: ")
"""Where in CasADi's own sources something was found."""


def namespace(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the names of the module that a function, or what it wraps, is written in."""
    while isinstance(function, functools.partial):
        function = function.func
    written: Any = inspect.unwrap(function)
    written = getattr(written, "__func__", written)
    if hasattr(written, "__globals__"):
        return dict(written.__globals__)
    return dict(vars(sys.modules[type(written).__module__]))


def place_of(function: Callable[..., Any]) -> str:
    """Return the file and the line where a function begins."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f"{code.co_filename}, line {code.co_firstlineno}" if code else repr(function)


def failure(error: BaseException, function: Callable[..., Any]) -> str:
    """Return file, line and text of the author's deepest line on the way to an error, and why.

    Args:
        error: as it was caught.
        function: the author's, that was called.
    """
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return f"{error.filename}, line {error.lineno}: {error.msg}"
    where = place_of(function)
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if not frame.filename.startswith((*_NOT_THE_AUTHORS, "<frozen")):
            text = linecache.getline(frame.filename, frame.lineno or 0).strip()
            where = f"{frame.filename}, line {frame.lineno}" + (f" `{text}`" if text else "")
            break
    return f"{where}: {reason(error)}"


def reason(error: BaseException) -> str:
    """Return what an error says in one line; CasADi says it in many, with lines of its own C++."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    said = _INSIDE.sub("", lines[0])
    if said.startswith("Assertion") and len(lines) > 1:
        said = lines[1]
    given = [line for line in lines[1:] if line.startswith("You have:")]
    hint = "; a step is recorded once for all values: `casadi.if_else` chooses, `if` cannot"
    branched = "truth value" in said
    return " ".join([f"{type(error).__name__}: {said}", *given]) + (hint if branched else "")
