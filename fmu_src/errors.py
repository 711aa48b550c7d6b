"""The one exception whose text is written for the person at the keyboard."""

import math


class SteadytipError(Exception):
    """A mistake that its reader can mend: says what, where, which value, which range, what to do.

    The command line prints it without a traceback.
    """


def range_text(low: float, high: float) -> str:
    """`[low, high]` in words, for error texts.

    >>> range_text(0.0, math.inf)
    'at least 0'
    """
    if math.isinf(low) and math.isinf(high):
        return "finite"
    if math.isinf(high):
        return f"at least {low:.9g}"
    if math.isinf(low):
        return f"at most {high:.9g}"
    return f"in [{low:.9g}, {high:.9g}]"
