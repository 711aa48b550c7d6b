"""The estimator when sensors or surroundings are not as they should be, each case by its name.

A hand moves the instrument; the sensors are written out here, with the noise of their data sheets
behind their lag and a converter of 16 bits. Then one thing goes wrong.
"""

import fmpy
import numpy as np
import pytest
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron.model import MODEL
from fmu_src.pack import build
from fmu_src.pack.compiled_runner import CompiledRunner
from tests.estimation.test_micron import NORTH, T, voltages

STEP = design.ADC_SPAN / 2**16
TILTED = Rotation.from_euler("xyz", [20, 40, 10], degrees=True)
HAND = {"slow": np.radians(3.0), "tremor": 2e-4, "push": 0.05}
STILL = {"slow": 0.0, "tremor": 0.0, "push": 0.0}


def noise(rng, samples) -> np.ndarray:
    """Of the nine channels by their data sheets [V], the accelerometers' behind their lag."""
    keep = np.exp(-T / design.SENSOR_LAG)
    white = rng.normal(size=(samples, 9))
    white[1:, :6] *= np.sqrt(1 - keep**2)
    size = design.ACCELEROMETER_NOISE / np.sqrt(4 * design.SENSOR_LAG)
    force = design.ACCELEROMETER_SCALE * size * lfilter([1], [1, -keep], white[:, :6], axis=0)
    return np.hstack([force, design.MAGNETOMETER_SCALE * 5e-8 * white[:, 6:]])


def converted(volts) -> np.ndarray:
    """By a converter of 16 bits."""
    return np.clip(np.round(volts / STEP) * STEP, 0, design.ADC_SPAN - STEP)


