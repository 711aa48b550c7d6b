"""Recordings of hand motion, good and bad."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

import steadytip
from fmu_src.errors import SteadytipError
from harness.parts.protocols import RunContext
from harness.parts.replay import PORTS, ReplayPart
from harness.recordings.motion import read_recording

HEADER = "time [s], x [mm], y [mm], z [mm]\n"


def table(t: np.ndarray, xyz: np.ndarray) -> str:
    rows = np.column_stack([t, xyz]).tolist()
    return HEADER + "\n".join(", ".join(f"{v!r}" for v in row) for row in rows) + "\n"


def good_lines() -> list[str]:
    t = np.arange(300) / 250.0
    return table(t, np.column_stack([np.sin(9 * t), np.cos(9 * t), 0.1 * t])).splitlines()


def write(folder: Path, lines: list[str] | str, name: str = "r.csv") -> Path:
    path = folder / name
    path.write_text(lines if isinstance(lines, str) else "\n".join(lines))
    return path


def played(path: Path, step: float, steps: int) -> np.ndarray:
    accept = ["glitch", "jump", "length-unit", "stuck-axis"]
    part = ReplayPart("hand.motion", {"replay": str(path), "accept": accept}, 0)
    y = np.zeros(len(PORTS))
    part.start(RunContext(step, steps, path.parent), [], [], np.zeros(0), y)
    out = []
    for k in range(steps):
        part.advance(k * step, step)
        out.append(y.copy())
    return np.array(out)


def test_the_m2s2_layout_is_read_up_to_its_first_row_of_zeros(recording: Path):
    hand = read_recording(recording)
    assert len(hand.time) == 500
    assert hand.seconds == pytest.approx(499 / 250.0)
    assert (hand.position[0] == 0.0).all()
    assert np.abs(hand.position).max() == pytest.approx(5e-5, rel=1e-3)


def test_recorded_hands_are_read_whole(data_dir: Path):
    for path in sorted((data_dir / "hand_motion_m2s2").glob("*.csv")):
        hand = read_recording(path)
        assert len(hand.time) in (5001, 5002, 7501, 7502)
        assert hand.seconds == pytest.approx((len(hand.time) - 1) / 250.0)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "  "])
@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("mm", 1.0), ("um", 1e3), ("µm", 1e3)])
def test_headers_name_columns_and_units_in_any_order(delimiter, unit, factor, tmp_path):
    t = np.arange(300) / 250.0
    names = [f"z [{unit}]", "time [ms]", "grip", f"x [{unit}]", f"y [{unit}]"]
    rows = [delimiter.join(names)]
    for s in t:
        values = (0.3 * s * factor, s * 1e3, 7.0, 0.1 * s * factor, 0.2 * s * factor)
        rows.append(delimiter.join(f"{v:.12g}" for v in values))
    hand = read_recording(write(tmp_path, rows))
    assert np.allclose(hand.time, t)
    assert np.allclose(hand.position, t[:, None] * [1e-4, 2e-4, 3e-4])


def test_parquet_is_read_with_units_from_names_or_metadata(tmp_path):
    t = np.arange(300) / 250.0
    fields = [pa.field("time [s]", pa.float64())]
    fields += [pa.field(n, pa.float64(), metadata={"unit": "mm"}) for n in "xyz"]
    path = tmp_path / "r.parquet"
    parquet.write_table(pa.table([t, t, 2 * t, 3 * t], schema=pa.schema(fields)), path)
    assert np.allclose(read_recording(path).position, t[:, None] * [1e-3, 2e-3, 3e-3])


@settings(max_examples=20)
@given(st.lists(st.floats(-1.0, 1.0), min_size=18, max_size=18), st.integers(0, 2**31))
def test_the_spline_is_exact_for_polynomials_at_uneven_times(coefficients, seed):
    """A quintic is its own interpolating spline: values and derivatives come out to rounding."""
    import tempfile

    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(3e-3, 5e-3, 400))])
    polynomials = [np.polynomial.Polynomial(c) for c in np.reshape(coefficients, (3, 6))]
    xyz = np.column_stack([p(t) for p in polynomials]) * 1e-2
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.csv"
        path.write_text(table(t, xyz * 1e3))
        out = played(path, 1e-3, 1000)
    at = np.arange(1000) * 1e-3
    for axis, p in enumerate(polynomials):
        assert np.allclose(out[:, axis], (p(at) - p(0.0)) * 1e-2, rtol=0, atol=1e-12)
        assert np.allclose(out[:, 3 + axis], p.deriv()(at) * 1e-2, rtol=0, atol=1e-9)
        assert np.allclose(out[:, 6 + axis], p.deriv(2)(at) * 1e-2, rtol=0, atol=1e-6)


def test_the_spline_goes_through_the_raw_samples_noise_and_all(data_dir: Path):
    path = data_dir / "hand_motion_m2s2" / "S_pointingxyzAI_mag1_force01_de02.csv"
    hand = read_recording(path)
    out = played(path, 1e-3, 4 * 1000 + 1)
    assert np.allclose(out[::4, :3], hand.position[:1001], rtol=0, atol=1e-12)
    assert (out[:, -1] == 1.0).all()


def test_velocity_and_acceleration_are_derivatives_of_the_position(recording: Path):
    step = 1e-4
    out = played(recording, step, 10_000)
    position, velocity, acceleration = out[:, :3], out[:, 3:6], out[:, 6:9]
    middle = slice(500, -500)
    numeric = np.gradient(position, step, axis=0)
    assert np.abs(numeric - velocity)[middle].max() < 1e-5 * np.abs(velocity).max() * 10
    numeric = np.gradient(velocity, step, axis=0)
    assert np.abs(numeric - acceleration)[middle].max() < 1e-4 * np.abs(acceleration).max() * 10


def edited(line: int, text: str) -> list[str]:
    lines = good_lines()
    lines[line - 1] = text
    return lines


def swapped() -> list[str]:
    lines = good_lines()
    lines[100], lines[101] = lines[101], lines[100]
    return lines


BAD = {
    "empty": ("", "is empty"),
    "header only": (HEADER, "has 0 samples; at least 6"),
    "too few": (good_lines()[:6], "has 5 samples; at least 6"),
    "too short": (good_lines()[:100], r"lasts 0\.39\d* s; at least 1 s"),
    "ragged": (edited(50, "1.0, 2.0, 3.0"), "line 50: 3 columns instead of 4"),
    "text": (
        edited(50, "0.192, 1.0, oops, 0.0"),
        r"line 50, column 3 \('y'\): 'oops' is not a number",
    ),
    "nan": (edited(50, "0.192, 1.0, nan, 0.0"), "line 50: not finite"),
    "infinite": (edited(50, "0.192, inf, 0.0, 0.0"), "line 50: not finite"),
    "backwards": (swapped(), r"line 102: time goes from 0\.4 s to 0\.396 s; it has to rise"),
    "repeated": (edited(50, good_lines()[48]), "line 50: time goes from .* it has to rise"),
    "gap": (good_lines()[:150] + good_lines()[190:], r"line 151: a gap of 0\.164 s"),
    "jump": (edited(50, "0.192, 9.0, 0.0, 0.0"), r"glitch: x is off by 8\.\d* mm .*line 50"),
    "furlongs": (
        [HEADER.replace("x [mm]", "x [fl]"), *good_lines()[1:]],
        r"column 2 'x', read as x, is in 'fl'; give --length-unit m\|cm\|mm\|um",
    ),
    "no unit": (
        [HEADER.replace("x [mm]", "x"), *good_lines()[1:]],
        "read as x, does not say its unit",
    ),
    "no x": (
        [HEADER.replace("x [mm]", "u [mm]"), *good_lines()[1:]],
        "no column is called like x; choose it",
    ),
    "no header": (good_lines()[1:], "line 1: 4 columns without a header; put 'time"),
    "zeros": (["0,0,0,0,9", "1,0,0,0,9"], "has 0 samples"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_recordings_are_refused_with_place_and_cure(case, tmp_path):
    lines, message = BAD[case]
    with pytest.raises(SteadytipError, match=message) as caught:
        read_recording(write(tmp_path, lines))
    assert str(tmp_path / "r.csv") in str(caught.value)


@pytest.mark.parametrize("name", ["r.csv", "r.parquet"])
def test_bytes_that_are_no_table_are_refused(name, tmp_path):
    (tmp_path / name).write_bytes(bytes(range(256)))
    with pytest.raises(SteadytipError, match="is not"):
        read_recording(tmp_path / name)


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(SteadytipError, match=r"gone\.csv does not exist"):
        read_recording(tmp_path / "gone.csv")


MOVED = 'title = "moved"\n[part.hand]\nfmu = "Hand"\n[signals]\ntip_uncompensated = "hand.tip_*"\n'


def test_a_recording_moves_the_one_part_that_takes_one(write_scenario, recording, tmp_path):
    path = write_scenario(MOVED)
    result = steadytip.run(path, motion=recording, out=tmp_path / "out", report=False)
    assert np.allclose(
        result.signals("hand.tip_?"), result.signals("hand.motion.recorded_?"), rtol=0, atol=1e-9
    )


def test_a_run_is_no_longer_than_its_recording_and_says_so(write_scenario, recording, tmp_path):
    path = write_scenario(MOVED, head="seconds = 30.0\nstep_size = 1e-3\n")
    said: list[str] = []
    result = steadytip.run(
        path, motion=recording, out=tmp_path / "out", report=False, status=said.append
    )
    assert "the run is 1.996 s long instead of 30 s: 'hand.motion' has no more" in said
    assert result.time[-1] == pytest.approx(1.995)


def test_a_recording_for_nobody_is_refused(write_scenario, recording, tmp_path):
    with pytest.raises(SteadytipError, match=r"needs one part with the inputs .* none of a has"):
        steadytip.run(write_scenario("[part.a]\nfmu = PROBE\n"), motion=recording)
