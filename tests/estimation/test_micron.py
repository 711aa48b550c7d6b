"""The estimator on motion whose truth is known in closed form, with sensors written out here."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit.runner import Runner

T = MODEL.sample_period
SITES = np.array(
    [[design.D1, 0, 0], [0, design.D1, 0], [design.D2, design.D2, design.D3]], dtype=float
)
CHANNELS = ((0, 0), (0, 2), (1, 1), (1, 2), (2, 0), (2, 1))
NORTH = 50e-6 * np.array([np.cos(np.radians(55)), 0, -np.sin(np.radians(55))])


def swinging(seconds: float, amplitude: float = 2e-4, frequency: float = 10.0):
    """The body turns about its origin around a fixed axis while the origin swings along x.

    Returns time, attitudes (world from body), body rates and the tip's track.
    """
    t = np.arange(round(seconds / T)) * T
    # Faded in over a second: the estimator supposes that the instrument starts at rest.
    fade = np.clip(t, 0, 1) ** 3 * (10 - 15 * np.clip(t, 0, 1) + 6 * np.clip(t, 0, 1) ** 2)
    profile = make_interp_spline(t, fade * np.sin(2 * np.pi * frequency * t), k=5)
    s, velocity, acceleration = (profile.derivative(n)(t) if n else profile(t) for n in range(3))
    axis = np.array([0.6, -0.7, 0.387298])
    base = Rotation.from_euler("xyz", [20, 40, 10], degrees=True)
    attitude = base * Rotation.from_rotvec(np.outer(amplitude * s, axis))
    rate, alpha = np.outer(amplitude * velocity, axis), np.outer(amplitude * acceleration, axis)
    origin = np.outer(2e-5 * s, [1, 0, 0])
    push = np.outer(2e-5 * acceleration, [1, 0, 0])
    force = attitude.inv().apply(push + np.array([0, 0, design.SITE_GRAVITY]))
    tip = origin + attitude.apply(design.TIP)
    return t, attitude, rate, alpha, force, tip - tip.mean(0)


def voltages(attitude, rate, alpha, force) -> np.ndarray:
    """Ideal sensors without lag."""
    at = [force + np.cross(alpha, p) + np.cross(rate, np.cross(rate, p)) for p in SITES]
    f = np.column_stack([at[site][:, axis] for site, axis in CHANNELS])
    m = attitude.inv().apply(NORTH)
    return np.hstack([2.5 + f * design.ACCELEROMETER_SCALE, 2.5 + m * design.MAGNETOMETER_SCALE])


def behind_lag(f: np.ndarray, lag: float) -> np.ndarray:
    """Response of tau y' + y = f to a signal that runs straight between its samples."""
    keep = np.exp(-T / lag)
    ramp = lag / T * (1 - keep)
    y = np.empty_like(f)
    y[0] = f[0]
    for k in range(1, len(f)):
        y[k] = keep * y[k - 1] + (1 - ramp) * f[k] + (ramp - keep) * f[k - 1]
    return y


def estimate(parameters=None, lag=design.SENSOR_LAG, seconds=6.0, **motion):
    t, attitude, rate, alpha, force, tip = swinging(seconds, **motion)
    volts = voltages(attitude, rate, alpha, force)
    volts[:, :6] = behind_lag(volts[:, :6], lag)
    out = Runner(MODEL, {"accelerometer.lag": lag, **(parameters or {})}).run(
        len(t), {"volts": volts}
    )
    return t, attitude, rate, tip, out


def band(x: np.ndarray) -> np.ndarray:
    """Amplitude of the 10 Hz component over the last two seconds, complex, for each column."""
    t = np.arange(2000) * T
    return 2 / 2000 * np.exp(-2j * np.pi * 10 * t) @ x[-2000:]


