"""The installed command, called as a user calls it, in this process."""

import sys
from importlib.metadata import entry_points

import pytest


def steadytip(*arguments: object) -> None:
    """Run `steadytip` with arguments; fail unless it ends with 0."""
    (point,) = entry_points(group="console_scripts", name="steadytip")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["steadytip", *map(str, arguments)])
        code = 0
        try:
            point.load()()
        except SystemExit as ended:
            code = ended.code
    assert not code, f"steadytip {' '.join(map(str, arguments))} ended with {code}"
