"""`steadytip identify hand-eye`: rotations that are known, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fmu_src.errors import SteadytipError
from harness.identify.hand_eye.fit import identify_hand_eye
from harness.identify.hand_eye.read import TrackedMotion, read_tracked_motion
from harness.parts.ssv import read_ssv
from tests.estimation.motions import GRAVITY, NORTH, T, quaternion, swaying, turning, white
from tests.harness.identify.commands import write_csv

HAND = Rotation.from_rotvec([0.3, -0.5, 1.0])
REGISTRATION = Rotation.from_rotvec([0.2, 0.1, -0.8])
BIAS = np.array([0.01, -0.02, 0.005])
LAG = 4
SAMPLES, EVERY, AGE = 8000, 25, 25
NOISE = np.radians(0.1)


def recorded(seed=1, rates=None, bent=None):
    """Columns of a run: everything in one part, gyro 4 ms late, tracker 25 ms late and known so."""
    rng = np.random.default_rng(seed)
    rates = swaying(SAMPLES, 0.6, seed) if rates is None else rates
    truth = turning(rates, Rotation.from_euler("xyz", [50, -20, 30], degrees=True))
    at = np.arange(SAMPLES)
    now = np.maximum(at - LAG, 0)
    then = np.maximum((at // EVERY) * EVERY - AGE, 0)
    noise = Rotation.from_rotvec(rng.normal(size=(SAMPLES, 3))[then] * NOISE)
    coils = REGISTRATION.inv() * truth[then] * HAND * noise
    if bent is not None:
        coils = Rotation.from_rotvec(bent[then]) * coils
    return {
        "time": at * T,
        **_columns("rate", "xyz", rates[now] + BIAS + white(rng, 2e-4, SAMPLES)),
        **_columns("force", "xyz", truth.inv().apply([0, 0, GRAVITY])),
        **_columns("field", "xyz", truth.inv().apply(NORTH)),
        **_columns("em_attitude", "wxyz", quaternion(coils)),
        "em_new": (at % EVERY == 0) & (at >= AGE),
        "em_age": np.full(SAMPLES, AGE * T),
    }


def _columns(name, axes, values):
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate(axes)}


def write(path, columns, units=None):
    units = units or {}
    headings = [f"{name}{units.get(name[:-2], '')}" for name in columns]
    return write_csv(path, np.column_stack(list(columns.values())).astype(float), headings)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write(tmp_path_factory.mktemp("em") / "tracked.csv", recorded())


def test_rotations_bias_and_lag_are_found_within_their_intervals(recording):
    found = identify_hand_eye(read_tracked_motion(recording))
    error = (found.mounting.inv() * HAND).as_rotvec()
    assert (np.abs(error) < 1.5 * found.factor * found.mounting_sigma).all()
    assert np.degrees(found.factor * found.mounting_sigma).max() < 0.1
    assert (np.abs(found.bias - BIAS) < 1.5 * found.factor * found.bias_sigma).all()
    assert found.lag == pytest.approx(LAG * T, abs=5e-4)
    assert np.degrees((found.registration.inv() * REGISTRATION).magnitude()) < 0.2
    left = np.sqrt(np.mean(found.residual**2))
    assert left == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
def test_intervals_hold_as_often_as_they_say():
    """95 % of the components of ten recordings, each with a distortion of its own."""
    inside = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        slow = np.cumsum(rng.normal(size=(SAMPLES, 3)), axis=0) * 1e-5
        columns = recorded(seed, bent=slow - slow.mean(axis=0))
        measured = columns["em_new"] > 0
        time = columns["time"]
        at = time[measured] - AGE * T
        keep = (at > 0.2) & (at < time[-1] - 0.2)
        attitudes = np.column_stack([columns[f"em_attitude_{a}"] for a in "wxyz"])[measured][keep]
        given = TrackedMotion(
            None, time, np.column_stack([columns[f"rate_{a}"] for a in "xyz"]), None, None,
            at[keep], Rotation.from_quat(attitudes, scalar_first=True),
        )  # fmt: skip
        found = identify_hand_eye(given)
        error = (found.mounting.inv() * HAND).as_rotvec()
        inside += list(np.abs(error) < found.factor * found.mounting_sigma)
        assert found.registration is None
    print(f"{100 * np.mean(inside):.0f} % of {len(inside)}")
    assert np.mean(inside) > 0.8


def test_command_writes_a_set_for_the_filter(identify, tmp_path, recording):
    out = tmp_path / "set.ssv"
    shown = identify.accepts("hand-eye", recording, "--out", out)
    assert "hand-eye rotation h x" in shown
    values = {name: value.value for name, value in read_ssv(out).items()}
    vector = [values[f"tracker.mounting[{i}]"] for i in (1, 2, 3)]
    assert np.degrees((Rotation.from_rotvec(vector).inv() * HAND).magnitude()) < 0.1
    assert 0 < values["tracker.mounting_sigma"] < 1e-3
    assert values["tracker.lag"] == pytest.approx(LAG * T, abs=5e-4)
    assert "tracker.registration[3]" in values
    assert out.with_suffix(".html").is_file()


def test_parts_units_and_what_is_missing(tmp_path):
    """Columns of a run stand behind the part's name; degrees are read as such."""
    columns = recorded()
    named = {
        name if name == "time" else f"{'coil' if name.startswith('em') else 'imu'}.{name}": values
        for name, values in columns.items()
    }
    for axis in "xyz":
        named[f"imu.rate_{axis}"] = np.degrees(named[f"imu.rate_{axis}"])
        named[f"robot.rate_{axis}"] = np.zeros(SAMPLES)
    path = write(tmp_path / "run.csv", named, {"imu.rate": " [deg/s]"})
    read, alone = read_tracked_motion(path), read_tracked_motion(write(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(read.rate, alone.rate, atol=1e-8)
    np.testing.assert_array_equal(read.force, alone.force)
    assert (read.attitude.inv() * alone.attitude).magnitude().max() < 1e-7

    path = write(tmp_path / "b.csv", named, {"imu.rate": " [rpm]"})
    with pytest.raises(SteadytipError, match=r"rate in 'rpm'; known are rad/s, deg/s"):
        read_tracked_motion(path)
    less = {name: values for name, values in columns.items() if "attitude" not in name}
    path = write(tmp_path / "c.csv", less)
    with pytest.raises(SteadytipError, match="are in no part; say which with --tracker PART"):
        read_tracked_motion(path)
    short = {name: values[:2000] for name, values in columns.items()}
    path = write(tmp_path / "d.csv", short)
    with pytest.raises(SteadytipError, match="at least 100 in 5 s are needed"):
        read_tracked_motion(path)


def test_turning_about_one_axis_is_not_enough(tmp_path):
    rates = swaying(SAMPLES, 0.6) * [1, 0, 0]
    path = write(tmp_path / "one.csv", recorded(rates=rates))
    with pytest.raises(SteadytipError, match="turn the instrument about two axes"):
        identify_hand_eye(read_tracked_motion(path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate": np.degrees(1.0)}, "another convention: the rates are in deg/s"),
        ({"rate": np.radians(1.0)}, "another convention: the rates are in rad/s"),
        ({"rate": np.array([1.0, 1.0, -1.0])}, "left-handed"),
        ({"rate": -1.0}, "left-handed, or the rates have the opposite sign"),
        ({"attitude": "inverse"}, "seen from the coils, or their scalar is the last"),
        ({"attitude": "scalar last"}, "seen from the coils, or their scalar is the last"),
        ({"rate": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 0.0]])}, "No other unit"),
    ],
)
def test_a_recording_by_another_convention_is_refused_with_the_one_that_fits(
    recording, change, message
):
    motion = read_tracked_motion(recording)
    if "rate" in change:
        factor = change["rate"]
        turned = motion.rate @ factor if np.ndim(factor) == 2 else motion.rate * factor
        motion = replace(motion, rate=turned)
    elif change["attitude"] == "inverse":
        motion = replace(motion, attitude=motion.attitude.inv())
    else:
        last = motion.attitude.as_quat()
        motion = replace(motion, attitude=Rotation.from_quat(last, scalar_first=True))
    with pytest.raises(SteadytipError, match=message):
        identify_hand_eye(motion)
