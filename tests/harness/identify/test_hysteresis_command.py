"""`steadytip identify hysteresis`: from a recording to a parameter set that a run accepts."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from fmu_src.kit.runner import Runner
from fmu_src.pack.discovery import load_model
from fmu_src.piezo.prandtl_ishlinskii import MODEL, Hysteresis
from harness.cli.main import main
from harness.identify.hysteresis.evaluation import HysteresisEvaluation, evaluate
from harness.identify.hysteresis.operators import OPERATORS, OperatorFit
from harness.identify.hysteresis.page import band_table
from harness.identify.hysteresis.parameter_files import find_prefixes, write_operators
from harness.identify.hysteresis.plays import excitation
from harness.parts.ssv import read_ssv
from harness.recordings.quality import select_samples
from harness.recordings.stack import StackResponse, read_response
from tests.harness.identify.commands import plant_response, write_csv

RATE = 1000.0
WEIGHTS = np.linspace(0.5, 0.05, 10)
NOISE = 0.07e-6
HEADINGS = ["time [s]", "volts [V]", "stroke [um]"]


PLAIN = ("--operator", "prandtl-ishlinskii")


def _write(path: Path, volts: np.ndarray, stroke: np.ndarray) -> Path:
    time = np.arange(len(volts)) / RATE
    table = np.column_stack((time, volts, stroke * 1e6))
    return write_csv(path, table, HEADINGS, ["%.3f", "%.5f", "%.5f"])


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A known operator with sensor noise, offset and drift, as a bench would record it."""
    volts = excitation(RATE)
    stroke = Runner(MODEL, {"weights": WEIGHTS}).run(len(volts), {"volts": volts})["stroke"]
    noise = np.random.default_rng(3).normal(0, NOISE, len(volts))
    drift = 2e-6 + 0.03e-6 * np.arange(len(volts)) / RATE
    return _write(tmp_path_factory.mktemp("bench") / "stack_b.csv", volts, stroke + noise + drift)


@pytest.fixture(scope="module")
def stack_recording(tmp_path_factory) -> Path:
    """The plant, which is no operator of any kind that is fitted."""
    volts = excitation(RATE)
    noise = np.random.default_rng(4).normal(0, NOISE, len(volts))
    path = tmp_path_factory.mktemp("bench") / "plant.csv"
    return _write(path, volts, plant_response(volts, RATE) + noise)


def test_a_known_operator_comes_back_as_a_parameter_set(recording, tmp_path, identify):
    out = tmp_path / "sets" / "b.ssv"
    shown = identify.accepts("hysteresis", recording, *PLAIN, "--out", out)
    values = read_ssv(out)
    found = [values[f"weights[{i}]"].value for i in range(1, 11)]
    np.testing.assert_allclose(found, WEIGHTS, atol=0.05)
    assert values["thresholds[2]"].unit == "V"
    assert values["saturation[1]"].unit == "m/V"
    assert f"parameters: {out}" in shown
    assert "10000 samples in 9.999 s" in shown
    for part in ("fit", "validation"):
        rms = float(re.search(rf"{part} [\d.]+ ([\d.]+)", shown)[1])
        assert rms == pytest.approx(NOISE * 1e6, rel=0.05)
    assert out.with_suffix(".html").is_file()


def test_a_run_accepts_the_set(recording, tmp_path, identify):
    """Through an FMU in a scenario, as `--set part.NAME.parameters=FILE` gives it."""
    import steadytip as st

    out = tmp_path / "b.ssv"
    options = [*PLAIN, "--out", out, "--no-report", "-q"]
    assert identify.accepts("hysteresis", recording, *options) == ""
    scenario = tmp_path / "one.toml"
    scenario.write_text(
        'seconds = 0.1\nstep_size = 1e-3\n[part.stack]\nfmu = "PrandtlIshlinskii"\n'
    )
    result = st.run(
        scenario,
        overrides={"part.stack.parameters": str(out)},
        out=tmp_path / "out",
        report=False,
    )
    used = result.metadata.parts["stack"]["start_values"]
    assert used["weights[1]"] == read_ssv(out)["weights[1]"].value
    assert len(used) == Hysteresis.size()


