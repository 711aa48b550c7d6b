"""The forecaster: what it reaches on hands, what it leaves alone, and how it stands changes."""

import numpy as np
import pytest

from fmu_src.kit.runner import Runner
from fmu_src.tremor import var_forecaster
from fmu_src.tremor.var_forecaster import AHEAD, CROSS, LEARNING, MODEL, OWN, STRIDE
from harness.reproduce.experiments import tremor as bench

T = 1e-3
RNG = np.random.default_rng(5)


def run(position, **parameters):
    return Runner(MODEL, parameters).run(len(position), {"position": position})["tremor"]


def tones(seconds, frequency=(9.0, 10.0, 11.0), size=30e-6):
    """A tone along each axis, (n, 3) [m]; a frequency may change with time, (n, 3)."""
    n = round(seconds / T)
    turn = 2 * np.pi * T * np.cumsum(np.broadcast_to(frequency, (n, 3)), axis=0)
    return size * np.sin(turn)


def reduction(hands, delay=0, added=lambda t: 0.0, noise=0.0):
    """A-posteriori and in-band: mean and worst recording [%].

    The tremor of the hand is what counts, whatever is added to what the filter sees.
    """
    found = []
    for k, hand in enumerate(hands):
        seen = hand.position + added(hand.time)
        seen = seen + noise * np.random.default_rng(k).standard_normal(seen.shape)
        late = run(seen, horizon=delay * T)
        late = np.vstack((np.zeros((delay, 3)), late))[: len(seen)]
        score = bench.score(hand, late)
        found.append((score.a_posteriori, score.in_band))
    return np.mean(found, axis=0), np.min(found, axis=0)


@pytest.mark.parametrize(
    ("delay", "wanted"), [(0, (49, 58)), (4, (46, 55)), (8, (44, 53.5))], ids=["0", "4", "8"]
)
def test_recorded_hands_with_a_delay_of_the_loop(hands, delay, wanted):
    """[ms]; one set of parameters, no training on a trial, no trial below 35 / 48 without delay."""
    mean, worst = reduction(hands, delay)
    print(f"\n{delay} ms: mean {mean.round(2)}, worst {worst.round(2)}")
    assert np.all(mean >= wanted)
    if delay == 0:
        assert np.all(worst >= (35, 48))


def slow_sine(t):
    return np.repeat(1e-3 * np.sin(2 * np.pi * t)[:, None], 3, axis=1)


