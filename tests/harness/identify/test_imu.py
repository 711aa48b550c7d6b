"""`steadytip identify turntable` and `imu`: from a bench to parameters that any run accepts."""

import itertools
from pathlib import Path

import numpy as np
import pytest

import steadytip as st
from fmu_src.device import design
from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.identify.imu import fit as calibration
from harness.identify.imu import turntable
from harness.parts.ssv import read_ssv
from harness.recordings.turntable import (
    CHANNELS,
    StaticPositions,
    group_positions,
    read_positions,
)
from harness.reproduce.experiments import tilt
from tests.estimation.test_compensation import AXES, OUT, sensed, sensing_axis
from tests.harness.identify.commands import write_csv

pytestmark = pytest.mark.xdist_group("turntable")
DWELL = 0.25
"""Of the benches here; the procedure has 5 s [s]."""
HEADINGS = ["alpha [deg]", "beta [deg]", *(f"{name} [V]" for name in CHANNELS)]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """The raw unit on the turntable, for a moment at each angle: file and rows."""
    alpha, beta = turntable.grid()
    done = turntable.simulate(
        turntable.sensors("raw_unit", "sensors"), alpha, beta, turntable.Turntable(), 1, dwell=DWELL
    )
    rows = np.column_stack((np.degrees(done.alpha), np.degrees(done.beta), done.volts))
    path = tmp_path_factory.mktemp("bench") / "unit_7.csv"
    return _write(path, rows), rows


def _write(path: Path, rows: np.ndarray, headings=HEADINGS) -> Path:
    return write_csv(path, rows, headings, "%.7f")


# What calibration is worth -----------------------------------------------------------------------


def test_tilt_is_better_than_in_table_4_1_between_the_angles_that_were_calibrated():
    """A04: linear 2.88 and 1.64 deg rms, physical 0.32 and 0.60; largest 0.82 and 0.82."""
    found = tilt.sweep(tilt.identified(DWELL), 9)
    rms = {
        name: [np.degrees(np.sqrt(np.mean(v**2))) for v in errors.counted().values()]
        for name, errors in found.items()
    }
    print(rms)
    assert rms["linear"] == pytest.approx([2.88, 1.64], rel=0.1)
    assert rms["physical"][0] < 0.16
    assert rms["physical"][1] < 0.2
    assert max(np.degrees(np.abs(v).max()) for v in found["physical"].counted().values()) < 0.5
    assert np.degrees(np.sqrt(np.mean(found["physical"].attitude ** 2))) < 0.35


def test_a_thermometer_keeps_the_tilt_right_in_a_warmer_room():
    """Calibrated at 10 and 35 degC, tested at 34; by the parameters of 22 degC alone it is off."""
    one, two = (tilt.identified(DWELL, rooms)["physical"] for rooms in ((22.0,), (10.0, 35.0)))
    found = tilt.sweep({"one room": one, "two rooms": two}, 12, 34.0)
    rms = {name: np.degrees(np.sqrt(np.nanmean(errors.beta**2))) for name, errors in found.items()}
    print(rms)
    assert rms["one room"] > 0.35
    assert rms["two rooms"] < 0.16


def test_a_run_of_the_raw_unit_with_the_set_has_a_right_attitude(bench, tmp_path, identify):
    """The command's file in the closed loop: 5.5 deg of attitude error without it, 0.1 with."""
    out = tmp_path / "unit_7.ssv"
    shown = identify.accepts("imu", bench[0], "--out", out)
    assert "144 rests" in shown
    assert "no temperature" in shown
    assert (tmp_path / "unit_7.html").is_file()
    written = read_ssv(out)
    assert written["accelerometer.scale[1]"].unit == "V.s2/m"
    overrides = {"seconds": 3.0, "part.estimator.parameters": str(out)}
    run = st.run("raw_unit", overrides=overrides, out=tmp_path / "run", report=False)
    assert np.degrees(run.metrics["attitude_error_rms"].value) < 0.25


