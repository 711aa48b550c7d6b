"""Timing, least-squares pose, occlusion and drop-out of the optical tracker."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from plants.optical_tracker import MODEL

LAYOUT = np.array(design.MARKERS)

T = 1e-3
QUIET = {"noise_across": 0.0, "noise_along": 0.0}


def quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def moving(samples):
    """A turn about a fixed axis while the body moves along a line: time, place, attitude."""
    t = T * np.arange(samples)
    attitude = Rotation.from_euler("xyz", [20, 40, 10], degrees=True) * Rotation.from_rotvec(
        np.outer(0.5 * t, [0.6, -0.7, 0.387298])
    )
    return t, np.outer(t, [0.01, -0.02, 0.03]), attitude


def run(samples, parameters=None, **inputs):
    return Runner(MODEL, parameters).run(samples, inputs)


def markers_of(out):
    return np.stack([out[f"optical_marker{i + 1}"] for i in range(4)], axis=1)


@settings(max_examples=20)
@given(st.floats(5.0, 1000.0), st.floats(0.0, 0.1))
def test_pose_arrives_at_its_rate_with_its_age(rate, latency):
    latency = min(latency, 6 / rate)  # more than eight packets under way are lost
    samples = 400
    t, place, attitude = moving(samples)
    out = run(
        samples,
        QUIET | {"rate": rate, "latency": latency},
        body=place,
        attitude=quaternion(attitude),
    )
    new = np.flatnonzero(out["optical_new"])
    arrivals = (samples * T - latency) * rate
    assert len(new) == pytest.approx(arrivals, abs=2)
    age = out["optical_age"][new]
    assert (age >= latency - 1e-9).all()
    assert (age < latency + T).all()
    seen = np.round((t[new] - age) / T).astype(int)
    np.testing.assert_allclose(out["optical_position"][new], place[seen], atol=1e-12)
    found = Rotation.from_quat(out["optical_attitude"][new], scalar_first=True)
    assert (attitude[seen].inv() * found).magnitude().max() < 1e-7


def test_layout_fits_the_markers_by_least_squares():
    """SciPy's Kabsch fit of the layout to the markers that come out, with 20 times the noise."""
    noise = {"noise_across": 1e-3, "noise_along": 3e-3, "rate": 1000.0, "latency": 0.0}
    attitude = Rotation.from_euler("xyz", [100, -40, 10], degrees=True)
    place = np.array([0.1, -0.2, 0.3])
    out = run(300, noise, body=place, attitude=quaternion(attitude))
    gaps, scatter = [], []
    for k, points in enumerate(markers_of(out)):
        middle = points.mean(axis=0)
        fitted, _ = Rotation.align_vectors(points - middle, LAYOUT - LAYOUT.mean(axis=0))
        found = Rotation.from_quat(out["optical_attitude"][k], scalar_first=True)
        gaps.append((fitted.inv() * found).magnitude())
        scatter.append((attitude.inv() * found).magnitude())
        origin = middle - fitted.apply(LAYOUT.mean(axis=0))
        np.testing.assert_allclose(out["optical_position"][k], origin, atol=2e-4)
    # Of second order in the noise, which is a twentieth of the layout here.
    assert np.sqrt(np.mean(np.square(gaps))) < 0.1 * np.sqrt(np.mean(np.square(scatter)))


def test_noise_is_larger_along_the_line_of_sight():
    camera = {"camera": (0.0, 0.0, 2.0), "rate": 1000.0, "latency": 0.0}
    out = run(4000, camera)
    errors = (markers_of(out) - LAYOUT).reshape(-1, 3)
    np.testing.assert_allclose(errors.std(axis=0), [5e-5, 5e-5, 1.5e-4], rtol=0.03)


def test_marker_fewer_leaves_a_pose_with_more_noise_and_two_fewer_none():
    whole = run(3000, {"rate": 1000.0, "latency": 0.0})
    three = run(3000, {"rate": 1000.0, "latency": 0.0}, hidden_4=True)
    two = run(3000, {"rate": 1000.0, "latency": 0.0}, hidden_1=True, hidden_4=True)
    noise = [
        Rotation.from_quat(out["optical_attitude"], scalar_first=True).magnitude().std()
        for out in (whole, three)
    ]
    assert three["optical_new"].all()
    assert not three["optical_visible4"].any()
    assert noise[1] > noise[0]
    assert not two["optical_new"].any()
    assert two["optical_markers_new"].all()
    np.testing.assert_array_equal(two["optical_visible2"], 1)
    np.testing.assert_allclose(two["optical_marker2"].mean(axis=0), LAYOUT[1], atol=1e-5)


def test_markers_on_a_line_give_no_pose():
    line = np.outer([-0.05, 0.0, 0.03, 0.06], [1.0, 0.0, 0.0])
    out = run(200, {"markers": line})
    assert out["optical_markers_new"].any()
    assert not out["optical_new"].any()


def test_occlusion_on_demand_hides_what_is_exposed_then():
    """Occluded from 100 to 200 ms; the packets arrive 16 ms after their exposure."""
    samples = 400
    occluded = np.zeros(samples)
    occluded[100:200] = 1
    out = run(samples, occluded=occluded)
    new = np.flatnonzero(out["optical_new"])
    exposed = new - 16
    assert len(new) > 10
    assert not ((exposed >= 100) & (exposed < 200)).any()
    assert ((exposed >= 200) & (exposed < 220)).any()
    assert ((exposed >= 80) & (exposed < 100)).any()


def test_occlusion_from_the_first_sample_on_tells_nothing():
    out = run(300, occluded=True)
    assert not out["optical_new"].any()
    assert not out["optical_markers_new"].any()
    np.testing.assert_array_equal(out["optical_position"], 0)


def test_random_occlusions_and_dropouts_have_their_rate_and_length():
    parameters = {
        "rate": 1000.0,
        "latency": 0.0,
        "occlusion_rate": 2.0,
        "occlusion_time": 0.05,
        "dropout_rate": 4.0,
        "dropout_time": 0.1,
    }
    out = run(40_000, parameters)
    dark = 1 - out["optical_markers_new"]
    # Ends after a mean of 50 ms, begins 2 times a second of clear sight: a share of 1 / 11.
    assert dark.mean() == pytest.approx(0.1 / 1.1, rel=0.4)
    lengths = [len(list(run_of)) for is_dark, run_of in itertools.groupby(dark) if is_dark]
    assert np.mean(lengths) == pytest.approx(50, rel=0.4)
    clear = out["optical_markers_new"] > 0
    hidden = 1 - np.mean([out[f"optical_visible{i + 1}"][clear].mean() for i in range(4)])
    assert hidden == pytest.approx(0.4 / 1.4, rel=0.2)


def test_tracker_frame_and_clock():
    turn, origin = Rotation.from_rotvec([0.3, -1.2, 0.5]), np.array([0.4, 0.1, -0.3])
    parameters = QUIET | {
        "registration": turn.as_rotvec(),
        "origin": origin,
        "clock_error": 0.004,
    }
    samples = 200
    _, place, attitude = moving(samples)
    out = run(samples, parameters, body=place, attitude=quaternion(attitude))
    new = np.flatnonzero(out["optical_new"])
    np.testing.assert_allclose(out["optical_age"][new], 0.012, atol=1e-9)
    seen = new - 16
    np.testing.assert_allclose(
        out["optical_position"][new], turn.inv().apply(place[seen] - origin), atol=1e-12
    )
    found = Rotation.from_quat(out["optical_attitude"][new], scalar_first=True)
    assert ((turn.inv() * attitude[seen]).inv() * found).magnitude().max() < 1e-7
