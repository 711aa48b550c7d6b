"""Directional derivatives of the native FMU against differences over one step."""

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException


def test_directional_derivatives_equal_differences_over_a_step(model, start, inputs) -> None:
    """Every real input at once in a random direction, at several points of a run.

    Where a model switches (a play, a limit, a converter's step) no derivative exists; both sides of
    the point then disagree, and such outputs are left out, but never all of them.
    """
    instance = start()
    if not model.derivatives:
        pytest.skip("this model gives none")
    reals = [v for v in instance.variables if v.type == "Real"]
    known = [v for v in reals if v.causality == "input"]
    unknown = [v for v in reals if v.causality == "output"]
    references = [[v.valueReference for v in vs] for vs in (known, unknown)]
    rng = np.random.default_rng(6)
    compared = 0
    for k in range(60):
        instance.apply(inputs(k))
        if k % 10 == 9:
            base = np.array(instance.fmu.getReal(references[0]))
            h = 1e-6 * np.maximum(np.abs(base), 1e-3)
            direction = h * rng.uniform(-1, 1, len(known))
            slope = np.array(
                instance.fmu.getDirectionalDerivative(references[1], references[0], direction)
            )
            state = instance.fmu.getFMUState()
            sides = []
            for sign in (-1.0, 0.0, 1.0):
                instance.fmu.setFMUState(state)
                instance.fmu.setReal(references[0], (base + sign * direction).tolist())
                instance.fmu.doStep(instance.time, instance.period)
                sides.append(np.array(instance.fmu.getReal(references[1])))
            instance.fmu.setFMUState(state)
            instance.fmu.freeFMUState(state)
            left, right = sides[1] - sides[0], sides[2] - sides[1]
            size = np.maximum(np.abs(left), np.abs(right)) + 1e-9 * np.abs(sides[1]) + 1e-300
            smooth = np.abs(right - left) <= 1e-3 * size
            gap = np.abs((left + right) / 2 - slope)
            assert (gap <= 1e-3 * size)[smooth].all(), unknown[int(np.argmax(gap * smooth))].name
            compared += int(smooth.sum())
        instance.step()
    assert compared > 0


def test_only_outputs_by_inputs_are_offered(model, start) -> None:
    instance = start()
    output = next(v for v in instance.variables if v.causality == "output" and v.type == "Real")
    with pytest.raises(FMICallException):
        instance.fmu.getDirectionalDerivative(
            [output.valueReference], [output.valueReference], [1.0]
        )
    reason = "knowns are inputs only" if model.derivatives else "Derivative is false"
    assert reason in instance.messages[-1]
