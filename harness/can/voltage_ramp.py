"""The voltages of a command, that never jump: neither into rest nor out of it.

    o <- o - clip(o, -R T, R T),   v = clip(u + o, v_min, v_max)     following
    v <- v + clip(r - v, -R T, R T)                                  on the way to rest r

When following begins, o = v - u: the voltages go on from where they are, and what is left of the
difference fades at the rate R while they follow, however fast that is. The loop sends such
voltages, and a board applies such, each by itself: a board that hears nothing is on the same way to
rest as the loop whose frames do not arrive.
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["VoltageRamp"]

REST = 0.0
"""r, of a stack without drive [V]."""


class VoltageRamp:
    """Voltages of several stacks.

    Attributes:
        volts: as they are now [V].
    """

    def __init__(self, limits: Sequence[tuple[float, float]], change: float) -> None:
        """Begin at rest.

        Args:
            limits: v_min, v_max of each stack [V].
            change: R T, by which the difference fades in one sample [V].
        """
        self._limits = tuple(limits)
        self._change = change
        self._follows = False
        self._offsets = [0.0] * len(limits)
        self.volts = [REST] * len(limits)

    @property
    def is_at_rest(self) -> bool:
        """True if all voltages are those of rest, and not by following."""
        return not self._follows and all(v == REST for v in self.volts)

    def step(self, wanted: Sequence[float] | None) -> list[float]:
        """One sample on.

        Args:
            wanted: u, within the limits [V]; None: go to rest.
        """
        if wanted is None:
            self._follows = False
            self.volts = [v + self._toward(REST - v) for v in self.volts]
            return self.volts
        if not self._follows:
            self._follows = True
            self._offsets = [v - u for v, u in zip(self.volts, wanted, strict=True)]
        if not any(self._offsets):
            self.volts = list(wanted)
            return self.volts
        for i, (u, (low, high)) in enumerate(zip(wanted, self._limits, strict=True)):
            left = self._offsets[i] - self._toward(self._offsets[i])
            self.volts[i] = min(max(u + left, low), high)
            self._offsets[i] = self.volts[i] - u if left else 0.0
        return self.volts

    def _toward(self, gap: float) -> float:
        """As much of a gap as fits into one sample."""
        return min(max(gap, -self._change), self._change)
