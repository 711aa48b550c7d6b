"""Cascade neural filter: the motion that is meant, out of a window of the motion that is (A04 5.3).

    u     = (s_k, s_{k-d}, ..., s_{k-(N-1)d}) - o, over a_u    window of inputs, newest first
    z_i   = w_i.u + sum_{j<i} c_ij h_j + b_i                   hidden unit i of H, in cascade
    h_i   = f_i(z_i)                                           sigmoid, Gaussian, sine or Bessel
    m     = o + a_y (v.u + sum_i g_i h_i + b)                  motion without error
    e     = s - m                                              error

A cascade network (A04 Fig. 5.6): every hidden unit is connected to all inputs and to all hidden
units before it, the output to all of them, so that without hidden units it is a linear filter.
It is for errors that are no tremor, aperiodic and in the band of the intent, of which nothing is
known but recordings. The thesis trains it on one axis; here the same network sees each axis by
itself. `steadytip identify tremor-nn` trains it and writes its parameters.

Until then it does no harm: no hidden units, and the newest input passes, so that the error is 0.
Trained, it knows motions as large and as slow as those it was trained on: the level of the motion
matters to it, so positions count from o, the place that is held, and far from it or in a quick
intent its output means nothing.

f: 0 none; 1 sigmoid, tanh(z / 2); 2 Gaussian, exp(-z^2); 3 sine, sin z; 4 Bessel, J_0(z) by the
midpoint rule over its integral, mean of cos(z sin t), exact to 1e-7 up to |z| = 16.

Where a position is not valid, or not a position, the last one that was goes on, and before the
first one nothing is put out but the place that is held. The first one fills the window.

| symbol | field | meaning |
| --- | --- | --- |
| s | position | tip position, intent and error together |
| o | origin | place that is held |
| d | spacing | samples from one input to the next |
| N, H | INPUTS, HIDDEN | most inputs and hidden units; those not used have weights of 0 |
| f_i | unit_i.kind | activation of a hidden unit |
| w_i, c_i, b_i | unit_i.weights, .earlier, .bias | what it is connected by |
| v, g, b | output.weights, .hidden, .bias | the same of the output |
| a_u, a_y | input_scale, output_scale | scales of inputs and output |
| m | motion | what is meant |
| e | error | what is not |
"""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, integer, real, vector

