"""What a loop does about samples that come late."""

from __future__ import annotations

from typing import Literal

from harness.common.strict_model import Positive, StrictModel

__all__ = ["Timing"]


class Timing(StrictModel):
    """How long the controller's node waits for samples, and what follows if it is too late itself.

    Attributes:
        overrun: what happens when the loop is late: `catch-up` (every sample has its tick, at
            once), `skip` (the newest sample only, in a longer tick) or `stop`.
        sample_deadline: how long after its time a sample is waited for [s].
        startup_timeout: how long the board's first sample is waited for [s].
    """

    overrun: Literal["catch-up", "skip", "stop"] = "catch-up"
    sample_deadline: Positive = 3e-3
    startup_timeout: Positive = 5.0
