"""The kind of part `can`: the loop's end of a bus, or the board's."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from harness.can.database import load
from harness.common.errors import ProblemsError, nearest
from harness.parts.can.board import BoardPart
from harness.parts.can.feed import FeedPart
from harness.parts.protocols import Settings
from harness.parts.settings import CanSettings, check_settings

__all__ = ["KIND"]


class _Kind:
    """See `Kind`."""

    def prepare(
        self, settings: Mapping[str, Settings], progress: Callable[[str], None]
    ) -> Mapping[str, Settings]:
        """Return the settings as they are; nothing has to be prepared."""
        return settings

    def __call__(self, name: str, settings: Settings, seed: int) -> FeedPart | BoardPart:
        """Make the loop's end of a bus, or the board's; see `Kind`."""
        keys = check_settings(CanSettings, name, settings)
        database = load(keys.can)
        if keys.node not in database.nodes:
            raise ProblemsError(
                f"part '{name}'",
                [
                    f"{database.path.name} has no node '{keys.node}'; "
                    f"{nearest(keys.node, database.nodes)}"
                ],
            )
        if any(m.role == "sample" for m in database.sent_by(keys.node)):
            return BoardPart(name, keys, database)
        return FeedPart(name, keys, database)


KIND = _Kind()
"""Of the key `can`."""
