"""Recordings of an actuator: what is read from which table, and what is refused how."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from fmu_src.errors import SteadytipError
from harness.recordings.stack import ROLES, check, read_response, turning_points
from harness.recordings.tables import ColumnMapping
from harness.reproduce.experiments.stack import respond

RATE = 1000.0
REVERSALS = 40
N = 3000


def _signals() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], voltage [V] and a stroke [m] with a loop: a lagging, bent copy of it."""
    time = np.arange(N) / RATE
    volts = 50 - 50 * (1 - 0.3 * time / time[-1]) * np.cos(2 * np.pi * 10 * time)
    behind = 50 - 50 * (1 - 0.3 * time / time[-1]) * np.cos(2 * np.pi * 10 * time - 0.3)
    noise = np.random.default_rng(1).normal(0, 20e-9, N)
    return time, volts, 0.15e-6 * behind * (1 - 1e-3 * behind) + noise


@pytest.fixture
def signals():
    return list(_signals())


@pytest.fixture
def write(tmp_path, signals):
    """Writes the signals as a table: heading, format of a row with t, v, z, and its separator."""

    def write(head="time [s],volts [V],stroke [um]", row="{t:.4f},{v:.5f},{z:.5f}", name="r.csv"):
        lines = [row.format(t=t, v=v, z=z * 1e6) for t, v, z in zip(*signals, strict=True)]
        path = tmp_path / name
        path.write_text("\n".join([*([head] if head else []), *lines]) + "\n", encoding="utf-8")
        return path

    return write


def _read(path, rate=None, gain=1.0, flip=False, late=0, **chosen):
    units = {name.removesuffix("_unit"): unit for name, unit in chosen.items() if "_unit" in name}
    columns = {role.name: chosen.get(role.name) for role in ROLES}
    return read_response(path, REVERSALS, ColumnMapping(columns, units, rate), gain, flip, late)


def _same(response, volts_at=1e-4, stroke_at=1e-10):
    time, volts, stroke = _signals()
    np.testing.assert_allclose(response.time, time, atol=1e-9)
    np.testing.assert_allclose(response.volts, volts, atol=volts_at)
    np.testing.assert_allclose(response.stroke, stroke, atol=stroke_at)
    assert response.period == pytest.approx(1 / RATE)


# What is read -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "row", "choice"),
    [
        ("time [s],volts [V],stroke [um]", "{t:.4f},{v:.5f},{z:.5f}", {}),
        ("Time (s)\tVoltage (V)\tDisplacement (µm)", "{t:.4f}\t{v:.5f}\t{z:.5f}", {}),
        ("t_s;u_V;pos_um", "{t:.4f};{v:.5f};{z:.5f}", {}),
        ("# bench 3\n# time [s]  drive [V]  stroke [um]", "{t:.4f}  {v:.5f}   {z:.5f}", {}),
        ("t;u;z\ns;V;um", "{t:.4f};{v:.5f};{z:.5f}", {}),
        ("stroke [um],note,volts [V],time [s]", "{z:.5f},up,{v:.5f},{t:.4f}", {}),
        ("", "{v:.5f} {z:.5f}", {"rate": RATE, "displacement_unit": "um"}),
        ("", "{z:.5f},{v:.5f}", {"rate": RATE, "displacement_unit": "um", "volts": "2"}),
        ("a,b,c", "{t:.4f},{v:.5f},{z:.5f}",
         {"time": "a", "volts": "B", "displacement": "3", "displacement_unit": "um"}),
    ],
)  # fmt: skip
def test_tables_of_many_kinds_are_read(write, head, row, choice):
    _same(_read(write(head, row), **choice))


def test_decimal_commas_are_understood(write):
    path = write("time [s];volts [V];stroke [um]", "{t:.4f};{v:.5f};{z:.5f}")
    path.write_text(path.read_text().replace(".", ","))
    _same(_read(path))


def test_units_are_taken_from_headings_or_options(write):
    head = "time [s],volts [mV],stroke [nm]"
    response = _read(write(head), volts_unit="V", displacement_unit="µm")
    _same(response)
    assert response.columns["displacement"] == "column 3 'stroke' in um"


