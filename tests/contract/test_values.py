"""Limits: refused with name, value and bound, nothing set; and finite outputs inside them."""

import math

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmu_src.kit.records import Scalar


def settable(model) -> list[tuple[int, Scalar]]:
    """Reference and declaration of the first real of each settable group."""
    found, reference = [], 0
    for causality, scalars in model.variables.items():
        reals = [(reference + i, s) for i, s in enumerate(scalars) if s.field.kind == "Real"]
        if causality in ("parameter", "input") and reals:
            found.append(reals[0])
        reference += len(scalars)
    return found


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused_by_name(model, start, value) -> None:
    instance = start()
    for reference, scalar in settable(model):
        if scalar.field in [s.field for s in model.variables["parameter"]]:
            instance.fmu.reset()
        before = len(instance.messages)
        with pytest.raises(FMICallException):
            instance.fmu.setReal([reference], [value])
        (message,) = instance.messages[before:]
        assert scalar.name in message
        assert str(abs(value)) in message


def test_values_out_of_range_are_refused_with_their_bound(model, start) -> None:
    instance = start()
    for reference, scalar in settable(model):
        if not math.isfinite(scalar.field.max):
            continue
        instance.fmu.reset()
        beyond = scalar.field.max + 1 + abs(scalar.field.max)
        with pytest.raises(FMICallException):
            instance.fmu.setReal([reference], [beyond])
        assert f"{scalar.name} = {beyond:.9g} must be" in instance.messages[-1]
        assert f"{scalar.field.max:.9g}" in instance.messages[-1]


def test_refusal_sets_none_of_the_values(model, start) -> None:
    reals = [
        (i, s)
        for i, s in enumerate([s for group in model.variables.values() for s in group])
        if s in model.variables["input"] and s.field.kind == "Real"
    ]
    if len(reals) < 2:
        pytest.skip("fewer than two real inputs")
    instance = start()
    before = instance.values()
    (first, scalar), (second, _) = reals[:2]
    with pytest.raises(FMICallException):
        instance.fmu.setReal([first, second], [scalar.start + 1e-6, math.nan])
    np.testing.assert_array_equal(instance.values(), before)


def test_extreme_inputs_inside_the_ranges_give_finite_outputs(model, start) -> None:
    """Random corners of the input box for 150 samples, then rest: every value stays finite."""
    rng = np.random.default_rng(5)
    instance = start()
    scalars = model.variables["input"]
    for k in range(300):
        row = {}
        for scalar in scalars:
            low = max(scalar.field.min, -1e3)
            high = min(scalar.field.max, 1e3)
            row[scalar.name] = rng.choice([low, high]) if k < 150 else scalar.start
            if scalar.field.kind == "Boolean":
                row[scalar.name] = float(rng.integers(2))
        instance.apply(row)
        instance.step()
        assert np.isfinite(instance.values()).all()


def test_start_values_of_the_binary_are_those_of_the_description(model, start) -> None:
    instance = start()
    values = instance.values()
    for variable, value in zip(instance.variables, values, strict=True):
        if variable.causality in ("parameter", "input"):
            declared = {"true": 1.0, "false": 0.0}.get(variable.start) or float(
                variable.start if variable.start not in ("true", "false") else 0
            )
            assert value == declared


def test_outputs_before_the_first_step_are_those_of_the_first_sample(start, inputs) -> None:
    instance = start(**inputs(3))
    before = instance.outputs()
    instance.step()
    np.testing.assert_array_equal(instance.outputs(), before)


def test_declared_names_are_legal_and_described(model) -> None:
    names = [s.name for group in model.variables.values() for s in group]
    assert len(names) == len(set(names))
    for scalar in model.variables["input"] + model.variables["output"]:
        assert scalar.name.isidentifier()
    for group in model.variables.values():
        for scalar in group:
            assert scalar.field.description.strip()
