"""Names by patterns."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

__all__ = ["matching"]


def matching(columns: Sequence[str], patterns: str | Sequence[str]) -> tuple[str, ...]:
    """Columns that fit patterns (`*`, `?`), in the order of the patterns, then of the columns."""
    wanted = [patterns] if isinstance(patterns, str) else patterns
    # Brackets belong to names, as in `w[1]`; for fnmatch they would be a set of characters.
    wanted = [pattern.replace("[", "[[]") for pattern in wanted]
    return tuple(name for pattern in wanted for name in columns if fnmatchcase(name, pattern))
