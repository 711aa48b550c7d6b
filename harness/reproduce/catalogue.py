"""Which items there are, and which of them a name on the command line means."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterable, Sequence

from harness.reproduce import papers
from harness.reproduce.item import Item

__all__ = ["ALL", "chosen", "items"]

ALL = "all"
"""Name of everything."""
_SPELT = re.compile(r"^(figure|fig|table|tab)s?[-. _]*(?=\d)")
_KINDS = {"fig": "figure", "tab": "table"}
_NUMBER = re.compile(r"[a-z]?\d+(\.\d+)*[a-z]?")


def items() -> list[Item]:
    """All items, by group and in the order of their numbers.

    Raises:
        SteadytipError: two items with one name.
    """
    found: dict[str, Item] = {}
    for module in pkgutil.walk_packages(papers.__path__, f"{papers.__name__}."):
        item = getattr(importlib.import_module(module.name), "ITEM", None)
        if not isinstance(item, Item):
            continue
        if item.name in found:
            from harness.common.errors import SteadytipError

            raise SteadytipError(f"{module.name}: another item is called '{item.name}', too")
        found[item.name] = item
    return sorted(found.values(), key=lambda item: (item.group, _order(item.name)))


def chosen(names: Sequence[str], known: Iterable[Item]) -> list[Item]:
    """Items that are meant by some names, each once, in the order of the names.

    Args:
        names: of an item (`table-7.1`, `Fig. 7.1`), the number alone (`7.1`, for the table and the
            figure of that number), a group, a paper (`A04`), or `all`.
        known: items to choose from.

    Raises:
        ProblemsError: names that nothing is called by, each with the nearest.
    """
    from harness.common.errors import ProblemsError, nearest

    known = list(known)
    called: dict[str, list[Item]] = {ALL: known}
    for item in known:
        for alias in dict.fromkeys(_aliases(item)):
            called.setdefault(alias, []).append(item)
    shown = {alias for alias in called if not _NUMBER.fullmatch(alias)}
    problems: list[str] = []
    found: dict[str, Item] = {}
    for name in names:
        plain = _plain(name)
        if plain not in called:
            problems.append(f"nothing is called '{name}'; {nearest(plain, shown)}")
        found |= {item.name: item for item in called.get(plain, ())}
    if problems:
        raise ProblemsError("reproduce", problems)
    return list(found.values())


def _aliases(item: Item) -> Iterable[str]:
    for name in (item.name, *item.aliases):
        plain = _plain(name)
        yield plain
        number = plain.rpartition("-")[2]
        if _NUMBER.fullmatch(number):
            yield number
    yield _plain(item.group)
    yield _plain(item.source.split()[0])


def _plain(name: str) -> str:
    """One spelling of `Table 7.1`, `table_7.1`, `fig. 7.1`."""
    spelt = _SPELT.match(name := name.strip().lower())
    if spelt:
        name = f"{_KINDS.get(spelt[1], spelt[1])}-{name[spelt.end() :]}"
    return re.sub(r"[\s_]+", "-", name)


def _order(name: str) -> tuple[tuple[int, ...], str]:
    """Numbers by their value: 7.2 comes before 7.10."""
    return tuple(int(digits) for digits in re.findall(r"\d+", name)), name