def test_the_linear_model_is_that_of_the_two_rests(bench, tmp_path, identify):
    """Channel a1x: volts at alpha = 90 deg, beta = 0 and 180 deg."""
    out = tmp_path / "linear.ssv"
    identify.accepts("imu", bench[0], "--linear", "--out", out, "--quiet")
    rows = bench[1]
    up, down = (
        rows[(rows[:, 0] == alpha) & (rows[:, 1] == beta), 2].mean()
        for alpha, beta in ((90, 0), (90, 180))
    )
    # At -90 and 180 deg x points up just the same.
    again_up = rows[(rows[:, 0] == -90) & (rows[:, 1] == 180), 2].mean()
    again_down = rows[(rows[:, 0] == -90) & (rows[:, 1] == 0), 2].mean()
    up, down = (up + again_up) / 2, (down + again_down) / 2
    found = {name: entry.value for name, entry in read_ssv(out).items()}
    assert found["accelerometer.zero[1]"] == pytest.approx((up + down) / 2, abs=1e-6)
    assert found["accelerometer.scale[1]"] == pytest.approx(
        (up - down) / 2 / design.SITE_GRAVITY, rel=1e-5
    )
    assert "accelerometer.misalignment[1,1]" not in found


# Parameters and intervals ------------------------------------------------------------------------


def known_unit(seed: int, scatter: float, drift: bool = False):
    """Rests of a unit of the model's own form, and its parameters, by NumPy alone."""
    rng = np.random.default_rng(seed)
    c = {
        "in_plane_squared": rng.uniform(-3e-3, 3e-3, 6),
        "out_of_plane_squared": rng.uniform(-3e-3, 3e-3, 6),
        "scale_slope": rng.uniform(-1e-3, 1e-3, 6),
        "scale_curvature": rng.uniform(-2e-4, 2e-4, 6),
        "misalignment": rng.uniform(-0.05, 0.05, (6, 2)),
        "in_plane": np.zeros(6),
        "out_of_plane": np.zeros(6),
    }
    zero, scale = rng.uniform(2.45, 2.55, 6), rng.uniform(0.097, 0.107, 6)
    drifts = {
        "zero_drift": rng.uniform(-1e-3, 1e-3, 6) * drift,
        "scale_drift": rng.uniform(-5e-4, 5e-4, 6) * drift,
    }
    m_zero, m_scale = rng.uniform(2.45, 2.55, 3), rng.uniform(9.5e3, 10.5e3, 3)
    m_off = rng.uniform(-0.05, 0.05, (3, 2))
    grid = turntable.grid(30.0)
    alpha, beta = (np.tile(angle, 2) for angle in grid) if drift else grid
    warm = np.repeat([20.0, 30.0], len(grid[0])) if drift else np.full(len(alpha), 30.0)
    table = turntable.Turntable(scatter=scatter, mount=(0, 0, 0), seed=seed)
    attitudes = table.attitudes(alpha, beta)
    north = 50e-6 * np.array([np.cos(0.96), 0.0, -np.sin(0.96)])
    volts = []
    for k, change in enumerate(warm - warm.mean()):
        force = attitudes[k].inv().apply([0, 0, design.SITE_GRAVITY])
        field = attitudes[k].inv().apply(north)
        rows = np.array([sensing_axis(i, m_off[i]) for i in range(3)])
        s = sensed(force, c) * scale * (1 + drifts["scale_drift"] * change)
        a = zero + drifts["zero_drift"] * change + s
        volts.append(np.append(a, m_zero + m_scale * (rows @ field)))
    noise = rng.normal(0, 2e-4, (len(alpha), 9))
    truth = {
        **{f"accelerometer.{name}": value for name, value in (c | drifts).items()},
        "accelerometer.zero": zero,
        "accelerometer.scale": scale,
        "magnetometer.zero": m_zero,
        "magnetometer.scale": m_scale,
        "magnetometer.misalignment": m_off,
    }
    found = StaticPositions(alpha, beta, np.array(volts) + noise, warm, np.ones(len(alpha)))
    return found, truth, table


def _true(truth, name: str) -> float:
    field, _, index = name.partition("[")
    at = tuple(int(i) - 1 for i in index.rstrip("]").split(","))
    return float(truth[field][at])


def test_intervals_cover_the_parameters_of_known_units():
    """Four units and turntables: 95 % intervals hold 90 to 99 % of the truths; none is far off."""
    inside, ratios = [], []
    for seed in range(4):
        found, truth, table = known_unit(seed, np.radians(0.03))
        result = calibration.calibrate(found)
        for one in result.found:
            if np.isfinite(one.half):
                off = abs(one.value - _true(truth, one.scalar.name))
                inside.append(off <= one.half)
                ratios.append(off / one.half)
        for (value, half), real in zip(
            result.table.values(), (table.zero, table.level, table.square), strict=True
        ):
            assert abs(value - real) < 2.5 * half
    print(np.mean(inside), max(ratios))
    assert 0.90 < np.mean(inside) < 0.99
    assert max(ratios) < 2.5


