"""What happens in the middle of a run: values that change, and wires that go wrong.

    [[change]]
    at  = 5.0                           # s
    set = { "estimator.gain" = 2.0 }    # tunable parameters, and inputs that nothing drives

    [[fault]]
    wire  = "sensors.volts_a3y"           # an output: all wires from it; an input: the wire to it
    kind  = "offset"
    value = 0.1                         # in the unit of the wire
    at    = 5.0                         # s; from the beginning if left out
    until = 6.0                         # s; to the end if left out

A change acts on the first tick that begins at its time or later. A fault is a part `SignalFault`
that is put into the wire, and changes of its parameters; before and after, the wire's values pass
it unchanged.

| kind | what becomes of the signal |
| --- | --- |
| gain | is multiplied by `value` |
| offset | `value` is added |
| noise | white noise of `value` rms is added |
| dropout | `value` is the probability that a sample is lost and the last one held |
| stuck | stays as it is |
| dead | is zero |
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

from pydantic import Field

from harness.common.strict_model import Positive, StrictModel

__all__ = ["MODEL", "Change", "Fault"]


MODEL = "SignalFault"
"""The plant that is put into a wire, with the input `signal` and the output `faulty`."""


_KINDS: Mapping[str, tuple[str, float, float | None]] = {
    "gain": ("gain", 1.0, None),
    "offset": ("offset", 0.0, None),
    "noise": ("noise", 0.0, None),
    "dropout": ("dropout", 0.0, None),
    "stuck": ("dropout", 0.0, 1.0),
    "dead": ("gain", 1.0, 0.0),
}
"""Of each kind: the parameter, its value without fault, and that of the fault if it is always the
same."""


_Time = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class Change(StrictModel):
    """Values that change in the middle of a run.

    Attributes:
        at: when [s].
        set: values by `part.variable`.
    """

    at: Positive
    set: dict[str, float | int | bool]


class Fault(StrictModel):
    """A wire that goes wrong; see the module's table.

    Attributes:
        wire: `part.port` where it begins or ends.
        kind: what becomes of the signal.
        value: how much, where the kind has a measure.
        at: when it begins [s].
        until: when it ends [s].
    """

    wire: str
    kind: Literal["gain", "offset", "noise", "dropout", "stuck", "dead"]
    value: float | None = Field(default=None, allow_inf_nan=False)
    at: _Time = 0.0
    until: Positive | None = None

    @property
    def part(self) -> str:
        """Name of the part in the wire."""
        return "fault_" + "".join(c if c.isalnum() else "_" for c in self.wire)

    @property
    def trouble(self) -> str:
        """Mistake in it; empty if there is none."""
        fixed = _KINDS[self.kind][2] is not None
        if fixed == (self.value is not None):
            return f"kind '{self.kind}' {'takes no' if fixed else 'needs a'} 'value'"
        if self.until is not None and self.until <= self.at:
            return f"it ends at {self.until:g} s, not after it begins at {self.at:g} s"
        return ""

    @property
    def settings(self) -> dict[str, float]:
        """Parameters of the part in the wire while it lasts."""
        name, _, fixed = _KINDS[self.kind]
        return {name: float(self.value if fixed is None else fixed)}  # type: ignore[arg-type]

    def changes(self) -> Iterator[Change]:
        """Yield how it begins and ends; nothing of a beginning with the run."""
        name, neutral, _ = _KINDS[self.kind]
        if self.at > 0.0:
            values = {f"{self.part}.{key}": value for key, value in self.settings.items()}
            yield Change(at=self.at, set=values)
        if self.until is not None:
            yield Change(at=self.until, set={f"{self.part}.{name}": neutral})
