"""Filters on the accelerometers themselves, behind plants that know nothing of them."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.tremor import inertial, inertial_forecaster, inertial_oscillators
from harness.recordings.motion import read_recording, recordings
from harness.reproduce.experiments import inertial as bench
from harness.reproduce.experiments.tremor import FilterScores, score

T = 1e-3
MODELS = {
    "InertialForecaster": inertial_forecaster.MODEL,
    "InertialOscillators": inertial_oscillators.MODEL,
}
SITES = np.array([[design.D1, 0, 0], [0, design.D1, 0], [design.D2, design.D2, design.D3]])


def tremor(name, hand, **parameters):
    """What a filter says a sample ahead, as it acts, (n, 3) [m]."""
    inputs = {"force": hand.force, "attitude": hand.attitude, "valid": hand.valid}
    given = {"horizon": T, "sensing.density": hand.density, **parameters}
    found = Runner(MODELS[name], given).run(len(hand.force), inputs)["tremor"]
    return np.vstack((np.zeros((1, 3)), found[:-1]))


@pytest.fixture(scope="module")
def artificial():
    """The generator's hand, 12 s."""
    return bench.generated(12.0)


@pytest.fixture(scope="module", params=[1, bench.A04_NOISE / design.ACCELEROMETER_NOISE])
def sensed(request, data_dir):
    """Ten recorded hands as the sensors feel them, at the noise of the data sheet and of A04."""
    paths = recordings([data_dir / "hand_motion_m2s2"])
    return request.param, [
        bench.sensed(read_recording(path), request.param, seed) for seed, path in enumerate(paths)
    ]


def test_levers_are_those_of_a_rigid_body():
    """Forces at the sites, from any acceleration of the tip, written out in NumPy."""
    geometry = kinematics.Geometry.of(
        kinematics.Layout(d1=design.D1, d2=design.D2, d3=design.D3, tip=design.TIP)
    )
    rng = np.random.default_rng(3)
    a, alpha = rng.standard_normal((2, 3))
    at = [a + np.cross(alpha, site - np.array(design.TIP)) for site in SITES]
    felt = np.array([at[0][0], at[0][2], at[1][1], at[1][2], at[2][0], at[2][1]])
    A = np.array(inertial.lever_rows(geometry))
    np.testing.assert_allclose(A @ np.concatenate((a, alpha)), felt, atol=1e-12)
    np.testing.assert_allclose(np.array(inertial.exact_tip(geometry)) @ felt, a, atol=1e-9)


@pytest.mark.parametrize("density", [design.ACCELEROMETER_NOISE, bench.A04_NOISE])
def test_noise_alone_has_the_covariance_that_is_expected(density):
    """S is the unit matrix, the gain next to nothing, and so is the tremor."""
    lag = np.exp(-T / design.SENSOR_LAG)
    white = np.random.default_rng(8).standard_normal((30_000, 6))
    felt = np.zeros_like(white)
    for k in range(1, len(white)):
        felt[k] = lag * felt[k - 1] + np.sqrt(1 - lag**2) * white[k]
    felt *= density / np.sqrt(4 * design.SENSOR_LAG)
    runner = Runner(MODELS["InertialForecaster"], {"sensing.density": density})
    found = runner.run(len(felt), {"force": felt})["tremor"]
    names = [scalar.name for scalar in runner.model.state.scalars()]
    power = runner.x[[k for k, name in enumerate(names) if name.startswith("front.power")]]
    np.testing.assert_allclose(power.reshape(6, 6), np.eye(6), atol=0.3)
    assert np.std(found[5000:]) < 0.5e-6 * density / design.ACCELEROMETER_NOISE


@pytest.mark.parametrize("name", MODELS)
def test_the_generators_tremor_is_found(name, artificial):
    found = score(artificial, tremor(name, artificial))
    wanted = {"InertialForecaster": (60, 65), "InertialOscillators": (45, 50)}[name]
    assert (found.a_posteriori, found.in_band) > wanted
    assert found.in_band > wanted[1]