def test_parquet_is_read_with_the_units_of_its_fields(tmp_path, signals):
    schema = pa.schema(
        [
            pa.field("time", pa.float64(), metadata={"unit": "s"}),
            pa.field("controller.volts_1", pa.float64(), metadata={"unit": "V"}),
            pa.field("piezo_1.stroke", pa.float64(), metadata={"unit": "m"}),
        ]
    )
    path = tmp_path / "results.parquet"
    parquet.write_table(pa.table(signals, schema=schema), path)
    _same(_read(path))
    _same(_read(path, volts="controller.volts_1", displacement="piezo_1.stroke"))


def test_gain_sign_and_delay_of_the_bench_can_be_told(write, signals):
    _, volts, stroke = signals
    signals[1], signals[2] = volts / 20, np.concatenate((stroke[:1], -stroke[:-1]))
    signals[2][0] = -stroke[0]
    response = _read(write(row="{t:.4f},{v:.7f},{z:.5f}"), gain=20.0, flip=True, late=1)
    np.testing.assert_allclose(response.volts, volts[:-1], atol=1e-4)
    np.testing.assert_allclose(response.stroke, stroke[:-1], atol=1e-10)
    assert response.time[0] == 0.0


def test_a_held_voltage_is_noted_but_not_refused(signals):
    """The stroke rests where the voltage does: an amplifier at its limit, or the plan."""
    time, volts, _ = signals
    volts = np.minimum(volts, 80.0)
    (note,) = check("r", time, volts, 0.15e-6 * volts, REVERSALS)
    assert "the voltage stays at its largest value, 80 V, for " in note


@pytest.mark.parametrize("frequency", [1.0, 10.0, 40.0])
@pytest.mark.parametrize("shape", ["sine", "triangle", "stairs", "steps", "held"])
def test_no_drive_of_a_stack_is_taken_for_a_broken_recording(shape, frequency):
    """Loops, creep, lag and ringing of the plant under voltages of every shape, with noise."""
    time = np.arange(round(45 / frequency * RATE)) / RATE
    turn = (time * frequency) % 1
    triangle = 1 - np.abs(2 * turn - 1)
    volts = {
        "sine": 45 - 45 * np.cos(2 * np.pi * turn),
        "triangle": 90 * triangle,
        "stairs": 10 * np.round(9 * triangle),
        "steps": 80.0 * (turn < 0.5),
        "held": np.clip(120 * triangle - 10, 0, 100),
    }[shape]
    stroke = respond(volts) + np.random.default_rng(6).normal(0, 0.07e-6, len(volts))
    notes = check("r", time, volts, stroke, REVERSALS)
    assert shape not in {"sine", "triangle"} or not notes


# What is refused ----------------------------------------------------------------------------------


def _refused(write, message, *arguments, **choice):
    with pytest.raises(SteadytipError, match=message):
        _read(write(*arguments), **choice)


def test_a_missing_file_a_folder_and_an_empty_one_are_refused(tmp_path):
    with pytest.raises(SteadytipError, match="does not exist"):
        _read(tmp_path / "none.csv")
    with pytest.raises(SteadytipError, match="is a folder; name a file in it"):
        _read(tmp_path)
    (tmp_path / "empty.csv").write_text("\n")
    with pytest.raises(SteadytipError, match=r"empty\.csv is empty"):
        _read(tmp_path / "empty.csv")
    (tmp_path / "binary.csv").write_bytes(b"MATLAB\0\0\1")
    with pytest.raises(SteadytipError, match="not a text table; save it as CSV"):
        _read(tmp_path / "binary.csv")


def test_a_table_without_numbers_is_refused(tmp_path):
    path = tmp_path / "words.csv"
    path.write_text("a,b\nc,d\n" * 10)
    with pytest.raises(SteadytipError, match=r"no numeric columns .*line 1: 'a,b'"):
        _read(path)


