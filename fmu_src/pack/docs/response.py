"""How outputs of a model follow its inputs at the frequency of tremor: gain, phase, group delay.

    u_j = c_j + a_j sin(2 pi f t)                            one input moves, the others rest
    c_j = min(u_j0 + a_j, u_max - a_j)                       stacks push only
    H   = 2 / (N a_j) sum y[k] exp(-i (2 pi f t_k - pi / 2)) over the last WINDOW seconds
    tau_g = -(arg H(f_2) - arg H(f_1)) / (2 pi (f_2 - f_1))

| symbol | meaning |
| --- | --- |
| a_j, u_j0, u_max | reach of the input in the reference experiment, its start, its limit |
| f | TONE; f_1 and f_2 are half a hertz below and above |
| H, tau_g | response at the tone; group delay [s] |

The recorded step runs on tones, noise off, because linearisation cannot tell: an adaptive filter
has no equilibrium to linearise at, a converter's steps have derivatives of zero, and hysteresis
responds by the size of the motion. A tone of the size met in use shows what remains of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.kit.records import Scalar
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.pack.fmu import reference
from fmu_src.pack.fmu.reference import TONE, reach

SETTLING, WINDOW = 4.0, 2.0
"""Time before the measurement and of it [s]; a whole number of periods of all three tones."""
_BESIDE = 0.5
_CLEAN = 0.9
"""Least share of an output's variation that has to be at the tone, or there is no response."""
_LONG = 60_000
"""Samples, over all inputs, from which compiling takes less time than it saves."""
_FAINT = 1e-3
"""Weaker than that share of the strongest of its unit, an output does not follow any input."""


@dataclass(frozen=True)
class Response:
    """Of an output to the input of the same unit and axis, or else to the one that moves it most.

    Phase in degrees, positive where the output leads; group delay in seconds.
    """

    source: str
    output: str
    unit: str
    gain: float
    phase: float
    group_delay: float


@cache
def responses(model: Model) -> list[Response]:
    """Compute the responses of all outputs that follow an input; once for both flavours."""
    quiet = _without_noise(model)
    inputs = [s for s in model.variables["input"] if s.field.kind == "Real" and reach(s) > 0]
    outputs = [s for s in model.variables["output"] if s.field.kind == "Real"]
    if not inputs:
        return []
    make = _compiled if len(_times(model)) * len(inputs) >= _LONG else Runner
    at = np.column_stack([_at_tone(quiet, scalar, TONE, make) for scalar in inputs])
    moved = np.abs(at) * [reach(scalar) for scalar in inputs]
    chosen = {}
    for i, output in enumerate(outputs):
        same_unit = [k for k, other in enumerate(outputs) if other.field.unit == output.field.unit]
        twins = [j for j, s in enumerate(inputs) if _alike(s, output) and moved[i, j] > 0]
        j = max(twins or range(len(inputs)), key=lambda j: moved[i, j])
        if twins or moved[i, j] > _FAINT * moved[same_unit].max():
            chosen[i] = j
    turns = {}
    for j in set(chosen.values()):
        below, above = (
            _at_tone(quiet, inputs[j], TONE + side, make) for side in (-_BESIDE, _BESIDE)
        )
        turns[j] = np.angle(above * below.conj())
    return [
        Response(
            source=inputs[j].name,
            output=outputs[i].name,
            unit=_ratio(outputs[i].field.unit, inputs[j].field.unit),
            gain=float(np.abs(at[i, j])),
            phase=float(np.degrees(np.angle(at[i, j]))),
            group_delay=float(-turns[j][i] / (2 * np.pi * 2 * _BESIDE)),
        )
        for i, j in chosen.items()
    ]


def _without_noise(model: Model) -> Model:
    if not model.draws:
        return model

    def step(*arguments: Any, **derived: Any) -> Any:
        return model.step(*arguments, normal=np.zeros(model.draws), **derived)

    return replace(model, step=step, draws=0)


def _compiled(model: Model) -> Runner:
    """Return a compiled runner; where none can be compiled, a slower one with the same results."""
    try:
        return CompiledRunner(model)
    except SteadytipError:
        return Runner(model)


def _times(model: Model) -> np.ndarray:
    # What has no state has nothing to settle.
    settling = SETTLING if model.state.size() else 0.0
    return np.arange(round((settling + WINDOW) / model.sample_period)) * model.sample_period


def _at_tone(
    model: Model, scalar: Scalar, frequency: float, make: Callable[[Model], Runner]
) -> np.ndarray:
    """Compute H of every real output to one input; zero where the output is not a tone, too."""
    t = _times(model)
    u = np.tile(model.inputs.starts(), (len(t), 1))
    place = model.variables["input"].index(scalar)
    a = reach(scalar)
    centre = min(scalar.start + a, scalar.field.max - a)
    u[:, place] = centre + a * np.sin(2 * np.pi * frequency * t)
    real = [s.field.kind == "Real" for s in model.variables["output"]]
    last = round(WINDOW / model.sample_period)
    _, y = reference.outputs(model, u, make)
    y = y[-last:, real]
    y = y - y.mean(axis=0)
    turning = np.exp(-1j * (2 * np.pi * frequency * t[-last:] - np.pi / 2))
    amplitude = 2 / last * (turning @ y)
    clean = np.abs(amplitude) ** 2 / 2 > _CLEAN * (y**2).mean(axis=0)
    return np.where(clean, amplitude, 0) / a


def _alike(source: Scalar, output: Scalar) -> bool:
    """Tell whether both have the same unit, and the same axis if they have one."""
    axes = [scalar.name.rpartition("_")[2] for scalar in (source, output)]
    return source.field.unit == output.field.unit and axes[0] == axes[1]


def _ratio(over: str | None, under: str | None) -> str:
    return "" if over == under else f"{over or '1'} per {under or '1'}"