def test_a_known_unit_and_the_errors_of_its_turntable_come_back():
    """0.2 mV of noise, no scatter of the angles."""
    found, truth, table = known_unit(11, 0.0)
    result = calibration.calibrate(found)
    assert np.sqrt(np.mean(result.residual**2)) < 3e-3
    for one in result.found:
        if one.scalar.name.startswith("accelerometer.misalignment"):
            assert one.value == pytest.approx(_true(truth, one.scalar.name), abs=5e-4)
    assert [v for v, _ in result.table.values()] == pytest.approx(
        [table.zero, table.level, table.square], abs=5e-5
    )
    assert np.degrees(result.inclination) == pytest.approx(np.degrees(0.96), abs=0.02)


def test_drifts_are_found_where_the_temperature_varies():
    found, truth, _ = known_unit(4, np.radians(0.01), drift=True)
    result = calibration.calibrate(found)
    values = {one.scalar.name: one for one in result.found}
    assert values["thermometer.reference"].value == pytest.approx(25.0)
    for i in range(1, 7):
        for what, size in (("zero_drift", 1e-3), ("scale_drift", 5e-4)):
            one = values[f"accelerometer.{what}[{i}]"]
            assert one.value == pytest.approx(_true(truth, one.scalar.name), abs=0.03 * size)
    assert not result.notes
    one_room = calibration.calibrate(known_unit(4, 1e-4)[0])
    assert not any("drift" in one.scalar.name for one in one_room.found)
    assert "drifts" in one_room.notes[0]


def test_the_turntable_is_that_of_the_thesis():
    """alpha = 90 deg, beta = 0: x up; alpha = 0: z up, whatever beta; the angles cover all."""
    up = turntable.up(np.radians([90.0, 0.0, 90.0, -90.0]), np.radians([0.0, 77.0, 90.0, 90.0]))
    np.testing.assert_allclose(up, [[1, 0, 0], [0, 0, 1], [0, -1, 0], [0, 1, 0]], atol=1e-12)
    alpha, beta = turntable.grid()
    assert len(set(zip(alpha, beta, strict=True))) == len(alpha) == 144
    assert {-30, 30, -90, 90, -150, 150} <= set(np.round(np.degrees(alpha)).astype(int))


def test_neighbours_of_each_channel():
    assert [AXES[o] for pair in OUT for o in pair] == [1, 1, 1, 1, 0, 0, 0, 0, 2, 2, 2, 2]


# The command -------------------------------------------------------------------------------------


def test_the_simulated_bench_is_a_recording_for_imu(tmp_path, identify):
    """Two rooms, so that drifts are found; Parquet as well as text."""
    path = tmp_path / "bench.parquet"
    arguments = ("--grid", 45, "--dwell", 0.05, "--ambient", 15, "--ambient", 30)
    shown = identify.accepts("turntable", path, *arguments)
    assert "in 128 rests" in shown
    shown = identify.accepts("imu", path, "--out", tmp_path / "a.ssv")
    assert "accelerometer.zero_drift[6]" in shown
    assert "±" in shown
    found = read_ssv(tmp_path / "a.ssv")
    # Stress follows the sensor, not the board, but from one steady state to another they agree.
    drift = found["accelerometer.zero_drift[1]"].value / design.ACCELEROMETER_SCALE
    assert drift == pytest.approx(0.006, rel=0.1)


def _set(places, values):
    """A change of some places of the rows, to values or to what a function makes of them."""

    def change(rows: np.ndarray) -> np.ndarray:
        rows = rows.copy()
        rows[places] = values(rows[places]) if callable(values) else values
        return rows

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows[np.arange(len(rows)) // 5 % 8 == 0],
         ("18 rests", "at least 24", "turntable")),
        (lambda rows: rows[rows[:, 0] == 90], ("alpha covers 0 deg", "--alpha")),
        (_set(np.s_[17, 4], np.nan), ("a2y is nan", "line 19", "record it again")),
        (_set(np.s_[:, :2], np.radians), ("radians", "--angle-unit rad")),
        (_set(np.s_[:, 2:], lambda volts: 1e3 * volts), ("--volts-unit V|mV|kV",)),
        (_set(np.s_[:, 5], 2.5), ("a2z is 2.5 V at every angle", "not connected")),
        (_set(np.s_[40:45, 3], lambda volts: volts + 0.05 * np.arange(5)),
         ("a1z moves by", "line 42", "wait longer")),
        (_set(np.s_[:, 0], lambda alpha: 60 - alpha),
         ("do not explain channel a1x", "signs of alpha and beta")),
        (_set(np.s_[:, [2, 4]], lambda volts: volts[:, ::-1]),
         ("channel a1x", "goes with y", "another channel")),
    ],
    ids=["few", "one plane", "nan", "radians", "millivolts", "dead", "no rest", "wrong sign",
         "swapped"],
)  # fmt: skip
def test_what_cannot_be_calibrated_from_is_refused_with_a_cure(
    bench, change, words, tmp_path, identify
):
    path = _write(tmp_path / "bad.csv", change(bench[1]))
    errors = identify.refuses("imu", path, "--out", tmp_path / "bad.ssv")
    assert "bad.csv" in errors
    for word in words:
        assert word in errors
    assert not (tmp_path / "bad.ssv").exists()


