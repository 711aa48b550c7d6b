"""Ports and parameters that the filters from a position to its tremor have in common.

| symbol | field | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| f_w | wash_out | corner of a wash-out that the position has been through |
| h | horizon | how far ahead the tremor is wanted |
| y | tremor | tremor at the time t + h |
"""

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.records import Inputs, boolean, real, vector

WASH_OUT = real(
    "Hz", "f_w, wash-out that the position has been through, 0 if none", min=0.0, max=5.0
)
HORIZON = real("s", "h, how far ahead the tremor is wanted", min=0.0, max=0.05)


class Surroundings(Parameters):
    """Wash-out of the position, and the horizon of the tremor."""

    wash_out = WASH_OUT
    horizon = HORIZON


class CountedMotion(State):
    """Memory of a filter whose motion counts from an origin, so that a gap is no step."""

    tracked = boolean("whether the last position could be trusted")
    origin = real("m", "position from which motion is counted", shape=3)


class In(Inputs):
    """Motion of the tip."""

    position = vector("m", "tip position", within=1.0)
    valid = boolean("whether the position can be trusted", start=True)


class Out(Outputs):
    """The tremor."""

    tremor = vector("m", "y, tremor at t + h")
