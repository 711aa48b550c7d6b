"""The list of items, and the selection of items by the names on the command line."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import pkgutil
import re
from collections.abc import Iterable, Sequence
from importlib.abc import InspectLoader

from harness.reproduce import papers
from harness.reproduce.item import Item

__all__ = ["ALL", "chosen", "items"]

ALL = "all"
"""Name of everything."""
_SPELT = re.compile(r"^(figure|fig|table|tab)s?[-. _]*(?=\d)")
_KINDS = {"fig": "figure", "tab": "table"}
_NUMBER = re.compile(r"[a-z]?\d+(\.\d+)*[a-z]?")


def items() -> list[Item]:
    """Return all items, sorted by group and by their numbers.

    Raises:
        SteadytipError: two items have one name.
    """
    found: dict[str, Item] = {}
    for module in pkgutil.walk_packages(papers.__path__, f"{papers.__name__}."):
        item = None if module.ispkg else _declared(module.name)
        if item is None:
            continue
        if item.name in found:
            from fmu_src.errors import SteadytipError

            raise SteadytipError(f"{module.name}: another item is called '{item.name}', too")
        found[item.name] = item
    return sorted(found.values(), key=lambda item: (item.group, _order(item.name)))


def _declared(module: str) -> Item | None:
    """Return the item that a module declares, or None; the module itself is imported by its run.

    Only two kinds of statement are executed here: `ITEM = Item(...)` and constants such as
    `SOURCE = "A04 table 7.1"`. All imports of the module are left for later.
    """
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert isinstance(spec.loader, InspectLoader)
    tree = ast.parse(spec.loader.get_source(module) or "")
    tree.body = [
        statement
        for statement in tree.body
        if isinstance(statement, ast.Assign)
        and (
            isinstance(statement.value, ast.Constant) or ast.unparse(statement.targets[0]) == "ITEM"
        )
    ]
    names = {"Item": Item, "run": lambda context: importlib.import_module(module).run(context)}
    exec(compile(tree, spec.origin or module, "exec"), names)
    item = names.get("ITEM")
    return item if isinstance(item, Item) else None


def chosen(names: Sequence[str], known: Iterable[Item]) -> list[Item]:
    """Return the items that some names mean, each once, in the order of the names.

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
    """Return one spelling for `Table 7.1`, `table_7.1` and `fig. 7.1`."""
    spelt = _SPELT.match(name := name.strip().lower())
    if spelt:
        name = f"{_KINDS.get(spelt[1], spelt[1])}-{name[spelt.end() :]}"
    return re.sub(r"[\s_]+", "-", name)


def _order(name: str) -> tuple[tuple[int, ...], str]:
    """Return the key to sort by numbers: 7.2 comes before 7.10."""
    return tuple(int(digits) for digits in re.findall(r"\d+", name)), name
