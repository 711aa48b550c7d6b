"""`steadytip identify allan`: noise of known densities, and what becomes of it."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit.runner import Runner
from fmu_src.pack.discovery import load_model
from harness.identify.allan import fit as allan
from harness.identify.parameter_files import write_parameters
from harness.parts.ssv import read_ssv
from plants import gyro_imu, inertial_sensors
from tests.harness.identify.commands import write_csv

N, K = 2e-3, 2e-3
"""White noise and random walk, unit/Hz0.5 and unit/s0.5."""
T = 0.01


def white(rng, count: int, period: float = T, density: float = N) -> np.ndarray:
    return density / np.sqrt(2 * period) * rng.normal(size=count)


def walk(rng, count: int, period: float = T, density: float = K) -> np.ndarray:
    return density * np.sqrt(period) * np.cumsum(rng.normal(size=count))


def flicker(rng, count: int, level: float) -> np.ndarray:
    """Noise of spectral density level^2 / (2 pi f), by filtering (Kasdin)."""
    k = np.arange(1, count)
    coefficients = np.concatenate(([1.0], np.cumprod((k - 0.5) / k)))
    spectrum = np.fft.rfft(coefficients, 2 * count) * np.fft.rfft(rng.normal(size=count), 2 * count)
    return level * np.fft.irfft(spectrum)[:count] / np.sqrt(2 * np.pi) * np.sqrt(np.pi)


# Terms -------------------------------------------------------------------------------------------


def test_intervals_cover_white_noise_and_random_walk():
    """Forty records of 200 s: both terms are seen in each, within 95 % intervals mostly."""
    inside = {"white": [], "walk": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = allan.analyse(white(rng, 20_000) + walk(rng, 20_000), T)
        assert "bias" not in noise.terms or "walk" in noise.terms
        for name, truth in (("white", N), ("walk", K)):
            term = noise.terms[name]
            assert term.value == pytest.approx(truth, rel=0.5)
            inside[name].append(abs(term.value - truth) <= term.half)
    shares = {name: np.mean(found) for name, found in inside.items()}
    print(shares)
    assert all(share >= 0.87 for share in shares.values())


def test_a_long_record_shows_white_noise_flicker_and_trend_one_by_one():
    """And nothing that is not there."""
    rng = np.random.default_rng(2)
    n = 400_000
    plain = allan.analyse(white(rng, n), T)
    assert set(plain.terms) == {"white", "sample"}
    assert plain.terms["white"].value == pytest.approx(N, rel=0.02)
    assert plain.terms["sample"].value == pytest.approx(N / np.sqrt(2 * T), rel=0.02)
    assert "longer record" in plain.notes[0]
    ramp = allan.analyse(white(rng, n) + 3e-6 * T * np.arange(n), T)
    assert set(ramp.terms) == {"white", "sample", "trend"}
    assert ramp.terms["trend"].value == pytest.approx(3e-6, rel=0.2)
    level = 1e-3
    pink = allan.analyse(white(rng, n, density=1e-4) + flicker(rng, n, level), T)
    assert {"white", "bias"} <= set(pink.terms)
    floor = np.sqrt(2 * np.log(2) / np.pi) * pink.terms["bias"].value
    assert floor == pytest.approx(np.median(pink.curve.deviation[8:14]), rel=0.1)


def test_rounding_of_an_integral_has_the_slope_of_one():
    """Differences of a rounded position: Q is the rms of the rounding."""
    rng = np.random.default_rng(3)
    rounded = np.diff(rng.uniform(-0.5, 0.5, 50_001)) / T * 1e-4
    noise = allan.analyse(rounded, T)
    assert noise.terms["quantisation"].value == pytest.approx(1e-4 / np.sqrt(12), rel=0.05)


def test_the_deviation_is_the_definition():
    """Against means of neighbouring pieces, written out, at four averaging times."""
    rng = np.random.default_rng(4)
    values = white(rng, 4000) + walk(rng, 4000)
    curve = allan.deviation(values, T)
    for at, m in ((0, 1), (3, 8), (6, 64), (8, 256)):
        means = np.convolve(values, np.ones(m) / m, "valid")
        expected = np.sqrt(np.mean((means[m:] - means[:-m]) ** 2) / 2)
        assert curve.tau[at] == pytest.approx(m * T)
        assert curve.deviation[at] == pytest.approx(expected, rel=1e-9)
        assert curve.low[at] < curve.deviation[at] < curve.high[at]


@pytest.mark.parametrize("lag", [None, 0.0106])
def test_noise_behind_the_output_filter(lag):
    """At 1 kHz: density and time constant are found, and are those of the plant's own noise."""
    period, tau, count = 1e-3, 0.0106, 300_000
    keep = np.exp(-period / tau)
    rng = np.random.default_rng(5)
    driven = N / np.sqrt(4 * tau) * np.sqrt(1 - keep**2) * rng.normal(size=count)
    noise = allan.analyse(lfilter([1], [1, -keep], driven), period, lag)
    assert noise.lag == pytest.approx(tau, rel=0.1)
    assert noise.terms["white"].value == pytest.approx(N, rel=0.05)
    assert noise.terms["sample"].value == pytest.approx(N / np.sqrt(4 * tau), rel=0.06)