@pytest.mark.parametrize("name", MODELS)
def test_a_gap_leaves_no_step(name, artificial):
    """Half a second without trust, forces wild meanwhile and gravity turned afterwards."""
    gap = slice(6000, 6500)
    valid, force = np.array(artificial.valid), np.array(artificial.force)
    valid[gap], force[gap] = 0, 40.0
    force[gap.stop :] += 1.0
    inputs = {"force": force, "attitude": artificial.attitude, "valid": valid}
    found = Runner(MODELS[name]).run(len(force), inputs)["tremor"]
    largest = np.abs(artificial.target).max()
    assert np.all(np.isfinite(found))
    assert np.abs(found[gap.start - 10 :]).max() < 1.5 * largest


HALF = 6000  # samples before a change, and after it
STILL, LOW, HIGH = (0.0, 8.0), (20e-6, 8.0), (20e-6, 11.0)  # size [m] and frequency [Hz]
LARGE = (100e-6, 8.0)
CHANGES = {
    "onset": (STILL, LOW),
    "stop": (LOW, STILL),
    "five times": (LOW, LARGE),
    "a fifth": (LARGE, LOW),
    "frequency up": (LOW, HIGH),
    "frequency down": (HIGH, LOW),
}


def felt(*tones):
    """Tones one after the other, along each axis of the body, and forces with noise, (n, 6)."""
    angle, displaced, accelerated = np.arange(3.0), [], []
    for size, frequency in tones:
        turns = angle + 2 * np.pi * frequency * T * np.arange(1, HALF + 1)[:, None]
        displaced.append(size * np.sin(turns))
        accelerated.append(-((2 * np.pi * frequency) ** 2) * displaced[-1])
        angle = turns[-1]
    force = np.concatenate(accelerated)[:, [axis for _, axis in kinematics.PLACES]]
    force = force + design.ACCELEROMETER_NOISE / np.sqrt(2 * T) * NOISE[: len(force)]
    lag = np.exp(-T / design.SENSOR_LAG)
    return np.concatenate(displaced), lfilter([1 - lag], [1, -lag], force, axis=0)


NOISE = np.random.default_rng(5).standard_normal((2 * HALF, 6))


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", MODELS)
def test_a_change_of_the_tremor_is_followed(name, change):
    """Never much more than the tremor, and after some seconds nearly what a lasting one leaves."""
    before, after = CHANGES[change]
    wanted, force = felt(before, after)
    found = Runner(MODELS[name]).run(2 * HALF, {"force": force})["tremor"]
    largest = np.abs(wanted).max()
    assert np.abs(found).max() < 3.5 * largest
    left = np.std((wanted - found)[-1000:])
    if after is STILL:
        assert left < 0.1 * largest
    else:
        assert left < {"InertialForecaster": 0.2, "InertialOscillators": 0.5}[name] * np.std(
            wanted[-1000:]
        )


@pytest.mark.parametrize("name", MODELS)
def test_nobody_holds_it(name):
    """Constant forces, without any noise: no tremor, and nothing that is not a number."""
    force = np.tile([7.0, -7.0, 0.0, -7.0, 7.0, 0.0], (4000, 1))
    runner = Runner(MODELS[name])
    found = runner.run(len(force), {"force": force})["tremor"]
    assert np.all(np.isfinite(runner.x))
    assert np.abs(found).max() < 1e-9


@pytest.mark.slow
def test_recorded_hands(sensed):
    """Forecaster: mean of ten and worst, a-posteriori and in-band [%]."""
    noise, hands = sensed
    column = FilterScores([score(hand, tremor("InertialForecaster", hand)) for hand in hands])
    print(f"\nnoise {noise:.2f}: mean {column.mean}, worst {column.worst}")
    mean, worst = ((44.0, 51.2), (34, 41)) if noise == 1 else ((27, 33), (12, 15))
    assert (column.mean.a_posteriori, column.mean.in_band) >= mean
    assert column.mean.in_band >= mean[1]
    assert column.worst.a_posteriori >= worst[0]
    assert column.worst.in_band >= worst[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_thirty_minutes_without_growth(name, artificial):
    """The hand of twelve seconds over and over; the last is as good as the tenth."""
    runner, left = CompiledRunner(MODELS[name], {"horizon": T}), []
    part = slice(2000, 10_000)
    inputs = {"force": artificial.force[part], "attitude": artificial.attitude[part]}
    wanted = artificial.target[part]
    for _ in range(225):
        found = runner.run(len(wanted), inputs)["tremor"]
        assert np.all(np.isfinite(runner.x))
        left.append(np.std(wanted[3000:] - found[3000:]))
    assert left[-1] < 1.1 * left[9]