SAMPLE_PERIOD = 4e-3
"""Sample period of the recordings that are trained on, there and here [s]."""
INPUTS = 100
"""As many as Riviere and Khosla have (A04 5.3.3)."""
HIDDEN = 10
"""As many as Riviere and Khosla have."""
SPACINGS = 5
"""Largest spacing of the inputs [samples]."""
HISTORY = SPACINGS * (INPUTS - 1) + 1
AXES = 3
REACH = 1.0
"""Positions beyond that are none [m]."""
BESSEL_POINTS = 16
"""Points of the midpoint rule over half a turn; by symmetry the first half of them is enough."""
_SINES = np.sin(np.pi * (np.arange(BESSEL_POINTS // 2) + 0.5) / BESSEL_POINTS)


class Activation(NamedTuple):
    """Function of a hidden unit's net input; both take it and the module to compute with."""

    value: Callable[[Any, ModuleType], Any]
    slope: Callable[[Any, ModuleType], Any]


ACTIVATIONS: dict[str, Activation] = {
    "sigmoid": Activation(
        lambda z, of: of.tanh(z / 2), lambda z, of: (1 - of.tanh(z / 2) ** 2) / 2
    ),
    "gaussian": Activation(lambda z, of: of.exp(-(z**2)), lambda z, of: -2 * z * of.exp(-(z**2))),
    "sine": Activation(lambda z, of: of.sin(z), lambda z, of: of.cos(z)),
    "bessel": Activation(
        lambda z, of: sum(of.cos(z * s) for s in _SINES) / len(_SINES),
        lambda z, of: -sum(s * of.sin(z * s) for s in _SINES) / len(_SINES),
    ),
}
"""Candidates of the thesis (A04 5.3.2) by name; `kind` counts them from 1."""


class Unit(Parameters):
    """A hidden unit."""

    kind = integer(
        "f, 0 none, 1 sigmoid, 2 Gaussian, 3 sine, 4 Bessel", min=0, max=len(ACTIVATIONS)
    )
    weights = real(None, "w, of the inputs, newest first", shape=INPUTS)
    earlier = real(None, "c, of the hidden units before it; others do not count", shape=HIDDEN)
    bias = real(None, "b")


class Output(Parameters):
    """The output."""

    weights = real(None, "v, of the inputs, newest first", shape=INPUTS, start=np.eye(INPUTS)[0])
    hidden = real(None, "g, of the hidden units", shape=HIDDEN)
    bias = real(None, "b")


class Params(Parameters):
    """The network; it passes its newest input until it is trained."""

    spacing = integer("d, samples from one input to the next", start=1, min=1, max=SPACINGS)
    origin = real("m", "o, place that is held", shape=3, within=REACH)
    input_scale = real("m", "a_u, scale of the inputs", start=1e-4, min=1e-9, max=1.0)
    output_scale = real("m", "a_y, scale of the output", start=1e-4, min=1e-9, max=1.0)
    output: Any = Output
    unit_1: Any = Unit
    unit_2: Any = Unit
    unit_3: Any = Unit
    unit_4: Any = Unit
    unit_5: Any = Unit
    unit_6: Any = Unit
    unit_7: Any = Unit
    unit_8: Any = Unit
    unit_9: Any = Unit
    unit_10: Any = Unit


class In(Inputs):
    """Motion of the tip."""

    position = vector("m", "tip position", within=REACH)
    valid = boolean("whether the position can be trusted", start=True)


class X(State):
    """Motion up to now."""

    begun = boolean("whether there has been a position to trust", start=False)
    window = real("m", "positions less origin, newest first", shape=(AXES, HISTORY), listed=False)


class Out(Outputs):
    """Motion that is meant, and error."""

    motion = vector("m", "m, tip motion without error")
    error = vector("m", "e, position less that motion")


def units(p: Params) -> list[Any]:
    """Return the hidden units in the order of the cascade."""
    return [getattr(p, f"unit_{i}") for i in range(1, HIDDEN + 1)]


def network(p: Params, u: Any) -> Any:
    """Evaluate the network, without its scale.

    Args:
        p: weights.
        u: scaled inputs of each axis, newest first, (AXES, INPUTS).

    Returns:
        (AXES,).
    """
    hidden: list[Any] = []
    for unit in units(p):
        z = u @ unit.weights + unit.bias
        for j, h in enumerate(hidden):
            z += unit.earlier[j] * h
        hidden.append(
            sum(
                (unit.kind == k) * activation.value(z, ca)
                for k, activation in enumerate(ACTIVATIONS.values(), start=1)
            )
        )
    return u @ p.output.weights + ca.horzcat(*hidden) @ p.output.hidden + p.output.bias


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Compute one sample."""
    # A comparison with what is not a number is false.
    known = u.valid * (ca.sum1(ca.fabs(u.position) <= REACH) == AXES)
    newest = ca.if_else(known, u.position - p.origin, x.window[:, 0])
    before = ca.if_else(x.begun, x.window[:, :-1], ca.repmat(newest, 1, HISTORY - 1))
    window = ca.horzcat(newest, before)
    taken = sum(
        (p.spacing == d) * window[:, : d * (INPUTS - 1) + 1 : d] for d in range(1, SPACINGS + 1)
    )
    motion = p.output_scale * network(p, taken / p.input_scale)
    begun = ca.fmax(x.begun, known)
    return (
        X(begun=begun, window=window),
        Out(motion=p.origin + begun * motion, error=begun * (newest - motion)),
    )


MODEL = Model.of_step("CascadeNeural", step, sample_period=SAMPLE_PERIOD, matrix=True)