def reaches(t):
    """5 mm in 0.7 s, of least jerk, there and back every 2 s."""
    s = np.clip((t % 2.0) / 0.7, 0.0, 1.0)
    way = 5e-3 * s**3 * (10 - 15 * s + 6 * s**2)
    return np.repeat(np.where(t // 2 % 2 == 0, way, 5e-3 - way)[:, None], 3, axis=1)


@pytest.mark.parametrize("intent", [slow_sine, reaches])
def test_recorded_hands_with_intent_added(hands, intent):
    mean, _ = reduction(hands, added=intent)
    print(f"\n{intent.__name__}: mean {mean.round(2)}")
    assert np.all(mean >= (46, 52))


def test_recorded_hands_with_sensor_noise_added(hands):
    """3 um, white, at 1 kHz."""
    mean, _ = reduction(hands, noise=3e-6)
    print(f"\nnoise: mean {mean.round(2)}")
    assert np.all(mean >= (40, 47))


@pytest.mark.parametrize("motion", list(bench.intents()), ids=lambda motion: motion.name)
def test_intent_alone_is_left_alone(motion):
    """1 Hz, 1 mm: at most 0.2 % of it; the same of a ramp, a reach and a circle."""
    assert bench.disturbance(motion, run(motion.position)) < 0.2


def test_a_tone_comes_out_as_large_as_the_band_lets_it_and_a_horizon_ahead():
    """Whatever the horizon: a tone is forecast without remainder."""
    tone = tones(6.0)
    for horizon in (0.0, 4e-3, 9.5e-3):
        found = run(tone, horizon=horizon)[3000:]
        turn = 2 * np.pi * np.array([9.0, 10.0, 11.0]) * (T * np.arange(1, 6001)[:, None] + horizon)
        wanted = (30e-6 * np.sin(turn))[3000:]
        assert np.abs(found - wanted).max() < 0.06 * 30e-6


def witness(position, at, parameters):
    """The equations in NumPy, one least squares over all of the past, for one sample.

    A from rows of strides with weights that fall, the prior as rows of its own; then the forecast
    step by step; then the band-pass over past and forecast.
    """
    memory = MODEL.parameters.fields["memory"].start[0]
    s = position - position[0]
    s = np.vstack((np.zeros((STRIDE * (AHEAD + 2), 3)), s))
    at = at + STRIDE * (AHEAD + 2)
    v = s[STRIDE:] - s[:-STRIDE]
    v = np.vstack((np.zeros((STRIDE, 3)), v))
    learnt = at_round(at) - 1  # the last sample before the round
    A = []
    for axis in range(3):
        order = [(axis + k) % 3 for k in range(3)]
        end = learnt + axis
        k = np.arange(STRIDE * (OWN + 1), end + 1)
        rows = np.column_stack(
            [v[k - STRIDE * i, order[0]] for i in range(1, OWN + 1)]
            + [v[k - STRIDE * i, b] for b in order[1:] for i in range(1, CROSS + 1)]
        )
        weight = np.exp(-(end - k) * T / memory)
        turn = (v[STRIDE:] - v[:-STRIDE])[: end + 1 - STRIDE, axis]
        fade = np.exp(-(end - STRIDE - np.arange(len(turn))) * T / memory)
        unrest = (1 - np.exp(-T / memory)) * np.sum(fade * turn**2)
        prior = 3 * var_forecaster.PRIOR / T * (unrest + var_forecaster.LEAST_MOVE**2)
        keeps = np.exp(-2 * np.pi * var_forecaster.PRIOR_CORNER * STRIDE * T)
        R = (rows * weight[:, None]).T @ rows + prior * np.eye(rows.shape[1])
        r = (rows * weight[:, None]).T @ v[k, axis]
        r[0] += prior * keeps
        A.append(np.linalg.solve(R, r))
    past = [v[at - STRIDE * j] for j in range(OWN)]
    place, forecast = s[at].copy(), []
    for _ in range(AHEAD):
        following = []
        for axis in range(3):
            order = [(axis + k) % 3 for k in range(3)]
            row = [past[j][order[0]] for j in range(OWN)]
            row += [past[j][b] for b in order[1:] for j in range(CROSS)]
            following.append(A[axis] @ row)
        past.insert(0, np.array(following))
        place = place + past[0]
        forecast.append(place)
    runner = Runner(MODEL, parameters)
    d = runner.d
    back, sums = d[: AHEAD + 1], d[AHEAD + 1 : 2 * AHEAD + 1]
    ahead = sums - np.append(sums[1:], 0.0)
    return back @ s[at - STRIDE * np.arange(AHEAD + 1)] + ahead @ np.array(forecast)


def at_round(at):
    """First sample of the round whose coefficients are in force at a sample."""
    samples = at - STRIDE * (AHEAD + 2)
    fold = samples - 4  # solved at 0, 1, 2 of a round, folded at 3, in force at the next
    return fold - fold % var_forecaster.EVERY + STRIDE * (AHEAD + 2)


def test_it_is_least_squares_forecast_and_band_pass():
    """Against the equations in NumPy: a hand-like motion, with intent ten times its tremor."""
    rng = np.random.default_rng(2)
    n = 3200
    t = T * np.arange(n)
    shape = np.exp(-0.5 * ((np.fft.rfftfreq(n, T) - 9.5) / 1.5) ** 2)[:, None]
    noise = np.fft.irfft(shape * np.fft.rfft(rng.standard_normal((n, 3)), axis=0), n, axis=0)
    motion = 20e-6 * noise / noise.std() + slow_sine(t) + 0.1e-6 * rng.standard_normal((n, 3))
    motion -= motion[0]
    found = run(motion, horizon=4e-3)
    for at in (2050, 2510, 3199):
        expected = witness(motion, at, {"horizon": 4e-3})
        np.testing.assert_allclose(found[at], expected, atol=0.02e-6)


def test_positions_count_from_the_first_and_gaps_are_bridged():
    """An offset changes nothing; a gap of 50 ms hardly shows, a long one fades; no steps."""
    tone = tones(8.0)
    np.testing.assert_allclose(run(tone + 0.3), run(tone), atol=1e-12)
    valid = np.ones(8000)
    valid[4000:4050] = 0
    gap = tone.copy()
    gap[4000:4050] = 0.7
    short = Runner(MODEL).run(8000, {"position": gap, "valid": valid})["tremor"]
    assert np.abs(short - run(tone))[4000:].max() < 0.35 * 30e-6
    assert np.abs(short - run(tone))[5000:].max() < 0.05 * 30e-6
    valid[4000:6000], gap[4000:6000] = 0, 0.7
    long = Runner(MODEL).run(8000, {"position": gap, "valid": valid})["tremor"]
    assert np.abs(long[5000:6000]).max() < 0.02 * 30e-6
    steps = np.abs(np.diff(long, axis=0))[2000:]
    assert steps.max() < 1.5 * np.abs(np.diff(tone, axis=0)).max()


def test_tremor_onset_and_stop():
    """Quiet, then tremor, then quiet: found within a second, and nothing left half a second on."""
    still = 0.1e-6 * RNG.standard_normal((12_000, 3))
    on = slice(4000, 8000)
    motion = still.copy()
    motion[on] += tones(4.0)
    found = run(motion)
    assert np.abs(found[:4000]).max() < 1e-6
    left = (motion - found)[5000:7800]
    assert np.std(left) < 0.1 * np.std(motion[5000:7800])
    assert np.abs(found[8500:]).max() < 1.5e-6


@pytest.mark.parametrize("jump", [(8.0, 11.0), (11.0, 8.0)])
def test_a_jump_of_the_frequency(jump):
    """Both tones are in the memory afterwards: two seconds on, nine tenths are found."""
    n = 10_000
    frequency = np.where(np.arange(n)[:, None] < n // 2, *jump)
    motion = tones(n * T, frequency) + 0.1e-6 * RNG.standard_normal((n, 3))
    left = (motion - run(motion))[7000:]
    assert np.std(left) < 0.1 * np.std(motion[7000:])


@pytest.mark.parametrize("factor", [5.0, 0.2])
def test_a_change_of_the_amplitude(factor):
    n = 10_000
    motion = tones(n * T) * np.where(np.arange(n)[:, None] < n // 2, 1.0, factor)
    motion += 0.1e-6 * RNG.standard_normal((n, 3))
    found = run(motion)
    left = (motion - found)[6000:]
    assert np.std(left) < 0.1 * np.std(motion[6000:])
    assert np.abs(found).max() < 1.3 * np.abs(motion).max()


def test_the_output_fades_in_while_it_learns():
    found = run(tones(4.0))
    assert np.abs(found[:50]).max() < 0.1 * 30e-6
    assert LEARNING == 1.5
    assert np.abs(found[1500:]).max() > 0.9 * 30e-6
