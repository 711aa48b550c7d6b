"""A wire that goes wrong: gain, offset, noise, and samples that do not arrive.

    lost[k] = U[k] < q                              a sample that does not arrive
    y[k]    = y[k-1]                                 if lost
              g s[k] + o + sigma n[k]                else

It stands in a wire of the loop and takes and gives a number without a unit, so that it fits any. As
it starts it changes nothing, to the last digit. All parameters may be set while it runs: a fault
begins when they are set, and ends when they are set back. A signal that is stuck is one of which
every sample is lost (q = 1); one that is dead has the gain 0. Its samples are 1 ms apart.

| symbol | field | meaning |
| --- | --- | --- |
| s | signal | what comes in |
| y | faulty | what goes on |
| g, o, sigma | gain, offset, noise | of the fault; offset and noise in the unit of the signal |
| q | dropout | probability that a sample is lost |
| U, n | | uniform in (0, 1), and standard normal; independent |
"""

from typing import Any

import casadi as ca

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, integer, real

_ROOT_2 = 2.0**0.5


class Params(Parameters):
    """Fault; there is none at the start values."""

    gain = real(None, "factor g", start=1.0, tunable=True)
    offset = real(None, "o, added after the gain", start=0.0, tunable=True)
    noise = real(None, "sigma, rms of white noise", start=0.0, min=0.0, tunable=True)
    dropout = real(
        None,
        "q, probability that a sample is lost and the last one held",
        start=0.0,
        min=0.0,
        max=1.0,
        tunable=True,
    )
    seed = integer("seed of noise and losses", start=1, min=0, max=2**31 - 1)


class In(Inputs):
    """The wire's beginning."""

    signal = real(None, "signal as it comes in")


class X(State):
    """Sample that is held while others are lost."""

    held = real(None, "last output")


class Out(Outputs):
    """The wire's end."""

    faulty = real(None, "signal as it goes on")


def step(p: Params, u: In, x: X, T: float, normal: Any) -> tuple[X, Out]:
    """Compute one sample."""
    uniform = 0.5 * (1 + ca.erf(normal[1] / _ROOT_2))
    lost = uniform < p.dropout
    y = ca.if_else(lost, x.held, p.gain * u.signal + p.offset + p.noise * normal[0])
    return X(held=y), Out(faulty=y)


MODEL = Model.of_step("SignalFault", step, sample_period=1e-3, draws=2)
