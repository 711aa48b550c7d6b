"""Work that most samples do without, in models that are recorded by elements.

There, a choice between two expressions evaluates both. Here each is a function of its own, and C
calls only the one that is chosen.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca


def lazy_select(
    name: str,
    condition: Any,
    taken: Callable[..., list[Any]],
    passed: Callable[..., list[Any]],
    *values: Any,
) -> list[Any]:
    """`taken(*values)` where a condition holds, else `passed(*values)`; the other is not evaluated.

    Args:
        name: of the choice, in C.
        condition: scalar.
        taken: of columns and matrices, giving some; it must use nothing else.
        passed: likewise, giving as many of the same shapes.
        values: what they are called with.
    """
    values = tuple(map(ca.SX, values))
    symbols = [ca.SX.sym(f"v{i}", *value.shape) for i, value in enumerate(values)]
    functions = [
        ca.Function(
            f"{name}_{which}", symbols, list(map(ca.densify, function(*symbols))), {"cse": True}
        )
        for which, function in (("taken", taken), ("passed", passed))
    ]
    chosen = ca.Function.if_else(name, functions[0], functions[1])
    arguments = chosen.mx_in()
    results = chosen.call(arguments, False, True)
    # Inlined into elements, both would be evaluated again.
    apart = ca.Function(f"{name}_apart", arguments, results, {"never_inline": True})
    return list(apart.call([ca.SX(condition), *values]))