@pytest.mark.parametrize(
    ("operator", "model"),
    [
        ("prandtl-ishlinskii", "PrandtlIshlinskii"),
        ("prandtl-ishlinskii", "InversePrandtlIshlinskii"),
        ("prandtl-ishlinskii", "TremorCanceller"),
        ("rate-dependent", "RatePrandtlIshlinskii"),
        ("rate-dependent", "TremorCanceller"),
        ("creeping", "CreepPrandtlIshlinskii"),
        ("creeping", "InverseCreepPrandtlIshlinskii"),
        ("modulated-stops", "ModulatedStops"),
        ("modulated-stops", "InverseModulatedStops"),
        ("modulated-stops", "TremorCanceller"),
    ],
)
def test_sets_fit_the_models_that_they_are_for(
    stack_recording, tmp_path, identify, operator, model
):
    """Every name is one of the model's parameters, in its unit and range."""
    out = tmp_path / "set.ssv"
    options = ["--operator", operator, "--model", model, "--out", out, "--no-report", "-q"]
    assert identify.accepts("hysteresis", stack_recording, *options) == ""
    known = {scalar.name: scalar.field for scalar in load_model(model).variables["parameter"]}
    values = read_ssv(out)
    assert values.keys() <= known.keys()
    record = OPERATORS[operator].record
    assert len(values) == record.size() * len(find_prefixes(model, record))
    for name, entry in values.items():
        assert entry.unit == known[name].unit
        assert known[name].min <= entry.value <= known[name].max


def test_three_recordings_are_three_stacks(recording, stack_recording, tmp_path, identify):
    out = tmp_path / "set.ssv"
    files = (recording, stack_recording, recording)
    options = [*PLAIN, "--model", "TremorCanceller", "--out", out, "--no-report"]
    shown = identify.accepts("hysteresis", *files, *options)
    assert shown.count("stack_b.csv:") == 2
    first, second, third = (
        [read_ssv(out)[f"stack_{k}.weights[{i}]"].value for i in range(1, 11)] for k in (1, 2, 3)
    )
    assert first == third
    assert first != second
    err = identify.refuses("hysteresis", *files[:2], *options)
    assert "2 recordings for TremorCanceller, which takes 3 (stack_1, stack_2, stack_3)" in err


def test_the_richer_operator_leaves_the_sensor_noise_of_the_plant(
    stack_recording, tmp_path, identify
):
    options = ["--out", tmp_path / "s.ssv", "--no-report"]
    shown = identify.accepts("hysteresis", stack_recording, *options)
    assert float(re.search(r"validation [\d.]+ ([\d.]+)", shown)[1]) < 1.15 * NOISE * 1e6


def test_the_page_stands_alone_and_shows_what_there_is(recording, tmp_path, identify):
    out = tmp_path / "b.ssv"
    identify("hysteresis", recording, "--out", out, "-q")
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    page = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    for title in ("Loops", "Residual", "Spectrum of the residual", "Loading curve"):
        assert f"<h3>{title}</h3>" in page
    assert "8 to 12" in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#|data:)", page)


def test_a_real_actuator_is_identified(data_dir, tmp_path, identify):
    """A flexure at 1 Hz, 45 um: a straight line leaves 7.4 % of p-p of cycles not fitted."""
    path = data_dir / "piezo_flexure" / "Model_Vi_Do.dat"
    options = ["--volts", "1", "--displacement", "5", "--displacement-unit", "um", "--rate", "200"]
    options += ["--out", tmp_path / "f.ssv", "--no-report"]
    shown = identify.accepts("hysteresis", path, *options)
    percent = float(re.search(r"validation [\d.]+ [\d.]+ ([\d.]+)", shown)[1])
    assert percent < 0.25


