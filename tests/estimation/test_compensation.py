"""The measurement model against its forward form, solved here by iteration with NumPy alone."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import compensation
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit.runner import Runner

AXES = [axis for _, axis in kinematics.PLACES]
OTHER = [1, 0, 3, 2, 5, 4]
"""In-plane partner of each channel: the other one of its site."""
OUT = [(2, 5), (2, 5), (0, 4), (0, 4), (1, 3), (1, 3)]
"""Channels of the third axis: y for site 1, x for site 2, z for site 3."""


class _Both(compensation.Parameters):
    accelerometer = compensation.Accelerometer
    magnetometer = compensation.Magnetometer
    thermometer = compensation.Thermometer


def _function() -> ca.Function:
    p, volts, t = ca.SX.sym("p", _Both.size()), ca.SX.sym("v", 9), ca.SX.sym("t")
    both = _Both.unpack(p)
    alignment = compensation.align(both.accelerometer, both.magnetometer)
    at = (t, both.thermometer.reference, alignment)
    outputs = [
        compensation.specific_forces(both.accelerometer, volts[:6], *at),
        compensation.magnetic_field(both.magnetometer, volts[6:], *at),
        alignment.scale_is_positive,
    ]
    return ca.Function("compensate", [p, volts, t], outputs)


COMPENSATE = _function()
NAMES = [scalar.name for scalar in _Both.scalars()]
LIMITS = [(scalar.field.min, scalar.field.max) for scalar in _Both.scalars()]


def _parameters(**values) -> np.ndarray:
    p = _Both.starts()
    for path, value in values.items():
        name = path.replace("__", ".")
        at = [i for i, known in enumerate(NAMES) if known.split("[")[0] == name]
        p[at] = np.broadcast_to(np.asarray(value, dtype=float), len(at))
    return p


def _compensate(p, volts, temperature=22.0):
    force, field, sound = COMPENSATE(p, volts, temperature)
    return np.array(force).ravel(), np.array(field).ravel(), bool(sound)


def sensing_axis(axis: int, components) -> np.ndarray:
    row = np.insert(np.asarray(components, dtype=float), axis, 0.0)
    row[axis] = np.sqrt(1 - np.sum(row**2))
    return row


def sensed(force: np.ndarray, c: dict) -> np.ndarray:
    """What the linear model makes of a body's specific force: (3.4) with (3.16), by iteration."""
    a = np.array([sensing_axis(AXES[i], c["misalignment"][i]) @ force for i in range(6)])
    s = a.copy()
    before = np.zeros(6)
    while np.abs(s - before).max() > 1e-12:
        before = s
        k = np.array([(s[i] + s[j]) / 2 for i, j in OUT])
        j = s[OTHER]
        s = (
            a * (1 + c["scale_slope"] * k + c["scale_curvature"] * k**2)
            + c["in_plane"] * j
            + c["in_plane_squared"] * j**2
            + c["out_of_plane"] * k
            + c["out_of_plane_squared"] * k**2
        )
    return s


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), arrays(float, 3, elements=st.floats(-12, 12)))
def test_the_compensation_inverts_the_model(seed, force):
    """Coefficients as large as those of raw sensors; the same body force at every site."""
    rng = np.random.default_rng(seed)
    size = {
        "in_plane": 0.03,
        "in_plane_squared": 5e-3,
        "out_of_plane": 0.03,
        "out_of_plane_squared": 5e-3,
        "scale_slope": 2e-3,
        "scale_curvature": 2e-4,
    }
    c = {name: rng.uniform(-most, most, 6) for name, most in size.items()}
    c["misalignment"] = rng.uniform(-0.1, 0.1, (6, 2))
    zero, scale = rng.uniform(2.4, 2.6, 6), design.ACCELEROMETER_SCALE * rng.uniform(0.95, 1.05, 6)
    volts = np.append(zero + scale * sensed(force, c), [2.5] * 3)
    p = _parameters(
        accelerometer__zero=zero,
        accelerometer__scale=scale,
        **{f"accelerometer__{name}": value.flatten(order="F") for name, value in c.items()},
    )
    found, _, sound = _compensate(p, volts)
    assert sound
    np.testing.assert_allclose(found, force[AXES], atol=1e-9)


