"""Distortion, jitter and timing of the electromagnetic tracker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmu_src.kit.runner import Runner
from plants.em_tracker import MODEL

T = 1e-3
CLEAN = {"jitter_attitude": 0.0, "jitter_position": 0.0, "room_radii": 0.0}
INSTANT = {"rate": 1000.0, "latency": 0.0}
GENERATOR = np.array([0.3, 0.0, 0.0])


def quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def run(samples, parameters=None, **inputs):
    return Runner(MODEL, parameters).run(samples, inputs)


def error(out, truth):
    return (Rotation.from_quat(out["em_attitude"], scalar_first=True) * truth.inv()).as_rotvec()


def dipole(r):
    distance = np.linalg.norm(r)
    u = r / distance
    return (3 * np.outer(u, u) - np.eye(3)) / distance**3


def test_without_metal_and_jitter_the_pose_is_the_true_one():
    turn, origin = Rotation.from_rotvec([0.3, -1.2, 0.5]), np.array([0.4, 0.1, -0.3])
    mounting, lever = Rotation.from_rotvec([-0.2, 0.4, 1.0]), np.array([0.01, 0.02, -0.05])
    parameters = CLEAN | {
        "registration": turn.as_rotvec(),
        "origin": origin,
        "mounting": mounting.as_rotvec(),
        "lever": lever,
        "metal_radius": 0.0,
    }
    attitude, place = Rotation.from_euler("xyz", [120, -50, 30], degrees=True), [0.05, 0.1, -0.1]
    out = run(100, parameters, body=place, attitude=quaternion(attitude))
    last = turn.inv() * attitude * mounting
    assert np.linalg.norm(error(out, last)[-1]) < 1e-7
    where = turn.inv().apply(np.array(place) + attitude.apply(lever) - origin)
    np.testing.assert_allclose(out["em_position"][-1], where, atol=1e-12)
    assert run(1, parameters)["distortion"] == pytest.approx(0)


def test_distortion_is_that_of_two_coils_in_the_field_of_a_sphere():
    """Fields of generator and sphere written out here; SciPy fits the attitude to both coils."""
    metal, radius, place = np.array([0.08, 0.08, 0.05]), 0.015, np.array([0.02, -0.03, 0.01])
    attitude = Rotation.from_euler("xyz", [20, 40, 10], degrees=True)
    out = run(
        1,
        CLEAN | INSTANT | {"metal_radius": radius},
        body=place,
        attitude=quaternion(attitude),
        metal=metal,
    )
    first = dipole(place - GENERATOR)
    second = -(radius**3) / 2 * dipole(place - metal) @ dipole(metal - GENERATOR)
    coils = attitude.as_matrix()[:, :2]
    felt = np.linalg.solve(first.T, (first + second).T @ coils)  # as if in the first field alone
    fitted, _ = Rotation.align_vectors((felt / np.linalg.norm(felt, axis=0)).T, coils.T)
    expected = fitted.as_rotvec()
    assert np.linalg.norm(expected) > np.radians(0.005)
    # Softened dipoles: a few hundredths.
    np.testing.assert_allclose(out["distortion"][0], expected, atol=0.07 * np.linalg.norm(expected))
    np.testing.assert_allclose(error(out, attitude)[0], out["distortion"][0], atol=1e-7)


def test_distortion_grows_as_metal_comes_near_and_depends_on_attitude():
    distances = np.linspace(0.4, 0.06, 60)
    metal = np.outer(distances, [0.0, 1.0, 0.3])
    out = run(60, CLEAN | INSTANT, metal=metal)
    size = np.linalg.norm(out["distortion"], axis=1)
    assert (np.diff(size) > 0).all()
    assert size[0] < np.radians(0.05)
    assert np.radians(2) < size[-1] < np.radians(15)
    turned = run(
        1, CLEAN | INSTANT, metal=metal[-1], attitude=quaternion(Rotation.from_rotvec([0, 1, 1]))
    )
    gap = np.linalg.norm(turned["distortion"][0] - out["distortion"][-1])
    assert gap > 0.1 * size[-1]


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_distortion_is_smooth(seed):
    """10 cm from the metal, 1 mm or 1 mrad change it by a small share of its usual 1.5 deg."""
    rng = np.random.default_rng(seed)
    place, attitude = rng.uniform(-0.1, 0.1, 3), Rotation.random(random_state=rng)
    metal = place + 0.1 * Rotation.random(random_state=rng).apply([0, 0, 1])
    turned = attitude * Rotation.from_rotvec([1e-3, 0, 0])
    places = np.array([place, place + np.array([1e-3, 0, 0]), place])
    attitudes = quaternion(Rotation.concatenate([attitude, attitude, turned]))
    d = run(3, CLEAN | INSTANT, body=places, attitude=attitudes, metal=metal)["distortion"]
    assert np.linalg.norm(d[1] - d[0]) < 0.1 * np.radians(1.5)
    assert np.linalg.norm(d[2] - d[0]) < 0.01 * np.radians(1.5)


def test_jitter_grows_with_the_distance_from_the_generator():
    parameters = INSTANT | {"metal_radius": 0.0, "room_radii": 0.0}
    spread = []
    for distance in (0.1, 0.4, 0.5):
        out = run(3000, parameters, body=GENERATOR - [distance, 0, 0])
        spread.append(error(out, Rotation.identity()).std())
    base = np.radians(0.1)
    expected = [base * (1 + (d / 0.4) ** 4) for d in (0.1, 0.4, 0.5)]
    np.testing.assert_allclose(spread, expected, rtol=0.04)


def test_rate_latency_and_reach():
    out = run(1000)
    new = np.flatnonzero(out["em_new"])
    assert len(new) == 39
    assert new[0] == 25
    np.testing.assert_array_equal(np.diff(new), 25)
    np.testing.assert_allclose(out["em_age"][new], 0.025, atol=1e-9)
    assert not run(200, body=[-0.5, 0.0, 0.0])["em_new"].any()


def test_losses_on_demand_and_at_random():
    assert not run(200, lost=True)["em_new"].any()
    share = run(20_000, INSTANT | {"loss": 0.3})["em_new"].mean()
    assert share == pytest.approx(0.7, abs=0.02)
    assert not run(200, {"loss": 1.0})["em_new"].any()
