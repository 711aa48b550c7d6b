"""End-to-end protection: what the counter of an intact frame says.

    d = (counter - last) mod N        N = 15 (P01), 256 (P05)

| d | status | use |
| --- | --- | --- |
| first frame | `INITIAL` | yes |
| 1 | `OK` | yes |
| 2, 3 | `OK_SOME_LOST` | yes; d - 1 are lost |
| 0 | `REPEATED` | no |
| more | `WRONG_SEQUENCE` | no, nor the frame after it: `SYNC` |

An old frame that comes again is told by its counter as long as it is younger than N - 4 samples:
11 with profile 1, 252 with profile 5. One that is a whole cycle old looks like a new one.

Frames whose CRC is wrong never come here, so that the counter stays. After silence the counter
may be anything, so that two good frames are asked for as well.

Source: AUTOSAR, Specification of SW-C End-to-End Communication Protection Library, with
MaxDeltaCounter 3 and two good frames after a wrong sequence.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["MOST_LOST", "CheckStatus", "Counter"]

MOST_LOST = 2
"""Frames in a row that may be missing without a fault."""
_TO_SYNC = 2
"""Good frames that end a wrong sequence."""


class CheckStatus(IntEnum):
    """Of one intact frame."""

    INITIAL = 0
    OK = 1
    OK_SOME_LOST = 2
    REPEATED = 3
    WRONG_SEQUENCE = 4
    SYNC = 5


USABLE = (CheckStatus.INITIAL, CheckStatus.OK, CheckStatus.OK_SOME_LOST)


class Counter:
    """The alive counter of one message.

    Attributes:
        lost: frames missing before the last one that was taken.
    """

    def __init__(self, modulus: int) -> None:
        """Start without a frame."""
        self._modulus = modulus
        self._last: int | None = None
        self._to_sync = 0
        self.lost = 0

    @property
    def in_sequence(self) -> bool:
        """True once two good frames have followed the last wrong sequence."""
        return self._to_sync == 0

    def take(self, counter: int) -> CheckStatus:
        """Judge an intact frame by its counter."""
        last, self._last = self._last, counter
        self.lost = 0
        if last is None:
            return CheckStatus.INITIAL
        step = (counter - last) % self._modulus
        if step == 0:
            return CheckStatus.REPEATED
        if step > MOST_LOST + 1 or counter >= self._modulus:
            self._to_sync = _TO_SYNC
            return CheckStatus.WRONG_SEQUENCE
        self.lost = step - 1
        if self._to_sync > 1:
            self._to_sync -= 1
            return CheckStatus.SYNC
        self._to_sync = 0
        return CheckStatus.OK_SOME_LOST if self.lost else CheckStatus.OK

    def silence(self) -> None:
        """Note that nothing came within the timeout: the next frames have to prove themselves."""
        if self._last is not None:
            self._to_sync = _TO_SYNC
