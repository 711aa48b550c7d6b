"""Parts whose outputs are known before the run: a row for each tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from harness.common.types import FloatArray
from harness.parts.ports import Port
from harness.parts.protocols import OutputTable, RunContext, Settings


class RowsPart:
    """Puts out row k at tick k, and the last one after the last; has no inputs and frees nothing.

    A class below sets `rows`, in its constructor or in `evaluate`.

    Attributes:
        rows: (n, outputs) what is put out.
        y: (outputs,) where the outputs go.
    """

    rows: FloatArray
    y: FloatArray
    inputs: Sequence[Port] = ()
    kept = False

    @classmethod
    def prepare(
        cls, settings: Mapping[str, Settings], progress: Callable[[str], None]
    ) -> Mapping[str, Settings]:
        """Return the settings as they are; nothing has to be prepared."""
        return settings

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """See `Part.start`."""
        self.evaluate(run)
        self.y = y
        self.y[:] = self.rows[0]

    def evaluate(self, run: RunContext) -> None:
        """Make `rows` ready for a run, or raise FaultError if they do not fit it."""
        raise NotImplementedError

    def advance(self, t: float, h: float) -> None:
        """Put out the row of `t`; see `Part.advance`."""
        self.y[:] = self.rows[min(round(t / h), len(self.rows) - 1)]

    def can_pause(self) -> bool:
        """See `Reusable`: what it puts out depends on the time alone."""
        return True

    def native_step(self) -> OutputTable:
        """See `NativelySteppable`."""
        return OutputTable(self.rows)

    def release(self) -> None:
        """Free nothing."""

    def close(self) -> None:
        """Free nothing."""