@settings(max_examples=150)
@given(
    st.lists(st.sampled_from([0.0, 0.5, 1.0]) | st.floats(0, 1), min_size=len(NAMES),
             max_size=len(NAMES)),
    arrays(float, 9, elements=st.floats(0, 5)),
    st.floats(-40, 125),
)  # fmt: skip
def test_every_input_and_every_parameter_in_range_gives_numbers(shares, volts, temperature):
    p = np.array([low + share * (high - low) for share, (low, high) in zip(shares, LIMITS,
                  strict=True)])  # fmt: skip
    force, field, _ = _compensate(p, volts, temperature)
    assert np.isfinite(force).all()
    assert np.isfinite(field).all()


@settings(max_examples=60)
@given(arrays(float, 9, elements=st.floats(0, 5)), st.floats(-40, 125))
def test_at_the_starts_it_is_the_data_sheet_to_the_bit(volts, temperature):
    force, field, sound = _compensate(_Both.starts(), volts, temperature)
    assert sound
    np.testing.assert_array_equal(force, (volts[:6] - 2.5) / design.ACCELEROMETER_SCALE)
    np.testing.assert_array_equal(field, (volts[6:] - 2.5) / design.MAGNETOMETER_SCALE)


def test_temperature_moves_zero_and_scale():
    p = _parameters(
        accelerometer__zero_drift=1e-3,
        accelerometer__scale_drift=-1e-3,
        magnetometer__zero_drift=2e-3,
        magnetometer__scale_drift=-3e-3,
        thermometer__reference=20.0,
    )
    force, field, _ = _compensate(p, np.full(9, 3.0), 30.0)
    np.testing.assert_allclose(force, (0.5 - 0.01) / (0.99 * design.ACCELEROMETER_SCALE))
    np.testing.assert_allclose(field, (0.5 - 0.02) / (0.97 * design.MAGNETOMETER_SCALE))


def test_soft_iron_and_scales_of_the_magnetometer():
    """Any matrix near the identity is a scale for each row and a direction."""
    matrix = np.array([[1.1, 0.05, -0.08], [0.02, 0.93, 0.1], [-0.06, 0.03, 1.02]])
    field = np.array([2e-5, -3e-5, 4e-5])
    lengths = np.linalg.norm(matrix, axis=1)
    rows = matrix / lengths[:, None]
    components = np.array([np.delete(rows[i], i) for i in range(3)])
    volts = np.append([2.5] * 6, 2.6 + 1e4 * matrix @ field)
    p = _parameters(
        magnetometer__zero=2.6,
        magnetometer__scale=1e4 * lengths,
        magnetometer__misalignment=components.flatten(order="F"),
    )
    np.testing.assert_allclose(_compensate(p, volts)[1], field, rtol=1e-9)


@pytest.mark.parametrize(("slope", "curvature", "sound"), [(0, 0, True), (0.05, 0, False),
                         (0, -5e-3, False), (0.01, 1e-4, True), (0, 5e-3, True)])  # fmt: skip
def test_a_scale_that_vanishes_in_the_span_is_told(slope, curvature, sound):
    """Of 49 m/s2, at 1 V/g and 5 V; and what comes out is still a number of bounded size."""
    p = _parameters(accelerometer__scale_slope=slope, accelerometer__scale_curvature=curvature)
    rng = np.random.default_rng(5)
    for volts in rng.uniform(0, 5, (50, 9)):
        force, _, told = _compensate(p, volts)
        assert told == sound
        assert np.abs(force).max() <= 25 / compensation.LEAST_SCALE


def test_the_estimator_passes_temperature_and_coefficients_on():
    """Its outputs `force` and `field` are those of the compensation."""
    parameters = {
        "accelerometer.zero_drift": [1e-3] * 6,
        "accelerometer.in_plane_squared": [2e-3] * 6,
        "accelerometer.misalignment": np.full((6, 2), 0.02),
        "magnetometer.misalignment": np.full((3, 2), -0.03),
    }
    volts = np.array([2.6, 3.4, 2.4, 3.45, 2.7, 2.45, 2.7, 2.55, 2.1])
    out = Runner(MODEL, parameters).run(1, {"volts": volts, "temperature": 35.0})
    p = _parameters(
        accelerometer__zero_drift=1e-3,
        accelerometer__in_plane_squared=2e-3,
        accelerometer__misalignment=0.02,
        magnetometer__misalignment=-0.03,
    )
    force, field, _ = _compensate(p, volts, 35.0)
    np.testing.assert_allclose(out["force"][0], force, rtol=1e-12)
    np.testing.assert_allclose(out["field"][0], field / np.linalg.norm(field), rtol=1e-6)