@pytest.mark.parametrize(
    ("replacement", "message"),
    [
        ("", r"line 102, column 3 \('stroke'\): nothing stands there"),
        ("bad", r"line 102, column 3 \('stroke'\): 'bad' is not a number"),
    ],
)
def test_holes_are_refused_with_their_place(write, replacement, message):
    path = write()
    lines = path.read_text().splitlines()
    lines[101] = lines[101].rpartition(",")[0] + "," + replacement
    path.write_text("\n".join(lines))
    with pytest.raises(SteadytipError, match=message):
        _read(path)


def test_a_ragged_row_is_refused_with_its_line(write):
    path = write()
    lines = path.read_text().splitlines()
    lines[50] += ",1"
    path.write_text("\n".join(lines))
    with pytest.raises(SteadytipError, match="line 51: 4 columns instead of 3"):
        _read(path)


def test_an_unknown_column_names_the_nearest(write):
    _refused(write, "--volts volt is no column; did you mean 'volts'", volts="volt")
    _refused(write, r"--displacement 4 is no column.*column 3 'stroke'", displacement="4")
    _refused(write, "cannot be volts and displacement", displacement="volts", volts="2")


def test_columns_that_nothing_tells_are_asked_for(write):
    _refused(write, "no column is called like volts; choose it with --volts", "a,b,c")
    _refused(write, "no column that is called time; give --rate HZ", "", "{v} {z}",
             displacement_unit="um")  # fmt: skip
    _refused(write, "does not say its unit; give --displacement-unit", "time,volts,stroke")
    _refused(write, "is in 'bananas'; give --displacement-unit", "time,volts,stroke [bananas]")


def test_columns_that_are_called_alike_are_asked_for(write):
    _refused(
        write,
        "2 columns are called like volts; choose one with --volts "
        r"\(there are: column 2 'volts_1', column 3 'volts_2'\)",
        "time,volts_1,volts_2",
    )


def test_a_time_taken_for_the_voltage_is_noticed(write):
    _refused(write, "rises evenly from row to row, as a time does", "", "{t} {v} {z}",
             rate=RATE, displacement_unit="um")  # fmt: skip


def test_a_rate_that_is_none_is_refused(write):
    _refused(write, "--rate -5: must be above 0", rate=-5.0)
    _refused(write, "--time and --rate exclude each other", rate=5.0, time="time")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(("column", "name"), [(1, "voltage"), (2, "displacement")])
def test_values_that_are_not_finite_are_refused(write, signals, column, name, value):
    signals[column][[70, 90]] = value
    _refused(write, rf"{name} is {value} \w+ in line 72 and 1 more; cut the recording there")


def test_too_few_samples_are_refused(signals):
    with pytest.raises(SteadytipError, match="499 samples; at least 500 are needed"):
        check("r", *(column[:499] for column in signals), REVERSALS)


def test_time_that_goes_back_is_refused(write, signals):
    signals[0][1000:] -= 0.5
    _refused(write, r"time goes back from 0.999 s to 0.5 s in line 1002; sort the rows")


def test_a_time_that_stands_twice_is_refused(write, signals):
    signals[0][[200, 300]] = signals[0][[199, 299]]
    _refused(write, r"the time 0.199 s stands twice, again in line 202, and once more")


def test_missing_samples_are_refused_with_the_longest_gap(write, signals):
    keep = np.ones(N, dtype=bool)
    keep[500:520] = keep[900:902] = False
    signals[:] = [column[keep] for column in signals]
    _refused(
        write,
        r"samples are missing at 0.499 s, line 502: a gap of 0.021 s where the period is 0.001 s, "
        r"and once more, the longest 0.021 s",
    )


def test_uneven_sampling_is_refused(write, signals):
    signals[0] = signals[0] + 0.4e-3 * np.arange(N) ** 2 / N**1.5
    _refused(write, "samples are not evenly spaced: .* periods; resample the recording")


def test_time_with_few_digits_is_even_enough(signals):
    """A clock that is rounded to 0.25 ms at 1 kHz, as one of 4 kHz is."""
    time = np.round((signals[0] + 0.1e-3) * 4000) / 4000
    check("r", time, *signals[1:], REVERSALS)