@pytest.mark.parametrize("method", [0, 1])
def test_tip_displacement_is_right_in_size_and_phase(method) -> None:
    """At 10 Hz, behind the 15.2 Hz filter, which alone would turn the phase by 33 degrees.

    With free roll, the vertical believed little and the field as much as in TRIAD only the
    wash-out's lead of 2 c / w is left, 6 % at its 0.3 Hz corner.
    """
    plain = {
        "method": method,
        "roll_density": 1e6,
        "hand_acceleration": 1.0,
        "decoupled": False,
        "settling": 0.0,
    }
    _, _, _, tip, out = estimate(plain)
    truth, found = band(tip), band(out["tip_displacement"])
    lead = 2 * 0.3 / 10
    assert np.linalg.norm(found - truth) < (lead + 0.01) * np.linalg.norm(truth)
    np.testing.assert_allclose(found, truth * np.exp(1j * lead), atol=0.02 * np.abs(truth).max())


def test_priors_cost_little_where_they_are_wrong() -> None:
    """The hand here rolls more than the prior holds for likely; the tip is still within 20 %."""
    _, _, _, tip, out = estimate()
    truth, found = band(tip), band(out["tip_displacement"])
    assert np.linalg.norm(found - truth) < 0.2 * np.linalg.norm(truth)


def test_lag_left_out_of_the_model_shows() -> None:
    """The check above can fail: a model without the lag is far off."""
    t, attitude, rate, alpha, force, tip = swinging(6.0)
    volts = voltages(attitude, rate, alpha, force)
    volts[:, :6] = behind_lag(volts[:, :6], design.SENSOR_LAG)
    out = Runner(MODEL, {"accelerometer.lag": 0.0}).run(len(t), {"volts": volts})
    truth, found = band(tip), band(out["tip_displacement"])
    assert np.linalg.norm(found - truth) > 0.4 * np.linalg.norm(truth)


def test_velocity_and_acceleration_agree_with_the_displacement() -> None:
    _, _, _, _, out = estimate()
    d, v, a = (band(out[f"tip_{name}"]) for name in ("displacement", "velocity", "acceleration"))
    w = 2 * np.pi * 10
    np.testing.assert_allclose(v, 1j * w * d, atol=0.05 * w * np.abs(d).max())
    # 60 Hz band limit: 10 Hz is turned by 9 degrees.
    np.testing.assert_allclose(a * (1 + 1j / 6), -(w**2) * d, atol=0.08 * w**2 * np.abs(d).max())


def test_attitude_follows_slow_turns() -> None:
    """A turn of 0.2 rad at 0.1 Hz, ideal sensors: the hand's own acceleration errs by some mrad."""
    _, attitude, _, _, out = estimate(amplitude=0.2, frequency=0.1, seconds=15.0)
    found = Rotation.from_quat(out["attitude"][5000:], scalar_first=True)
    assert (attitude[5000:].inv() * found).magnitude().max() < 8e-3


def test_gravity_alone_moves_nothing() -> None:
    """At rest with ideal sensors there is no tip motion; the estimator is valid after settling."""
    samples = 3000
    rest = Rotation.from_euler("x", 0.6)
    still = np.zeros((samples, 3))
    volts = voltages(
        Rotation.concatenate([rest] * samples),
        still,
        still,
        np.tile(rest.inv().apply([0, 0, design.SITE_GRAVITY]), (samples, 1)),
    )
    out = Runner(MODEL, {"gates.frozen_samples": 0}).run(samples, {"volts": volts})
    assert np.abs(out["tip_displacement"]).max() < 1e-9
    assert not out["valid"][:999].any()
    assert out["valid"][1000:].all()


@pytest.mark.parametrize("volts", [0.0, 2.5, 5.0])
def test_stuck_channels_are_not_valid(volts) -> None:
    """Sensors that are unplugged, shorted or at the rail: finite outputs, never called valid."""
    out = Runner(MODEL).run(2000, {"volts": np.full(9, volts)})
    assert not out["valid"].any()
    assert all(np.isfinite(values).all() for values in out.values())
