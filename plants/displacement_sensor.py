"""Displacement sensor beside a stack, as an interferometer or a strain gauge reads.

    m[k] = (1 + e) s[k] + o + sigma n[k]

Its samples are 1 ms apart, and n is white. The noise is that of A04's interferometer at that rate
(7.4); gain and zero are exact unless they are set.

| symbol | field | meaning |
| --- | --- | --- |
| s | stroke | stroke of the stack |
| m | measured | what is read of it |
| e, o | gain_error, offset | of the sensor |
| sigma | noise | rms of the noise |
"""

from typing import Any

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, integer, real


class Params(Parameters):
    """Accuracy of the sensor."""

    noise = real("m", "rms of the noise of a sample", start=0.07e-6, min=0.0, max=1e-3)
    gain_error = real(None, "relative deviation of the gain", start=0.0, within=0.5)
    offset = real("m", "reading at zero stroke", start=0.0, within=1e-2)
    seed = integer("seed of the noise", start=1, min=0, max=2**31 - 1)


class In(Inputs):
    """Stroke of the stack."""

    stroke = real("m", "stroke of the stack", within=1e-2)


class Resting(State):
    """A reading has no memory."""


class Out(Outputs):
    """Stroke as read."""

    measured = real("m", "stroke as read")


def step(p: Params, u: In, x: Resting, T: float, normal: Any) -> tuple[Resting, Out]:
    """Compute one sample."""
    return x, Out(measured=(1 + p.gain_error) * u.stroke + p.offset + p.noise * normal[0])


MODEL = Model.of_step("DisplacementSensor", step, sample_period=1e-3, draws=1)
