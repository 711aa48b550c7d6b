"""Kinematics of the hand by differences, its processes by SciPy, its spectra by the recordings."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal, stats
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.kit.noise import uniforms
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from plants import hand
from plants.hand import MODEL, Params

T = 1e-3
SECONDS = 240
SILENT = {
    f"{kind}_rms": 0.0 for kind in ("intent", "correction", "drift", "jerk", "roll", "tremor")
}
BANDS = {
    "slow intent": (0.1, 1.0),
    "corrections": (1.0, 5.0),
    "tremor": (6.0, 15.0),
    "carrier": (8.0, 12.0),
}


@pytest.fixture(scope="module")
def generated():
    """Four minutes with the declared parameters."""
    return CompiledRunner(MODEL).run(round(SECONDS / T))


@pytest.fixture(scope="module")
def recordings(data_dir):
    """Tip motion of the ten recordings, 250 Hz, each (samples, 3) [m]."""
    found = []
    for path in sorted((data_dir / "hand_motion_m2s2").glob("*.csv")):
        position = np.loadtxt(path, delimiter=",", usecols=(1, 2, 3)) * 1e-3
        ends = np.flatnonzero((position == 0).all(axis=1))
        found.append(position[: ends[0]] if len(ends) else position)
    assert len(found) == 10
    return found


def recorded(position, velocity, acceleration):
    return {
        "recorded": 1.0,
        **{f"recorded_{axis}": position[:, i] for i, axis in enumerate("xyz")},
        "recorded_velocity": velocity,
        "recorded_acceleration": acceleration,
    }


def five_point(values, step):
    """First derivative of the middle of five samples."""
    return (values[0] - 8 * values[1] + 8 * values[3] - values[4]) / (12 * step)


@settings(max_examples=40)
@given(
    arrays(float, (3, 3), elements=st.floats(-5e-3, 5e-3)),
    st.floats(0, 1),
    st.floats(0.02, 0.3),
    st.floats(0, np.pi),
)
def test_body_pose_rates_and_accelerations_are_derivatives_of_each_other(
    amplitude, share, distance, tilt
):
    """Tip on three sines an axis, large enough for the products of rates to matter."""
    h = 1e-4
    t = h * np.arange(-4, 5)
    w = 2 * np.pi * np.array([1.0, 4.0, 10.0])
    phase = np.array([0.3, 1.1, 2.0])
    motion = [
        np.einsum(
            "fa,ft->ta",
            amplitude * (w**n)[:, None],
            np.sin(np.outer(w, t) + phase[:, None] + n * np.pi / 2),
        )
        for n in range(3)
    ]
    parameters = SILENT | {"rotation_share": share, "pivot_distance": distance, "tilt": tilt}
    out = Runner(MODEL, parameters).run(9, recorded(*motion))

    np.testing.assert_array_equal(out["tip"], motion[0])
    R = Rotation.from_quat(out["attitude"], scalar_first=True)
    np.testing.assert_allclose(out["body"] + R.apply(design.TIP), motion[0], atol=1e-15)
    velocity = [five_point(out["body"][k : k + 5], h) for k in range(5)]
    np.testing.assert_allclose(
        five_point(velocity, h), out["body_acceleration"][4], rtol=1e-4, atol=1e-5
    )
    turned = np.array([(R[4].inv() * R[k]).as_rotvec() for k in range(2, 7)])
    np.testing.assert_allclose(five_point(turned, h), out["rate"][4], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(
        five_point(out["rate"][2:7], h), out["angular_acceleration"][4], rtol=1e-5, atol=1e-5
    )


def test_generated_roll_is_consistent_with_attitude_and_rate():
    out = Runner(MODEL).run(3000)
    R = Rotation.from_quat(out["attitude"], scalar_first=True)
    between = (R[:-1].inv() * R[1:]).as_rotvec() / T
    middle = (out["rate"][1:] + out["rate"][:-1]) / 2
    curved = T * np.abs(np.diff(out["angular_acceleration"], axis=0)).max()
    np.testing.assert_allclose(between, middle, atol=curved)


def test_roll_and_lateral_rotation_combine():
    """Fast roll under fast lateral motion, so that the product of their rates shows."""
    lateral = {"intent_rms": 0.02, "intent_corner": 1.0, "pivot_distance": 0.02}
    out = Runner(MODEL, SILENT | lateral | {"roll_rms": 0.1}).run(3000)
    turning = [five_point(out["rate"][k : k + 5], T) for k in range(2000, 2990)]
    felt = out["angular_acceleration"][2002:2992]
    assert np.abs(np.prod(out["rate"][2000:, [0, 2]], axis=1)).max() > 0.1
    # Across the shaft only: the roll's own acceleration is too rough to be differenced.
    np.testing.assert_allclose(np.array(turning)[:, :2], felt[:, :2], atol=1e-2)


def test_share_of_rotation_splits_lateral_motion_at_the_pivot():
    distance, share, lateral = 0.1, 0.3, 100e-6
    parameters = SILENT | {"rotation_share": share, "pivot_distance": distance, "tilt": np.pi}
    position = np.tile([lateral, -lateral, 50e-6], (1, 1))
    out = Runner(MODEL, parameters).run(1, recorded(position, np.zeros((1, 3)), np.zeros((1, 3))))
    R = Rotation.from_quat(out["attitude"][0], scalar_first=True)
    pivot = out["tip"][0] - R.apply([0, 0, distance])
    # Shaft straight up: B is parallel to W at rest. The pivot sinks by the cosine of the tilt.
    expected = [(1 - share) * lateral, -(1 - share) * lateral, 50e-6 - distance]
    np.testing.assert_allclose(pivot, expected, atol=1e-8)


def test_nominal_attitude_points_the_shaft_down_and_north():
    out = Runner(MODEL, SILENT | {"tilt": 0.5, "heading": 0.0}).run(1)
    shaft = Rotation.from_quat(out["attitude"][0], scalar_first=True).apply([0, 0, 1])
    np.testing.assert_allclose(shaft, [np.sin(0.5), 0, -np.cos(0.5)], atol=1e-15)


def test_slow_intent_solves_its_differential_equation():
    """SciPy integrates the four poles between the same draws."""
    samples, corner, rms = 400, 1.0, 1e-4
    runner = Runner(MODEL, SILENT | {"intent_rms": rms, "intent_corner": corner})
    out = runner.run(samples)
    p = 2 * np.pi * corner
    drive = stats.norm.ppf(uniforms(1, 0, samples, MODEL.draws)[:, 0])
    held = drive / np.sqrt(5 / 32 * p * T)
    y, path = np.zeros(4), []
    for u in held:
        path.append(rms * y[3])
        solution = solve_ivp(
            lambda t, y, u=u: p * (np.array([u, *y[:3]]) - y), (0, T), y, rtol=1e-10, atol=1e-12
        )
        y = solution.y[:, -1]
    np.testing.assert_allclose(out["intent"][:, 0], path, rtol=1e-6, atol=1e-15)


def test_tremor_derivatives_are_those_of_the_product():
    """The body's acceleration without rotation is the tip's, whose tremor is differenced."""
    parameters = SILENT | {"tremor_rms": 1e-5, "rotation_share": 0.0}
    out = Runner(MODEL, parameters).run(2000)
    tip = out["tip"]
    second = (-tip[4:] + 16 * tip[3:-1] - 30 * tip[2:-2] + 16 * tip[1:-3] - tip[:-4]) / (12 * T**2)
    np.testing.assert_allclose(out["body_acceleration"][2:-2], second, atol=2e-4 * 0.05)


@settings(max_examples=60)
@given(arrays(float, (4, 1), elements=st.floats(-6, 6)))
def test_carrier_stays_in_its_band(wander):
    p = Params.unpack(Params.starts())
    frequency = float(ca.evalf(hand.carrier(p, ca.SX(wander))[0])) / (2 * np.pi)
    assert 8 <= frequency <= 12


def test_tremor_begins_at_its_size_and_the_rest_at_rest():
    out = Runner(MODEL).run(300)
    rms = Params.unpack(Params.starts()).tremor_rms
    begun = np.sqrt((out["tremor"] ** 2).mean(axis=0))
    np.testing.assert_allclose(begun, rms, rtol=0.25)
    np.testing.assert_array_equal(out["intent"][0], 0)


def test_sizes_are_the_declared_ones(generated):
    """Tolerances are two to three standard deviations of what four minutes show."""
    p = Params.unpack(Params.starts())
    np.testing.assert_allclose(generated["tremor"].std(axis=0), p.tremor_rms, rtol=0.25)
    intent = np.hypot(p.intent_rms, p.correction_rms)
    np.testing.assert_allclose(generated["intent"].std(axis=0), intent, rtol=0.3)
    rest = generated["tip"] - generated["intent"] - generated["tremor"]
    assert np.all(rest.std(axis=0) < 2 * np.hypot(p.drift_rms, p.jerk_rms))
    roll = generated["angular_acceleration"][:, 2].std()
    assert roll == pytest.approx(hand.ROLL_ACCELERATION, rel=0.1)


def test_pulses_come_at_their_rate():
    """Short pulses far apart can be counted."""
    rate = 0.5
    parameters = SILENT | {"jerk_rms": 1e-5, "jerk_rate": rate, "jerk_corner": 10.0}
    out = CompiledRunner(MODEL, parameters).run(120_000)
    size = np.linalg.norm(out["tip"], axis=1)
    peaks, _ = signal.find_peaks(size, height=1e-7, distance=50)
    assert len(peaks) == pytest.approx(rate * 120, abs=3 * np.sqrt(rate * 120))


def band_power(position, rate):
    """Power in each band and axis, (bands, 3) [m2]."""
    f, power = signal.welch(position, rate, nperseg=round(16 * rate), axis=0, detrend="linear")
    return np.array(
        [power[(f >= low) & (f < high)].sum(axis=0) * f[1] for low, high in BANDS.values()]
    )


def test_spectra_of_the_generator_are_inside_the_spread_of_the_recordings(generated, recordings):
    real = np.array([band_power(position, 250.0) for position in recordings])
    made = band_power(generated["tip"][::4], 250.0)
    low, high = real.min(axis=(0, 2)), real.max(axis=(0, 2))
    inside = (made >= low[:, None]) & (made <= high[:, None])
    assert inside.all(), dict(zip(BANDS, zip(low, made, high, strict=True), strict=True))


def test_seed_decides_the_motion():
    first, again, other = (Runner(MODEL, {"seed": s}).run(500)["tip"] for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-7


def test_recorded_motion_is_passed_on_whole():
    rng = np.random.default_rng(5)
    position, velocity, acceleration = rng.normal(size=(3, 50, 3)) * 1e-4
    out = Runner(MODEL).run(50, recorded(position, velocity, acceleration))
    np.testing.assert_array_equal(out["tip"], position)
    np.testing.assert_array_equal(out["intent"], position)
    np.testing.assert_array_equal(out["tremor"], 0)