def test_an_operator_that_does_not_suit_is_refused_with_a_cure(data_dir, tmp_path, identify):
    """Its thresholds reach to 45 V, the voltage of this recording, ahead of an amplifier, to 4."""
    path = data_dir / "piezo_flexure" / "Model_Vi_Do.dat"
    options = ["--volts", "1", "--displacement", "5", "--displacement-unit", "um", "--rate", "200"]
    out = tmp_path / "f.ssv"
    # The flexure is behind its voltage, which an operator without rate does not describe.
    err = identify.refuses("hysteresis", path, *options, *PLAIN, "--out", out)
    assert "lag: the displacement is 7 rows (35 ms) behind the voltage" in err
    accepted = [*options, *PLAIN, "--accept", "lag", "--out", out]
    err = identify.refuses("hysteresis", path, *accepted)
    assert "does not suit the operator (is its voltage that ahead of an amplifier? give" in err
    assert not out.exists()


def test_mistakes_end_with_2_and_no_traceback(recording, tmp_path, identify):
    for options, message in (
        (["--operator", "prandtl-ishlinski"], "name; did you mean 'prandtl-ishlinskii'?"),
        (["--model", "Hand"], "--model Hand: takes no parameters of this operator; those that do"),
        (["--model", "Hnd"], "no model 'Hnd'; the nearest is 'Hand'"),
        (["--fit", "half"], "--fit half: write START:END in seconds"),
        (["--fit", "0:0.05"], "--fit 0:0.05: holds 51 of the 10000 samples"),
        (["--fit", "120%"], "--fit 120%: a share must be in (0, 1]"),
        (["--fit", "0:2"], "0 to 2 s: the voltage turns 39 times and must 40 times at least"),
        (["--gain", "-1"], "--gain -1: must be above 0; for a sign there is --flip"),
        (["--flip"], "falls while the voltage rises"),
        (["--out", tmp_path / "x.csv"], "a parameter set ends in .ssv"),
    ):
        assert message in identify.refuses("hysteresis", recording, *options)


@pytest.mark.parametrize(
    ("text", "first", "last"),
    [("75%", 0, 7499), ("0.5", 0, 4999), ("1:3", 1000, 3000), (":2", 0, 2000), ("8:", 8000, 9999)],
)
def test_the_fitted_part_is_chosen_by_seconds_or_share(recording, text, first, last):
    response = read_response(recording, 40)
    part = np.flatnonzero(select_samples(text, recording, response.time))
    assert (part[0], part[-1]) == (first, last)
    assert len(part) == last - first + 1


def test_sensor_drift_is_found_and_left_out(recording):
    response = read_response(recording, 40)
    operator = OPERATORS["prandtl-ishlinskii"]
    done = evaluate(
        response,
        operator,
        select_samples("75%", recording, response.time),
        lambda done, count: None,
    )
    assert done.drift == pytest.approx(0.03e-6, rel=0.1)
    assert np.std(done.residual) < 1.05 * NOISE


def test_bands_hold_the_power_of_a_tone_where_it_is():
    time = np.arange(10_000) / RATE
    tone = 2e-6 * np.sin(2 * np.pi * 10 * time)
    response = StackResponse(Path("x"), {}, time, tone * 1e6, tone, 1 / RATE)
    fit = OperatorFit({}, lambda volts: 0.5e-6 * volts, "half of it")
    everything = np.ones(len(time), dtype=bool)
    half = HysteresisEvaluation(
        response, OPERATORS["prandtl-ishlinskii"], fit, everything, everything,
        0.5 * tone, 0.0,
    )  # fmt: skip
    rows = {row[0]: row[1:] for row in band_table(half).rows}
    stroke, residual = map(float, rows["8 to 12"])
    assert stroke == pytest.approx(2 / np.sqrt(2), rel=0.02)
    assert residual == pytest.approx(1 / np.sqrt(2), rel=0.02)
    assert all(float(value) < 0.01 for name, row in rows.items() for value in row
               if name != "8 to 12")  # fmt: skip


def test_help_lists_the_commands(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["steadytip", "identify", "--help"])
    with pytest.raises(SystemExit):
        main()
    assert "hysteresis" in capsys.readouterr().out


