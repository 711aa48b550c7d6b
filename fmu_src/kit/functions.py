"""Record Python functions as CasADi functions, by elements or by matrices."""

from collections.abc import Callable
from typing import Any

import casadi as ca

from fmu_src.kit.records import Record


def by_elements(
    name: str, function: Callable[..., Any], *arguments: Any, cse: bool = True
) -> ca.Function:
    """Record a function by elements, as straight code.

    Args:
        name: in C.
        function: takes records, columns and matrices; returns one or several of these.
        arguments: for each argument its record, the length of its column, or its sparsity.
        cse: whether to compute equal expressions once.

    Returns:
        The function; records are packed in its arguments and results.
    """
    return _recorded(ca.SX, name, function, arguments, {"cse": cse})


def by_matrices(name: str, function: Callable[..., Any], *arguments: Any) -> ca.Function:
    """Record a function by whole matrices; it may call functions without inlining them.

    Args:
        name: in C.
        function: as in `by_elements`.
        arguments: as in `by_elements`.
    """
    return _recorded(ca.MX, name, function, arguments, {})


def _recorded(
    kind: Any,
    name: str,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    options: dict[str, Any],
) -> ca.Function:
    symbols, values = [], []
    for place, argument in enumerate(arguments):
        is_record = isinstance(argument, type)
        symbols.append(kind.sym(f"a{place}", argument.size() if is_record else argument))
        values.append(argument.unpack(symbols[-1]) if is_record else symbols[-1])
    found = function(*values)
    results = found if isinstance(found, tuple) else (found,)
    columns = [each.pack() if isinstance(each, Record) else each for each in results]
    return ca.Function(name, symbols, columns, options)