def test_slow_samples_fold_the_noise_unless_the_filter_is_known():
    """At 1 Hz behind 10 ms every sample is new; the density is the filter's to tell."""
    rng = np.random.default_rng(6)
    tau = 0.0106
    values = N / np.sqrt(4 * tau) * rng.normal(size=20_000)
    unknown, known = allan.analyse(values, 1.0), allan.analyse(values, 1.0, tau)
    assert known.terms["white"].value == pytest.approx(N, rel=0.03)
    assert unknown.terms["white"].value == pytest.approx(N / np.sqrt(2 * tau), rel=0.03)


# The command -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """The plant at rest for a minute, with the noise of the thesis."""
    up = [0.0, 0.0, design.SITE_GRAVITY]
    inputs = {"force1": up, "force2": up, "force3": up, "field": [2e-5, 0, -4e-5]}
    sensors = Runner(inertial_sensors.MODEL, {"accelerometer_noise": 4.535e-3, "seed": 8})
    volts = sensors.run(60_000, inputs)["volts"]
    path = tmp_path_factory.mktemp("rest") / "still.csv"
    table = np.column_stack((np.arange(60_000) * 1e-3, volts))
    return write_csv(path, table, ["time [s]", *(f"{n} [V]" for n in inertial_sensors.CHANNELS)])


def test_channels_of_the_instrument_become_covariances_of_its_estimator(
    recording, tmp_path, identify
):
    out = tmp_path / "noise.ssv"
    shown = identify.accepts("allan", recording, "--out", out)
    assert "white noise N" in shown
    assert "m/s2/Hz0.5" in shown
    assert (tmp_path / "noise.html").is_file()
    values = {name: entry.value for name, entry in read_ssv(out).items()}
    density = [values[f"accelerometer.density[{i}]"] for i in range(1, 7)]
    np.testing.assert_allclose(density, 4.535e-3, rtol=0.15)
    assert np.mean(density) == pytest.approx(4.535e-3, rel=0.05)
    # HMC2003: 40 ugauss in 10 Hz, of 1 kHz folded into 500 Hz.
    sigma = 40e-10 * np.sqrt(np.pi / 2 * 1e3 / 10)
    assert values["magnetometer.sigma"] == pytest.approx(sigma, rel=0.05)
    assert set(values) <= {scalar.name for scalar in MODEL.parameters.scalars()}
    Runner(MODEL, values).run(1)