class Run:
    """A hand's motion, what the sensors make of it, and what the estimator makes of that.

    Args:
        seconds: duration.
        base: attitude about which the hand moves.
        slow: amplitude of a turn at 0.3 Hz about an axis across [rad].
        tremor: the same at 9 Hz [rad].
        push: acceleration of the whole instrument along x of W at 9 Hz [m/s2].
        turn: steady rate about the vertical [rad/s].
        seed: of the noise.
    """

    def __init__(self, seconds, base=TILTED, slow=0.0, tremor=0.0, push=0.0, turn=0.0, seed=1):
        self.rng = np.random.default_rng(seed)
        self.t = t = np.arange(round(seconds / T)) * T
        ramp = np.clip((t - 0.5) / 1.5, 0, 1)  # at rest at first, as the estimator supposes
        fade = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
        sway = slow * fade * np.sin(2 * np.pi * 0.3 * t)
        shake = tremor * fade * np.sin(2 * np.pi * 9 * t)
        self.attitude = (
            Rotation.from_rotvec(np.outer(turn * t, [0, 0, 1]))
            * base
            * Rotation.from_rotvec(np.outer(sway, [0.6, -0.7, 0.387]))
            * Rotation.from_rotvec(np.outer(shake, [0.8, 0.6, 0.0]))
        )
        steps = (self.attitude[:-1].inv() * self.attitude[1:]).as_rotvec() / T
        self.rate = np.vstack([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
        self.alpha = np.gradient(self.rate, T, axis=0)
        self.pushed = np.outer(push * fade * np.cos(2 * np.pi * 9 * t), [1.0, 0, 0])
        self.field = np.tile(NORTH, (len(t), 1))
        self.heard = np.ones(len(t))

    def clean(self) -> np.ndarray:
        """Volts of the nine channels without noise, (n, 9)."""
        force = self.attitude.inv().apply(self.pushed + np.array([0, 0, design.SITE_GRAVITY]))
        volts = voltages(self.attitude, self.rate, self.alpha, force)
        m = self.attitude.inv().apply(self.field)
        volts[:, 6:] = 2.5 + m * design.MAGNETOMETER_SCALE
        keep = np.exp(-T / design.SENSOR_LAG)
        moved = volts[:, :6] - volts[0, :6]
        volts[:, :6] = lfilter([1 - keep], [1, -keep], moved, axis=0) + volts[0, :6]
        return volts

    def volts(self) -> np.ndarray:
        """The same with noise and the converter."""
        return converted(self.clean() + noise(self.rng, len(self.t)))

    def estimate(self, volts=None, **parameters) -> "Run":
        """Outputs as attributes; errors as rotation vectors in W."""
        given = {name.replace("__", "."): value for name, value in parameters.items()}
        self.out = CompiledRunner(MODEL, given).run(
            len(self.t),
            {"volts": self.volts() if volts is None else volts, "inertial_valid": self.heard},
        )
        assert all(np.isfinite(values).all() for values in self.out.values())
        found = Rotation.from_quat(self.out["attitude"], scalar_first=True)
        self.error = np.degrees((found * self.attitude.inv()).as_rotvec())
        self.tilt = np.linalg.norm(self.error[:, :2], axis=1)
        self.heading = np.abs(self.error[:, 2])
        return self

    def at(self, begin: float, end: float) -> slice:
        """Samples between two times [s]."""
        return slice(round(begin / T), round(end / T))

    def flag(self, name: str, begin: float, end: float) -> np.ndarray:
        """A boolean output between two times."""
        return self.out[name][self.at(begin, end)] > 0.5


def test_nothing_wrong_nothing_flagged() -> None:
    """What the cases below are held against: a hand as it is."""
    run = Run(12, **HAND).estimate()
    for name in (
        "magnetic_disturbance",
        "acceleration_disturbance",
        "at_rest",
        "frozen",
        "clipped",
    ):
        assert not run.flag(name, 2, 12).any(), name
    assert run.flag("valid", 1, 12).all()
    print(run.tilt[2000:].max(), run.heading[2000:].max())
    assert run.tilt[2000:].max() < 0.5
    assert run.heading[2000:].max() < 0.5


class Model:
    """Volts as the filter's model has them: white noise and random walks, nothing else.

    The instrument keeps its place but for a random roll; the hand's acceleration is white, the
    accelerometers have no lag. Truth and volts are made here with NumPy and SciPy.
    """

    HAND, FIELD, ROLL = 0.1, 1e-7, 0.05

    PARAMETERS = {  # noqa: RUF012 - never changed
        "accelerometer.lag": 0.0,
        "hand_acceleration": HAND,
        "roll_density": ROLL,
        "magnetometer.sigma": FIELD,
        "magnetometer.residue": 0.0,
        "settling": 0.0,
        "gates.rest": 0.0,
        "gates.rest_time": 60.0,
    }

    def __init__(self, samples: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        density = design.ACCELEROMETER_NOISE
        roll = np.cumsum(rng.normal(size=samples) * self.ROLL * np.sqrt(T / 2))
        self.rate = np.outer(roll, [0, 0, 1.0])
        self.alpha = np.gradient(self.rate, T, axis=0)
        self.attitude = TILTED * Rotation.from_rotvec(np.cumsum(self.rate, axis=0) * T)
        push = self.HAND * rng.normal(size=(samples, 3))
        force = self.attitude.inv().apply([0, 0, design.SITE_GRAVITY]) + push
        volts = voltages(self.attitude, self.rate, self.alpha, force)
        sigma = density / np.sqrt(2 * T)
        volts[:, :6] += design.ACCELEROMETER_SCALE * sigma * rng.normal(size=(samples, 6))
        volts[:, 6:] += design.MAGNETOMETER_SCALE * self.FIELD * rng.normal(size=(samples, 3))
        self.volts = volts


# A start from anywhere ----------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_starts_from_any_attitude(seed) -> None:
    starts(Rotation.random(random_state=seed), seed)


@pytest.mark.parametrize("angle", [90.0, 180.0])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_starts_upside_down_and_at_half_turns(axis, angle) -> None:
    starts(Rotation.from_euler(axis, angle, degrees=True), 1)


def starts(base: Rotation, seed: int) -> None:
    run = Run(1.3, base=base, seed=seed).estimate()
    assert not run.flag("valid", 0, 0.99).any()
    assert run.flag("valid", 1.0, 1.3).all()
    assert run.tilt[1000:].max() < 0.3
    assert run.heading[1000:].max() < 0.5
    assert run.out["attitude_sigma"][1000:].max() < np.radians(0.2)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(20, 180))
@example(1, 180.0)
def test_a_bad_first_sample_is_forgotten(seed, angle) -> None:
    """It looks well, strength and dip are right, but the attitude is another one's."""
    run = Run(1.3, seed=seed)
    axis = Rotation.random(random_state=seed).apply([0, 0, 1])
    other = Run(0.002, base=TILTED * Rotation.from_rotvec(np.radians(angle) * axis))
    volts = run.volts()
    volts[0] = other.volts()[0]
    run.estimate(volts)
    assert run.tilt[2:].max() < 1.0
    assert run.tilt[1000:].max() < 0.3
    assert run.heading[1000:].max() < 0.5


@pytest.mark.parametrize("volts", [0.0, 2.5, 5.0])
def test_a_first_sample_at_the_rail_or_at_nothing_is_none(volts) -> None:
    run = Run(1.3)
    given_volts = run.volts()
    given_volts[0] = volts
    run.estimate(given_volts)
    assert not run.flag("valid", 0, 0.99).any()
    assert run.flag("valid", 1.01, 1.3).all()
    assert run.tilt[2:].max() < 1.0


@pytest.mark.parametrize("angle", [40.0, 100.0, 163.0])
def test_a_bad_start_of_a_tenth_of_a_second_is_made_anew(angle) -> None:
    """The first samples agree with each other, and are wrong."""
    run = Run(4, **HAND)
    wrong = TILTED * Rotation.from_rotvec(np.radians(angle) * np.array([0.6, -0.7, 0.387]))
    volts = run.volts()
    volts[:100] = Run(0.1, base=wrong, seed=9).volts()
    run.estimate(volts)
    assert not run.out["valid"][:1100].any()
    assert run.tilt[250:].max() < 0.5
    assert run.heading[250:].max() < 0.5
    assert run.out["valid"][1500:].all()


# Consistency --------------------------------------------------------------------------------------


@pytest.mark.parametrize("decoupled", [True, False])
def test_mean_nis_is_within_its_95_percent_interval(decoupled) -> None:
    """On volts that follow the model, decoupled and as TRIAD; errors are as sigma says."""
    ideal = Model(20000, seed=3)
    out = CompiledRunner(MODEL, {**Model.PARAMETERS, "decoupled": decoupled}).run(
        len(ideal.volts), {"volts": ideal.volts}
    )
    later = slice(1000, None)
    squared, size = out["innovation_squared"][later], out["innovation_size"][later]
    assert (size == 3).all()
    low, high = chi2.ppf([0.025, 0.975], size.sum()) / len(size)
    print(f"mean NIS {squared.mean():.3f}, interval {low:.3f} to {high:.3f}")
    assert low < squared.mean() < high
    found = Rotation.from_quat(out["attitude"], scalar_first=True)
    error = (ideal.attitude.inv() * found).as_rotvec()[later]
    ratio = (error**2 / out["attitude_sigma"][later] ** 2).mean(axis=0)
    assert np.all((ratio > 0.6) & (ratio < 1.6))  # errors last for half a second: few are new


@pytest.mark.slow
def test_half_an_hour_keeps_covariance_and_quaternion_whole() -> None:
    """1.8 million samples of a hand, a magnet and lost samples in each minute, and rest at last."""
    run = Run(62, **HAND)
    magnet(run, 20, 30, 30e-6)
    loop = run.at(2, 62)
    clean, truth = run.clean()[loop], run.attitude[loop]
    heard = np.ones(len(clean))
    heard[40000:40500] = 0
    calm = np.tile(clean[0], (len(clean), 1))
    runner = CompiledRunner(MODEL)
    for minute in range(30):
        resting = minute == 29
        volts = converted((calm if resting else clean) + noise(run.rng, len(clean)))
        out = runner.run(len(clean), {"volts": volts, "inertial_valid": 1 if resting else heard})
        assert_whole(runner)
        norms = np.linalg.norm(out["attitude"], axis=1)
        assert np.abs(norms - 1).max() < 1e-12
        found = Rotation.from_quat(out["attitude"], scalar_first=True)
        if resting:
            end = (found[-1] * truth[0].inv()).as_rotvec()
            assert out["at_rest"][-1]
        else:
            error = np.degrees((found * truth.inv()).as_rotvec())
            tilt = np.linalg.norm(error[:, :2], axis=1)
            assert tilt[5000:40000].max() < 0.6
            assert tilt.max() < 3.0
            assert np.abs(error[15000:, 2]).max() < 15.0
            end = np.radians(error[-1])
        assert np.degrees(np.linalg.norm(end)) < 0.6
        assert out["valid"][-1]


# Samples that do not come, or come wrong ----------------------------------------------------------


def test_lost_samples_one_in_five() -> None:
    """Told by `inertial_valid`; the volts of such an instant are whatever is in the buffer."""
    run = Run(10, **HAND)
    lost = (run.rng.random(len(run.t)) < 0.2) & (run.t > 2)
    volts = run.volts()
    volts[lost] = run.rng.uniform(0, 5, (lost.sum(), 9))
    run.heard[lost] = 0
    run.estimate(volts)
    assert run.tilt[1000:].max() < 0.5
    assert run.heading[1000:].max() < 0.6
    assert run.flag("valid", 1, 10).mean() > 0.999


@pytest.mark.parametrize(("seconds", "bound"), [(0.2, 0.6), (2.0, 6.5), (6.0, 6.5)])
def test_lost_samples_for_long(seconds, bound) -> None:
    """What a hand turns meanwhile, here 6 deg from end to end, is not known; sigma says so."""
    run = Run(seconds + 9, **HAND)
    gap = run.at(4, 4 + seconds)
    run.heard[gap] = 0
    volts = run.volts()
    volts[gap] = 0
    run.estimate(volts)
    assert not run.flag("valid", 4.02, 4 + seconds).any()
    assert run.tilt[gap].max() < bound
    assert run.heading[gap].max() < bound
    sigma = np.degrees(run.out["attitude_sigma"][gap])
    assert np.all(sigma[-1] > 0.5 * run.tilt[gap][-1])
    assert np.all(np.diff(sigma[50:], axis=0) > 0)
    assert run.flag("valid", 6 + seconds, 9 + seconds).all()
    assert run.tilt[run.at(6 + seconds, 9 + seconds)].max() < 0.5


def test_late_samples() -> None:
    """One in five comes a period late: its instant sees the sample before."""
    run = Run(10, **HAND)
    volts = run.volts()
    late = np.flatnonzero((run.rng.random(len(run.t)) < 0.2) & (run.t > 2))
    volts[late] = volts[late - 1]
    run.estimate(volts)
    assert run.tilt[1000:].max() < 0.5
    assert run.heading[1000:].max() < 0.6
    assert run.flag("valid", 1, 10).all()


@pytest.mark.parametrize(("seconds", "flagged", "bound"), [(0.03, False, 0.5), (2.0, True, 6.5)])
def test_duplicated_samples(seconds, flagged, bound) -> None:
    """A host that goes on with the last sample and does not tell: frozen after 50 ms."""
    run = Run(seconds + 8, **HAND)
    gap = run.at(4, 4 + seconds)
    volts = run.volts()
    volts[gap] = volts[4000]
    run.estimate(volts)
    assert run.flag("frozen", 4, 4 + seconds).any() == flagged
    if flagged:
        assert run.flag("frozen", 4.06, 4 + seconds).all()
        assert not run.flag("valid", 4.07, 4 + seconds).any()
    assert run.tilt[4000:].max() < bound
    assert run.heading[4000:].max() < bound
    assert run.flag("valid", 7 + seconds, 8 + seconds).all()


@pytest.mark.xdist_group("MicronEstimator")
def test_nan_samples_are_refused_and_the_last_one_stays(tmp_path) -> None:
    """By the FMU, by name; a host that goes on has a stale sample, and is told after 50 ms."""
    (path,) = build(["MicronEstimator"]).values()
    description = fmpy.read_model_description(path, validate=False)
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    said = []
    logger = fmi2.fmi2CallbackLoggerTYPE(
        lambda _env, _name, _status, _category, message: said.append(message.decode())
    )
    fmu = fmpy.instantiate_fmu(
        fmpy.extract(str(path), tmp_path), description, "CoSimulation", logger=logger
    )
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    channels = [at[f"volts_{name}"] for name in (*kinematics.CHANNELS, "mx", "my", "mz")]
    run = Run(1.3)
    flags = {}
    for k, volts in enumerate(run.volts()):
        if k >= 1100:
            with pytest.raises(FMICallException):
                fmu.setReal(channels, [*volts[:8], np.nan])
        else:
            fmu.setReal(channels, volts)
        fmu.doStep(k * T, T)
        names = ("valid", "frozen")
        flags[k] = dict(zip(names, fmu.getBoolean([at[name] for name in names]), strict=True))
        assert np.isfinite(fmu.getReal([at["attitude_w"], at["rate_x"]])).all()
    fmu.terminate()
    fmu.freeInstance()
    assert any("volts_mz" in message for message in said)
    assert flags[1099] == {"valid": True, "frozen": False}
    assert flags[1199] == {"valid": False, "frozen": True}


@pytest.mark.parametrize("channel", range(6))
def test_a_frozen_accelerometer(channel) -> None:
    run = Run(9, **HAND)
    volts = run.volts()
    volts[run.at(4, 6), channel] = volts[4000, channel]
    run.estimate(volts)
    assert run.flag("frozen", 4.06, 6).all()
    assert not run.flag("valid", 4.07, 6).any()
    assert max(run.tilt[4000:].max(), run.heading[4000:].max()) < 6.5
    assert run.tilt[7000:].max() < 0.5
    assert run.flag("valid", 7, 9).all()


@pytest.mark.parametrize("channel", range(6, 9))
def test_a_frozen_magnetometer_leaves_the_tilt_alone(channel) -> None:
    run = Run(9, **HAND)
    volts = run.volts()
    volts[run.at(4, 7), channel] = volts[4000, channel]
    run.estimate(volts)
    assert run.flag("frozen", 4.06, 7).all()
    assert run.flag("magnetic_disturbance", 4.06, 7).all()
    assert run.tilt[1000:].max() < 0.5
    assert run.heading[4000:].max() < 3.0
    assert run.heading[8000:].max() < 0.5


def test_clipping_of_a_knock() -> None:
    """To and fro with 40 m/s2 for 40 ms: accelerometers at 1.7 g for part of it."""
    run = Run(8, **HAND)
    run.pushed[run.at(4, 4.02), 0] += 40.0
    run.pushed[run.at(4.02, 4.04), 0] -= 40.0
    limit = 1.7 * design.STANDARD_GRAVITY * design.ACCELEROMETER_SCALE
    volts = run.clean()
    volts[:, :6] = design.ZERO_VOLTS + np.clip(volts[:, :6] - design.ZERO_VOLTS, -limit, limit)
    run.estimate(converted(volts + noise(run.rng, len(volts))))
    assert run.flag("clipped", 4, 4.1).any()
    assert run.flag("acceleration_disturbance", 4, 4.1).any()
    assert not run.flag("valid", 4.005, 4.04).all()
    assert run.tilt[4000:].max() < 1.0
    assert run.flag("valid", 5, 8).all()


@pytest.mark.parametrize("rail", [0.0, design.ADC_SPAN - STEP])
@pytest.mark.parametrize("channel", [1, 7])
def test_volts_at_the_rail(channel, rail) -> None:
    """A broken wire: an accelerometer is missed, a magnetometer only for the north."""
    run = Run(9, **HAND)
    volts = run.volts()
    volts[run.at(4, 5), channel] = rail
    run.estimate(volts)
    assert run.flag("clipped", 4, 5).all()
    assert not run.flag("clipped", 5, 9).any()
    force = channel < 6
    assert run.flag("magnetic_disturbance", 4, 5).any() != force
    assert run.flag("valid", 4.02, 5).any() != force
    assert run.tilt[4000:].max() < (3.5 if force else 0.5)
    assert run.heading[4000:].max() < 4.0
    assert run.flag("valid", 6.5, 9).all()


def test_a_single_wild_sample_is_no_motion() -> None:
    """Between good ones: it would leave the integral of alpha off for ever."""
    run = Run(8, **HAND)
    good = run.volts()
    wild = good.copy()
    wild[4000, 3] = 3.9
    run.estimate(wild)
    with_it = run.out["rate"].copy()
    run.estimate(good)
    assert np.abs(with_it - run.out["rate"])[4000:].max() < np.radians(0.5)
    spoilt = run.estimate(wild, gates__difference=1e3).out["rate"]
    run.estimate(good)
    assert np.abs(spoilt - run.out["rate"])[4000:].max() > np.radians(5)


# Magnets, knocks, and rest ------------------------------------------------------------------------


def magnet(run: Run, begin: float, end: float, strength: float, ramp: float = 0.5) -> None:
    """Adds a field that comes and goes within `ramp` seconds."""
    come = np.clip((run.t - begin) / ramp, 0, 1) * np.clip((end - run.t) / ramp, 0, 1)
    direction = np.array([1.0, 1.0, 0.3]) / np.linalg.norm([1.0, 1.0, 0.3])
    run.field = run.field + strength * np.outer(come, direction)


@pytest.mark.parametrize("ramp", [0.02, 0.2, 1.0, 3.0])
@pytest.mark.parametrize("strength", [12e-6, 30e-6, 90e-6])
def test_a_magnet_brought_near(strength, ramp) -> None:
    """The tilt does not know it; the heading errs by what the gates let pass, and comes back."""
    run = Run(16, **HAND)
    magnet(run, 4, 12, strength, ramp)
    run.estimate()
    assert run.flag("magnetic_disturbance", 4 + ramp, 12 - ramp).all()
    assert run.tilt[2000:].max() < 0.5
    assert run.heading[2000:].max() < 15.0
    assert run.heading[13500:].max() < 0.5
    assert not run.flag("magnetic_disturbance", 13.5, 16).any()
    assert run.flag("valid", 13.5, 16).all()


def test_a_magnet_too_weak_to_be_seen_turns_north_by_its_share() -> None:
    """3 of 50 uT lie within the gates: the heading errs by 4 deg, and nothing else does."""
    run = Run(10, **HAND)
    magnet(run, 4, 8, 3e-6)
    run.estimate()
    assert run.tilt[2000:].max() < 0.5
    assert 2.0 < run.heading[2000:].max() < 6.0


def test_without_gates_a_magnet_takes_the_tilt_along() -> None:
    """The cases above can fail: TRIAD's weights, nothing left out."""
    run = Run(10, **HAND)
    magnet(run, 4, 8, 30e-6)
    run.estimate(decoupled=False, gates__sigma=1e3, gates__field=10.0, gates__dip=4.0)
    assert run.tilt[2000:].max() > 5.0


def test_a_magnet_that_stays_is_the_field_of_the_place_after_20_s() -> None:
    """No lock-out: sigma grows until then, and north is where the field points from then on."""
    run = Run(34, **HAND)
    magnet(run, 4, 1e3, 30e-6, 0.02)
    run.estimate()
    assert run.flag("magnetic_disturbance", 4.02, 23.9).all()
    assert not run.flag("magnetic_disturbance", 28, 34).any()
    assert run.flag("valid", 28.1, 34).all()
    sigma = run.out["attitude_sigma"].max(axis=1)
    assert sigma[23500] > 1.5 * sigma[6000] > 10 * sigma[3900]
    assert sigma[30000:].max() < np.radians(0.3)
    north = np.degrees(np.arctan2(run.field[-1, 1], run.field[-1, 0]))
    assert np.abs(run.error[30000:, 2] + north).max() < 0.5
    assert run.tilt[2000:].max() < 0.5


@pytest.mark.parametrize(
    ("size", "frequency", "bound"), [(1.0, 1.5, 4.5), (3.0, 5.0, 4.0), (8.0, 8.0, 5.0)]
)
def test_strong_accelerations_count_less(size, frequency, bound) -> None:
    """A constant covariance errs by half as much again, or more; valid is taken back."""
    run = Run(12, **HAND)
    come = np.clip((run.t - 4) / 0.5, 0, 1) * np.clip((9 - run.t) / 0.5, 0, 1)
    run.pushed[:, 1] += size * come * np.sin(2 * np.pi * frequency * run.t)
    run.estimate()
    print(run.tilt[2000:].max())
    assert run.flag("acceleration_disturbance", 5, 8).mean() > 0.5
    assert run.flag("valid", 5, 8).mean() < 0.7
    assert run.tilt[2000:].max() < bound
    assert run.tilt[11000:].max() < 0.5
    assert run.flag("valid", 10.5, 12).all()
    tilt = run.tilt[2000:].max()
    run.estimate(gates__sigma=1e3, gates__force=100.0, gates__agitation_time=60.0)
    assert run.tilt[2000:].max() > 1.5 * tilt


@pytest.mark.parametrize("angle", [40.0, 163.0])
def test_a_wrong_vertical_that_lasts_starts_the_filter_anew(angle) -> None:
    """After a second and a half of another attitude's samples: no lock-out, and not valid."""
    run = Run(8, **HAND)
    wrong = TILTED * Rotation.from_rotvec(np.radians(angle) * np.array([0.6, -0.7, 0.387]))
    volts = run.volts()
    volts[:1500] = Run(1.5, base=wrong, seed=9).volts()
    run.estimate(volts)
    astray = run.tilt[1500:] > 5.0
    assert astray.any()
    assert not (run.out["valid"][1510:] > 0.5)[astray[10:]].any()
    assert run.tilt[4000:].max() < 0.5
    assert run.heading[4000:].max() < 0.5
    assert run.flag("valid", 5, 8).all()


def test_rest_is_found_and_the_rate_known_better() -> None:
    run = Run(12, **STILL).estimate()
    assert run.flag("at_rest", 4, 12).all()
    rate, sigma = run.out["rate"][6000:].std(), run.out["rate_bias_sigma"][-1]
    run.estimate(gates__rest=0.0)
    assert not run.flag("at_rest", 0, 12).any()
    assert rate < run.out["rate"][6000:].std()
    assert np.all(sigma < run.out["rate_bias_sigma"][-1])


def test_zeros_that_wander_are_learned_at_rest() -> None:
    """5 mg more on one channel, as from warming up: it is a ramp of the rate's bias."""
    run = Run(40, **STILL)
    volts = run.clean()
    drift = 0.005 * design.STANDARD_GRAVITY * np.clip((run.t - 5) / 5, 0, 1)
    volts[:, 4] += design.ACCELEROMETER_SCALE * drift
    volts = converted(volts + noise(run.rng, len(volts)))
    learned = np.abs(run.estimate(volts).out["rate"][35000:].mean(axis=0)).max()
    kept = np.abs(run.estimate(volts, gates__rest=0.0).out["rate"][35000:].mean(axis=0)).max()
    print(learned, kept)
    assert learned < 0.1 * kept


@pytest.mark.parametrize("motion", [{"turn": np.radians(2.0)}, {"tremor": 2e-4}, HAND])
def test_motion_is_no_rest(motion) -> None:
    """Not even a slow turn about the vertical, which no accelerometer feels."""
    run = Run(10, **motion).estimate()
    assert not run.flag("at_rest", 3.5, 10).any()
    assert run.tilt[2000:].max() < 0.5
    assert run.heading[2000:].max() < 0.5


# Anything -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hand():
    run = Run(42, **HAND)
    return run, run.volts()


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(0, 3000), st.integers(1, 3000), st.integers(0, 4))
@example(10629, 0, 2, 2)
def test_whatever_came_before_good_samples_bring_it_back(hand, seed, begin, count, kind) -> None:
    """Up to 3 s of nonsense within the first six, then 36 s of what is: no lock-out of any sort."""
    run, good = hand
    rng = np.random.default_rng(seed)
    bad = slice(begin, begin + count)
    volts = good.copy()
    if kind == 0:
        volts[bad] = rng.uniform(0, 5, (count, 9))
    elif kind == 1:
        volts[bad] = rng.uniform(0, 5, 9) + 1e-3 * rng.normal(size=(count, 9))
    elif kind == 2:
        volts[bad] += rng.normal(size=9) * 10 ** rng.uniform(-2, 0)
    elif kind == 3:
        volts[bad] = np.repeat(rng.uniform(0, 5, (count // 50 + 1, 9)), 50, axis=0)[:count]
    else:
        volts[bad] = volts[bad][:, rng.permutation(9)]
    runner = CompiledRunner(MODEL)
    out = runner.run(len(volts), {"volts": np.clip(volts, 0, 5)})
    assert all(np.isfinite(values).all() for values in out.values())
    assert_whole(runner)
    error = Rotation.from_quat(out["attitude"][-2000:], scalar_first=True)
    error = np.degrees((error * run.attitude[-2000:].inv()).magnitude())
    assert error.max() < 1.0
    assert out["valid"][-2000:].all()


def assert_whole(runner: CompiledRunner) -> None:
    """The state's quaternion is one, its covariance symmetric and positive definite."""
    names = [scalar.name for scalar in MODEL.state.scalars()]
    q_at, P_at = names.index("q[1]"), names.index("P[1,1]")
    P = runner.x[P_at : P_at + 36].reshape(6, 6)
    assert abs(np.linalg.norm(runner.x[q_at : q_at + 4]) - 1) < 1e-12
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0