def test_a_constant_voltage_and_a_constant_stroke_are_refused(signals):
    time, volts, stroke = signals
    with pytest.raises(SteadytipError, match="voltage is 5 V all the time; choose its column"):
        check("r", time, np.full(N, 5.0), stroke, REVERSALS)
    with pytest.raises(SteadytipError, match="displacement is 0 m all the time"):
        check("r", time, volts, np.zeros(N), REVERSALS)


def test_a_displacement_in_another_unit_is_suspected(write):
    _refused(
        write,
        r"the displacement covers 13.* m, which should be 2e-08 to 0.002 m; is it in another unit\?"
        r" Give --displacement-unit m\|cm\|mm\|um\|nm",
        displacement_unit="m",
    )


def test_a_voltage_in_another_unit_is_suspected(write):
    _refused(write, r"the voltage covers 9.*e\+04 V.*Give --volts-unit", volts_unit="kV")


def test_a_stroke_of_the_wrong_sign_is_refused(write, signals):
    signals[2] = -signals[2]
    _refused(write, r"falls while the voltage rises \(correlation -0.9\d\).*give --flip")


def test_columns_that_do_not_belong_together_are_refused(signals):
    time, volts, _ = signals
    other = 5e-6 * np.sin(2 * np.pi * 3 * time)
    with pytest.raises(SteadytipError, match="hardly move together"):
        check("r", time, volts, other, REVERSALS)


def test_too_few_reversals_are_refused_and_noise_is_none(signals):
    """A slow sine with noise turns at every sample, but not by enough to count."""
    time, _, _ = signals
    volts = 50 - 50 * np.cos(2 * np.pi * 2 * time)
    noisy = volts + np.random.default_rng(2).normal(0, 0.1, N)
    with pytest.raises(SteadytipError, match=r"the voltage turns 11 times .* must 40 times"):
        check("r", time, noisy, 0.15e-6 * volts, REVERSALS)


@pytest.mark.parametrize("side", ["largest", "smallest"])
def test_a_clipped_displacement_is_refused_with_first_time_and_share(write, signals, side):
    sign = 1 if side == "largest" else -1
    low, high = np.quantile(signals[2], [0.1, 0.9])
    signals[2] = np.minimum(signals[2], high) if sign > 0 else np.maximum(signals[2], low)
    first = np.flatnonzero(signals[2] == (high if sign > 0 else low))[0]
    time = f"{signals[0][first]:.6g}"
    with pytest.raises(SteadytipError) as caught:
        _read(write())
    text = str(caught.value)
    assert f"the displacement is clipped: it stays at its {side} value" in text
    assert f"while the voltage moves on; first at {time} s, line {first + 2}, " in text
    share = float(text.split(f"line {first + 2}, ")[1].split(" %")[0])
    assert share == pytest.approx(10, abs=1.5)


def test_a_clipped_voltage_is_refused(write, signals):
    """The actuator goes on where the recorded voltage stays: it is not what drives it."""
    time = signals[0]
    slow = 50 - 50 * np.cos(2 * np.pi * 10 * time)
    signals[1], signals[2] = np.minimum(slow, 70.0), 0.15e-6 * slow
    _refused(
        write,
        "the voltage is clipped: it stays at its largest value, 70 V, while the displacement",
    )


def test_everything_wrong_is_said_at_once(write, signals):
    signals[0][600] = signals[0][599]
    signals[2] = np.minimum(-signals[2], np.quantile(-signals[2], 0.9))
    with pytest.raises(SteadytipError) as caught:
        _read(write())
    for words in ("stands twice", "falls while the voltage rises"):
        assert words in str(caught.value)


def test_turning_points_are_those_of_a_known_walk():
    walk = np.concatenate([np.linspace(a, b, 20) for a, b in ((0, 5), (5, 2), (2, 9), (9, 8.9))])
    turns = turning_points(walk, 0.5)
    np.testing.assert_allclose(walk[turns], [0, 5, 2, 9 - 0.1])