def test_the_scale_of_a_calibrated_unit_is_used(recording, tmp_path, identify):
    names = [f"accelerometer.scale[{i}]" for i in range(1, 7)]
    names += [f"magnetometer.scale[{i}]" for i in range(1, 4)]
    scalars = [s for s in MODEL.parameters.scalars() if s.name in names]
    doubled = {s.name: 2 * s.start for s in scalars}
    scales = write_parameters(tmp_path / "scales.ssv", scalars, doubled, "")
    found = []
    for more in ((), ("--parameters", scales)):
        out = tmp_path / "noise.ssv"
        arguments = ("--out", out, "--fit", "0:20", "--column", "a2y", "--quiet", *more)
        assert identify("allan", recording, *arguments)[0] == 0
        found.append(read_ssv(out)["accelerometer.density[3]"].value)
    assert found[1] == pytest.approx(found[0] / 2, rel=1e-6)


def test_any_column_into_any_parameter(tmp_path, identify):
    """A gyro in deg/s with one column and no time; units are checked against the model's."""
    rng = np.random.default_rng(9)
    path = tmp_path / "gyro.txt"
    path.write_text("\n".join(f"{v:.9g}" for v in white(rng, 30_000) + walk(rng, 30_000)))
    plain = ("--rate", 100, "--unit", "deg/s")
    assert "--into" in identify.refuses("allan", path, *plain, "--out", tmp_path / "a.ssv")
    shown = identify.accepts("allan", path, *plain)
    assert "rad/s/Hz0.5" in shown
    into = ("--into", "bias_start=white:column 1", "--out", tmp_path / "a.ssv")
    errors = identify.refuses("allan", path, *plain, *into)
    assert "in rad/s/Hz0.5, and the parameter is in rad/s" in errors
    into = ("--into", "bias_start=sample:column 1", "--out", tmp_path / "a.ssv")
    identify.accepts("allan", path, *plain, *into)
    expected = np.radians(N) / np.sqrt(2 * T)
    assert read_ssv(tmp_path / "a.ssv")["bias_start"].value == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("model", "names"),
    [
        ("OpticalGyroEkf", {"rate_noise", "bias_walk"}),
        (
            "OpticalInertialEkf",
            {f"inertial.{n}" for n in ("rate_noise", "rate_bias_walk", "force_noise")},
        ),
        ("EmInertialEkf", {f"inertial.{n}" for n in ("rate_noise", "bias_walk", "force_noise")}),
    ],
)
def test_ports_of_a_gyro_unit_become_covariances_of_its_estimators(
    model, names, tmp_path, identify
):
    """The plant's densities; its accelerometers walk too little to be seen in a minute."""
    noise, walk_density = np.radians(0.01), 5e-4
    unit = Runner(gyro_imu.MODEL, {"gyro_noise": noise, "gyro_walk": walk_density, "seed": 4})
    out = unit.run(60_000)
    table = np.column_stack((np.arange(60_000) * 1e-3, out["rate"], out["force"]))
    headings = ["time [s]", *(f"imu.rate_{a} [rad/s]" for a in "xyz")]
    headings += [f"imu.force_{a} [m/s2]" for a in "xyz"]
    path = write_csv(tmp_path / "unit.csv", table, headings)
    arguments = (path, "--model", model, "--out", tmp_path / "unit.ssv")
    shown = identify.accepts("allan", *arguments)
    values = {name: entry.value for name, entry in read_ssv(tmp_path / "unit.ssv").items()}
    assert set(values) == names
    short = {n.rpartition(".")[2].removeprefix("rate_bias_"): v for n, v in values.items()}
    assert short["rate_noise"] == pytest.approx(noise, rel=0.05)
    assert short.get("walk", short.get("bias_walk")) == pytest.approx(walk_density, rel=0.4)
    if "force_noise" in short:
        assert "force_bias_walk stays" in shown
        expected = gyro_imu.MODEL.parameters.fields["accelerometer_noise"].start[0]
        assert short["force_noise"] == pytest.approx(expected, rel=0.05)
    Runner(load_model(model), values).run(1)


