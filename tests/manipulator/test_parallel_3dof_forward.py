"""The forward model against the inverse one, the instrument of `plants`, and differences."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from fmu_src.manipulator import parallel_3dof, parallel_3dof_forward
from fmu_src.manipulator.parallel_3dof import Geometry
from fmu_src.manipulator.parallel_3dof_forward import MODEL
from plants import instrument

NANOMETRE = 1e-9
UNEQUAL = {"base_radius": 8e-3, "platform_radius": 6e-3, "leg_length": 25e-3}


def _strokes(low: float, high: float, points: int = 9) -> np.ndarray:
    """On a grid, (points cubed, 3) [m]."""
    grid = np.linspace(low, high, points)
    return np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)


def _answers(strokes: np.ndarray, **parameters: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacements, (samples, 3), and Jacobians, (samples, 3, 3)."""
    run = Runner(MODEL, parameters).run(len(strokes), {"strokes": strokes})
    return run["displacement"], run["jacobian"]


@pytest.mark.parametrize("changes", [{}, UNEQUAL])
def test_inverse_model_brings_every_place_back_to_its_strokes(changes):
    strokes = _strokes(0.0, design.STACK_STROKE)
    places, _ = _answers(strokes, **changes)
    back = Runner(parallel_3dof.MODEL, changes).run(len(strokes), {"displacement": places})
    assert np.abs(back["strokes"] - strokes).max() < NANOMETRE
    again, _ = _answers(back["strokes"], **changes)
    assert np.abs(again - places).max() < NANOMETRE


@pytest.mark.parametrize("shaft_length", [20e-3, design.SHAFT_LENGTH])
def test_places_are_those_of_the_instrument(shaft_length):
    """Over the whole range of the plant's strokes, four times a stack's."""
    strokes = _strokes(-20e-6, 60e-6)
    places, _ = _answers(strokes, shaft_length=shaft_length)
    plant = Runner(instrument.MODEL, {"shaft_length": shaft_length})
    expected = plant.run(len(strokes), {"stroke": strokes})["deflection"]
    np.testing.assert_allclose(places, expected, atol=0.1 * NANOMETRE)


def test_jacobian_agrees_with_differences_of_the_instrument():
    strokes = _strokes(0.0, design.STACK_STROKE, 4)
    _, slopes = _answers(strokes)
    h = 1e-7
    plant = Runner(instrument.MODEL)
    for stack, change in enumerate(h * np.eye(3)):
        ahead, behind = (
            plant.run(len(strokes), {"stroke": strokes + side})["deflection"]
            for side in (change, -change)
        )
        np.testing.assert_allclose(slopes[:, :, stack], (ahead - behind) / (2 * h), atol=1e-6)


@pytest.mark.parametrize("changes", [{}, UNEQUAL, {"base_radius": 3e-3, "lever_gain": 20.0}])
def test_jacobian_agrees_with_differences_of_the_places(changes):
    strokes = _strokes(-10e-6, 90e-6, 4)
    _, slopes = _answers(strokes, **changes)
    h = 1e-7
    for stack, change in enumerate(h * np.eye(3)):
        ahead, behind = (_answers(strokes + side, **changes)[0] for side in (change, -change))
        difference = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(slopes[:, :, stack], difference, rtol=1e-6, atol=1e-5)


def test_jacobian_at_rest_is_that_of_a_lever():
    """A leg lifts the centre by a third of what it extends, and tilts by 2 / (3 r) of it."""
    _, (slope,) = _answers(np.zeros((1, 3)))
    tilt = 2 / 3 * design.SHAFT_LENGTH / design.PLATFORM_RADIUS
    angles = np.radians([0.0, 120.0, 240.0])
    rows = [-tilt * np.cos(angles), -tilt * np.sin(angles), np.full(3, 1 / 3)]
    np.testing.assert_allclose(slope, design.LEVER_GAIN * np.array(rows), atol=1e-12)


def test_newton_has_converged_over_the_range_of_the_input(monkeypatch):
    strokes = _strokes(-20e-6, 1e-4, 5)
    p = Geometry.unpack(ca.SX(Geometry.starts()))

    def places() -> np.ndarray:
        argument = ca.SX.sym("argument", 3)
        forward = ca.Function("forward", [argument], [parallel_3dof.forward(p, argument)])
        return np.array(forward(strokes.T))

    few = places()
    monkeypatch.setattr(parallel_3dof, "NEWTON_STEPS", 10)
    assert np.abs(few - places()).max() < 1e-15


@settings(max_examples=200)
@given(
    st.tuples(*[st.floats(s.field.min, s.field.max) for s in Geometry.scalars()]),
    st.tuples(*[st.floats(-20e-6, 1e-4)] * 3),
)
def test_answers_are_finite_for_every_mechanism(dimensions, strokes):
    parameters = dict(zip(Geometry.fields, dimensions, strict=True))
    for answer in _answers(np.array([strokes]), **parameters):
        assert np.isfinite(answer).all()


def test_cost_is_a_few_microseconds():
    """Some 2 ns an instruction on a desktop machine."""
    assert parallel_3dof_forward.MODEL.step_function.n_instructions() < 1500
