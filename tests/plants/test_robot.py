"""The robot's motion is one: rates and accelerations are derivatives of pose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from fmu_src.kit.runner import Runner
from plants.robot import MODEL

T = MODEL.sample_period
QUICK = {"move_time": 0.5, "ramp_time": 0.1, "dwell": 0.05}
ANGLES = arrays(float, 3, elements=st.floats(-2, 2))


def slope(values):
    return (values[2:] - values[:-2]) / (2 * T)


@settings(max_examples=15)
@given(ANGLES, ANGLES, ANGLES, st.booleans())
def test_rates_and_accelerations_are_derivatives_of_the_pose(rest, start, end, one_by_one):
    arm = np.array([0.1, -0.2, 0.15])
    parameters = QUICK | {"rest": rest, "start": start, "end": end, "arm": arm, "pivot": [1, 2, 3]}
    parameters["one_by_one"] = one_by_one
    out = Runner(MODEL, parameters).run(1100)
    R = Rotation.from_quat(out["attitude"], scalar_first=True)
    np.testing.assert_allclose(out["body"], np.array([1, 2, 3]) + R.apply(arm), atol=1e-12)
    turned = (R[:-2].inv() * R[2:]).as_rotvec() / (2 * T)
    fastest = 1 + np.abs(out["rate"]).max() ** 2
    np.testing.assert_allclose(turned, out["rate"][1:-1], atol=2e-3 * fastest)
    hardest = 1 + np.abs(out["angular_acceleration"]).max()
    np.testing.assert_allclose(
        slope(out["rate"]), out["angular_acceleration"][1:-1], atol=2e-2 * hardest
    )
    velocity = slope(out["body"])
    np.testing.assert_allclose(
        slope(velocity), out["body_acceleration"][2:-2], atol=1e-2 * hardest * fastest
    )


def test_robot_turns_at_a_constant_rate_there_and_back():
    """-9 deg/s about x, as in C23 3.1.3."""
    end = [np.radians(-9 * 4.8), 0.0, 0.0]
    parameters = {"end": end, "move_time": 5.0, "ramp_time": 0.2, "dwell": 1.0}
    out = Runner(MODEL, parameters).run(12_000)
    between = out["rate"][1300:5700]
    np.testing.assert_allclose(between, np.tile([np.radians(-9), 0, 0], (4400, 1)), atol=1e-12)
    np.testing.assert_allclose(out["rate"][7300:11_700, 0], np.radians(9), atol=1e-12)
    np.testing.assert_array_equal(out["rate"][:1000], 0)
    ends = Rotation.from_quat(out["attitude"][[500, 6500, 11_999]], scalar_first=True)
    np.testing.assert_allclose(ends.as_rotvec()[:, 0], [0, end[0], 0], atol=1e-4)
    assert out["moving"].max() == pytest.approx(1)
    assert out["moving"][6500] == 0