def test_values_out_of_range_are_not_written(tmp_path):
    values = {name: np.array(field.start) for name, field in Hysteresis.fields.items()}
    values["weights"] = np.full(10, 11.0)
    fit = OperatorFit(values, lambda volts: volts, "")
    with pytest.raises(SteadytipError, match=r"10 problems\n  - weights\[1\] = 11  must be in"):
        write_operators(tmp_path / "x.ssv", Hysteresis, {"": fit})
    assert not (tmp_path / "x.ssv").exists()


# The excitation -----------------------------------------------------------------------------------


@pytest.mark.parametrize("operator", list(OPERATORS))
def test_what_is_written_is_what_a_recording_needs(operator, tmp_path, identify):
    """With a stroke beside it, the table is one that the operator can be identified from."""
    out = tmp_path / "new" / "volts.csv"
    shown = identify.accepts(
        "excitation", out, "--operator", operator, "--top", "60", "--rate", "500"
    )
    assert f"{out}: " in shown
    time, volts = np.loadtxt(out, delimiter=",", skiprows=1).T
    assert volts.min() == 0.0
    assert volts[0] == 0.0
    assert volts.max() == pytest.approx(60.0, rel=0.005)
    np.testing.assert_allclose(np.diff(time), 2e-3, atol=1e-6)
    table = np.column_stack((time, volts, 0.15 * volts))
    recording = write_csv(tmp_path / "recording.csv", table, HEADINGS, "%.6f")
    assert len(read_response(recording, 40).time) == len(volts)


def test_an_excitation_that_cannot_be_is_refused(tmp_path, identify):
    out = tmp_path / "v.csv"
    for options, message in (
        (["--operator", "stops"], "--operator stops: there is none of that name"),
        (["--top", "-5"], "--top -5: must be above 0 and at most 1000 V"),
        (["--rate", "20"], "--rate 20: must be in [200, 100000] Hz"),
    ):
        assert message in identify.refuses("excitation", out, *options)
        assert not out.exists()


def _lagging(path: Path, rows: int, offset: float = 0.0) -> Path:
    """Write a known operator at rest first, with its displacement some rows late."""
    volts = np.concatenate([np.zeros(50), excitation(RATE)])
    stroke = Runner(MODEL, {"weights": WEIGHTS}).run(len(volts), {"volts": volts})["stroke"]
    late = np.concatenate([np.full(rows, stroke[0]), stroke])[: len(volts)]
    return _write(
        path, volts, late + offset + np.random.default_rng(3).normal(0, NOISE, len(volts))
    )


@pytest.mark.parametrize("rows", [1, 8])
def test_a_displacement_that_lags_is_named_with_its_rows_and_no_set_is_written(
    identify, tmp_path, rows
):
    path = _lagging(tmp_path / "lag.csv", rows)
    out = tmp_path / "lag.ssv"
    err = identify.refuses("hysteresis", path, *PLAIN, "--out", out)
    assert f"lag: the displacement is {rows} row" in err
    assert f"--late {rows}" in err
    assert not out.exists()
    assert out.with_suffix(".html").exists()
    identify.accepts("hysteresis", path, *PLAIN, "--late", rows, "--out", out)
    assert out.exists()


def test_an_offset_at_rest_is_taken_off_and_said(identify, tmp_path):
    plain, moved = tmp_path / "plain.ssv", tmp_path / "moved.ssv"
    identify.accepts("hysteresis", _lagging(tmp_path / "a.csv", 0), *PLAIN, "--out", plain)
    path = _lagging(tmp_path / "b.csv", 0, 1e-5)
    said = identify.accepts("hysteresis", path, *PLAIN, "--out", moved)
    assert "um at rest at 0 V: that is taken off" in said
    a, b = ({k: v.value for k, v in read_ssv(path).items()} for path in (plain, moved))
    assert a.keys() == b.keys()
    np.testing.assert_allclose(list(a.values()), list(b.values()), rtol=1e-2, atol=1e-3)