def _bad(rng, what: str) -> tuple[np.ndarray, list[str]]:
    table = np.column_stack((np.arange(3000) * T, white(rng, 3000)))
    headings = ["time [s]", "a1x [V]"]
    if what == "short":
        table = table[:500]
    if what == "nan":
        table[700, 1] = np.nan
    if what == "dead":
        table[:, 1] = 2.5
    if what == "knock":
        table[1200:, 1] += 1.0
    if what == "gap":
        table[1500:, 0] += 0.3
    if what == "unit":
        headings[1] = "a1x [furlong]"
    if what == "untimed":
        headings[0] = "count"
    return table, headings


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("short", ("500 samples", "at least 1000")),
        ("nan", ("nan in line 702", "record again")),
        ("dead", ("2.5 all the time", "connected")),
        ("knock", ("jumps by", "did not rest", "--fit START:END", "line 1202")),
        ("gap", ("samples are missing", "line 1502")),
        ("unit", ("furlong", "known are")),
        ("untimed", ("--rate HZ", "--time NAME")),
    ],
)
def test_records_that_are_no_rest_are_refused_with_a_cure(what, words, tmp_path, identify):
    path = write_csv(tmp_path / "bad.csv", *_bad(np.random.default_rng(1), what))
    errors = identify.refuses("allan", path, "--out", tmp_path / "bad.ssv")
    assert "bad.csv" in errors
    for word in words:
        assert word in errors
    assert not (tmp_path / "bad.ssv").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--into", "nonsense"), "PARAMETER=TERM:COLUMN"),
        (("--into", "gravity=pink:a1x"), "'pink' is no term"),
        (("--into", "weight=white:a1x"), "no parameter 'weight'"),
        (("--into", "gravity=walk:a1x"), "shows no walk"),
        (("--into", "gravity=white:b7"), "no column 'b7'"),
        (("--lag", "-1"), "--lag -1"),
        (("--fit", "0:1"), "at least 1000"),
        (("--column", "b7"), "b7 is no column"),
        (("--rate", "0"), "--rate 0"),
        (("--out", "x.txt"), "ends in .ssv"),
    ],
)
def test_wrong_options_are_told(arguments, words, tmp_path, monkeypatch, identify):
    table, headings = _bad(np.random.default_rng(1), "none")
    path = write_csv(tmp_path / "still.csv", table, headings)
    monkeypatch.chdir(tmp_path)
    assert words in identify.refuses("allan", path, *arguments)


def test_a_missing_allantools_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "allantools", None)
    with pytest.raises(SteadytipError, match=r"steadytip\[identify\]"):
        allan.analyse(np.random.default_rng(0).normal(size=2000), T)


@pytest.mark.parametrize(
    ("heading", "factor", "clock"),
    [
        ("timestamp", 1e9, "column 1 'timestamp' in ns"),
        ("timestamp", 1e3, "column 1 'timestamp' in ms"),
        ("time [us]", 1e6, "column 1 'time' in us"),
    ],
)
def test_dates_and_units_of_time_are_read_and_said(identify, tmp_path, heading, factor, clock):
    rng = np.random.default_rng(5)
    stamps = np.round((1.7e9 + np.arange(4000) / 500) * factor).astype(np.int64)
    rows = [f"{t},{v:.9f}" for t, v in zip(stamps, rng.normal(0, 0.02, 4000), strict=True)]
    path = tmp_path / "still.csv"
    path.write_text("\n".join([f"{heading},rate_x [rad/s]", *rows]) + "\n", encoding="utf-8")
    shown = identify.accepts("allan", path, "--no-report")
    assert "4000 samples in 7.998 s" in shown
    assert clock in shown


def test_a_time_in_another_unit_is_refused_with_the_likely_one(identify, tmp_path):
    values = np.random.default_rng(5).normal(0, 0.02, 4000)
    table = np.column_stack([np.arange(4000) * 1e6, values])  # us, said to be s
    path = write_csv(tmp_path / "still.csv", table, ["time [s]", "rate_x [rad/s]"])
    err = identify.refuses("allan", path, "--no-report")
    assert "1e-06 samples a second" in err
    assert "give --time-unit us" in err or "give --time-unit ns" in err
    shown = identify.accepts("allan", path, "--no-report", "--time-unit", "ns")
    assert "in ns" in shown
