"""The reader of BROAD: units, frames, lost samples, what an estimator gets and when."""

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from fmu_src.errors import SteadytipError
from harness.reproduce.experiments import broad

RATE = 2000.0 / 7.0


def scalar_first(rotation):
    return np.roll(rotation.as_quat(), 1, axis=-1)


@pytest.fixture
def content():
    """Variables of a trial of 40 samples."""
    random = np.random.default_rng(6)
    return {
        "imu_gyr": random.normal(size=(40, 3)),
        "imu_acc": random.normal(size=(40, 3)),
        "imu_mag": 40.0 * random.normal(size=(40, 3)),
        "opt_quat": scalar_first(Rotation.random(40, random_state=6)),
        "opt_pos": random.normal(size=(40, 3)),
        "movement": np.arange(40)[:, np.newaxis] >= 5,
        "sampling_rate": np.array([[RATE]]),
    }


@pytest.fixture
def read(tmp_path, content):
    def read(**changes):
        path = tmp_path / "trial.mat"
        savemat(path, {k: v for k, v in {**content, **changes}.items() if v is not None})
        return broad.read_trial(path)

    return read


def test_units_are_si_and_the_world_has_its_x_axis_north(read, content):
    trial = read()
    assert trial.name == "trial"
    assert trial.time[-1] == pytest.approx(39 / RATE)
    np.testing.assert_array_equal(trial.rate, content["imu_gyr"])
    np.testing.assert_allclose(trial.field, 1e-6 * content["imu_mag"])
    east, north, up = content["opt_pos"].T
    np.testing.assert_array_equal(trial.position, np.column_stack([north, -east, up]))
    # The same vector of the body, in both worlds.
    along = Rotation.from_quat(np.roll(content["opt_quat"], -1, axis=1)).apply([1.0, 2.0, 3.0])
    ours = Rotation.from_quat(np.roll(trial.attitude, -1, axis=1)).apply([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        ours, np.column_stack([along[:, 1], -along[:, 0], along[:, 2]]), atol=1e-12
    )


def test_a_lost_sample_keeps_the_one_before_it_and_is_told(read, content):
    for name, rows in {"imu_mag": [0, 7], "opt_quat": [0, 1, 9], "opt_pos": [9, 10]}.items():
        content[name][rows, 0] = np.nan
    trial = read()
    assert np.flatnonzero(~trial.inertial_valid).tolist() == [0, 7]
    np.testing.assert_array_equal(trial.rate[[0, 7]], [[0, 0, 0], content["imu_gyr"][6]])
    assert np.flatnonzero(~trial.optical_seen).tolist() == [0, 1, 9, 10]
    np.testing.assert_array_equal(trial.attitude[:2], [[1, 0, 0, 0]] * 2)
    np.testing.assert_array_equal(trial.position[10], trial.position[8])
    assert np.flatnonzero(trial.scored(0.0)).tolist() == [*range(5, 9), *range(11, 40)]
    for values in (trial.rate, trial.force, trial.field, trial.attitude, trial.position):
        assert np.isfinite(values).all()


def test_an_estimator_gets_every_tenth_pose_and_no_other(read, content):
    content["opt_quat"][20] = np.nan
    trial = read()
    new = trial.thinned(10)
    assert np.flatnonzero(new).tolist() == [0, 10, 30]
    inputs = trial.optical(new)
    held = inputs["optical_position"]
    np.testing.assert_array_equal(held[:10], np.tile(trial.position[0], (10, 1)))
    np.testing.assert_array_equal(held[10:30], np.tile(trial.position[10], (20, 1)))
    assert broad.since(new)[[0, 9, 10, 29, 39]].tolist() == [0, 9, 0, 19, 9]
    gone = broad.occluded(new, [(5, 15)])
    assert np.flatnonzero(gone).tolist() == [0, 30]


def test_a_late_pose_arrives_with_its_age(read):
    trial = read()
    inputs = trial.optical(trial.thinned(10, first=4), late=3, name="em")
    assert np.flatnonzero(inputs["em_new"]).tolist() == [7, 17, 27, 37]
    np.testing.assert_array_equal(inputs["em_attitude"][17], trial.attitude[14])
    np.testing.assert_array_equal(inputs["em_position"][:7], np.zeros((7, 3)))
    np.testing.assert_array_equal(inputs["em_attitude"][6], [1, 0, 0, 0])
    assert inputs["em_age"][7] == pytest.approx(3 / RATE)
    assert broad.since(inputs["em_new"] > 0)[6] == -1


def test_what_comes_later_changes_nothing_before(read, content):
    before = read()
    for name in ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "opt_pos"):
        content[name][25:] = np.nan
    after = read()
    for trial_inputs in ("inertial", "optical"):
        pair = [
            each.inertial() if trial_inputs == "inertial" else each.optical(each.thinned(3), 2)
            for each in (before, after)
        ]
        for name in pair[0]:
            np.testing.assert_array_equal(pair[0][name][:25], pair[1][name][:25])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"imu_gyr": None}, "there is no variable 'imu_gyr'"),
        ({"imu_acc": np.zeros((40, 2))}, r"'imu_acc' is float64 of shape \(40, 2\)"),
        ({"opt_pos": np.zeros((39, 3))}, "variables differ in length: .*opt_pos 39"),
        ({"sampling_rate": np.zeros((1, 1))}, r"'sampling_rate' = \[0.\] must be one number"),
        ({"opt_quat": np.full((40, 4), 1.0)}, "'opt_quat' row 1 has the length 2;"),
    ],
)
def test_what_makes_no_sense_is_refused(read, changes, said):
    with pytest.raises(SteadytipError, match=said):
        read(**changes)


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "trial.mat"
    with pytest.raises(SteadytipError, match="cannot be read: No such file"):
        broad.read_trial(path)
    path.write_text("time, x\n" + 200 * "0.0, 1.0\n")
    with pytest.raises(SteadytipError, match="is not a MATLAB v5 file"):
        broad.read_trial(path)


@pytest.mark.parametrize("name", broad.TRIALS)
def test_in_the_recordings_gravity_and_field_agree_with_the_pose(data_dir, name):
    """Expected: what the sensors see points up and, but for iron, north, in the true pose."""
    trial = broad.read_trial(data_dir / broad.FOLDER / f"{name}.mat")
    assert trial.period == pytest.approx(3.5e-3)
    counts = trial.scored()
    assert counts.sum() > 25_000
    world = Rotation.from_quat(np.roll(trial.attitude[counts], -1, axis=1))
    force = world.apply(trial.force[counts]).mean(axis=0)
    np.testing.assert_allclose(force, [0.0, 0.0, 9.81], atol=0.25)
    if "magnet" not in name:
        field = 1e6 * world.apply(trial.field[counts]).mean(axis=0)
        assert abs(field[1]) < 0.1 * field[0]
        assert -50.0 < field[2] < -35.0


def test_a_file_that_ends_early_is_told_wherever_it_ends(tmp_path, content):
    path = tmp_path / "trial.mat"
    savemat(path, content)
    whole = path.read_bytes()
    for end in range(0, len(whole) - 1, 7):
        path.write_bytes(whole[:end])
        with pytest.raises(SteadytipError):
            broad.read_trial(path)