def test_units_and_columns_that_the_headings_do_not_say(bench, tmp_path, identify):
    """Radians, millivolts, a channel of another name, no magnetometer: the same parameters."""
    rows = bench[1].copy()
    rows[:, :2] = np.radians(rows[:, :2])
    rows[:, 2:] *= 1e3
    headings = ["tilt", "turn", "ai0", *CHANNELS[1:6]]
    path = _write(tmp_path / "odd.csv", rows[:, :8], headings)
    out = tmp_path / "odd.ssv"
    assert "--channel a1x=NAME" in identify.refuses("imu", path, "--out", out)
    units = ("--angle-unit", "rad", "--volts-unit", "mV", "--channel", "a1x=ai0")
    identify.accepts("imu", path, "--out", out, *units)
    identify("imu", bench[0], "--out", tmp_path / "plain.ssv", "--quiet")
    odd, plain = read_ssv(out), read_ssv(tmp_path / "plain.ssv")
    assert not any(name.startswith("magnetometer") for name in odd)
    for name, entry in odd.items():
        assert entry.value == pytest.approx(plain[name].value, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "arguments", "words"),
    [
        ("imu", ("none.csv",), "does not exist"),
        ("imu", ("none.csv", "--out", "set.txt"), "ends in .ssv"),
        ("imu", ("none.csv", "--channel", "b7=1"), "--channel b7=1"),
        ("turntable", ("out.csv", "--grid", "7"), "--grid 7"),
        ("turntable", ("out.csv", "--dwell", "0"), "--dwell 0"),
        ("turntable", ("out.csv", "--part", "nose"), "'nose'"),
        ("turntable", ("out.csv", "--part", "hand"), "has no force1_x"),
        ("turntable", ("out.csv", "--ambient", "300"), "--ambient 300"),
        ("turntable", ("out.csv", "--scenario", "nowhere"), "nowhere"),
    ],
)
def test_wrong_options_are_told(kind, arguments, words, tmp_path, identify):
    path = tmp_path / arguments[0]
    assert words in identify.refuses(kind, path, *arguments[1:])


def test_a_stream_with_the_ways_between_the_rests(bench):
    """An encoder that flickers, and rows of a turntable on its way: the rests alone are taken."""
    rng = np.random.default_rng(3)
    rests_only = bench[1].reshape(-1, turntable.ROWS, 11)
    pieces = [rests_only[0]]
    for before, after in itertools.pairwise(rests_only):
        way = np.linspace(before[-1], after[0], 12)[1:-1]
        pieces += [way, after]
    stream = np.concatenate(pieces)
    stream[:, :2] += rng.uniform(-0.005, 0.005, (len(stream), 2))
    found = group_positions(*np.radians(stream[:, :2].T), stream[:, 2:], None, CHANNELS, "stream")
    plain = group_positions(
        *np.radians(bench[1][:, :2].T), bench[1][:, 2:], None, CHANNELS, "plain"
    )
    assert "1430 rows on the way" in found.notes[0]
    assert len(found) == len(plain) == 144
    np.testing.assert_allclose(found.volts, plain.volts, atol=1e-12)
    np.testing.assert_allclose(found.alpha, plain.alpha, atol=np.radians(0.01))


def test_a_magnetometer_in_part_is_refused(bench, tmp_path):
    path = _write(tmp_path / "part.csv", bench[1][:, :10], HEADINGS[:10])
    with pytest.raises(SteadytipError, match="all three are needed"):
        read_positions(path)


def test_rests_that_are_too_much_alike_name_what_is_missing(bench):
    found = read_positions(bench[0])
    tilted = np.abs(np.degrees(found.alpha)) <= 60
    with pytest.raises(ProblemsError, match="z never points down"):
        calibration.calibrate(found.select(tilted))
