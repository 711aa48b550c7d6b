"""Parameter sets that `steadytip identify` writes from recordings made here."""

from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from scipy.spatial.transform import Rotation

from fmu_src.kit.runner import Runner
from plants import piezo_stack
from tests.change_indication.conftest import Check
from tests.command import steadytip

pytestmark = pytest.mark.slow


def _parameters(path: Path) -> dict[str, float]:
    """Return name and value of each parameter in an SSV file."""
    found = {}
    for element in etree.parse(path).iter("{*}Parameter"):
        found[element.get("name")] = float(element[0].get("value"))
    return found


def _write(path: Path, headings: list[str], columns: list[np.ndarray]) -> Path:
    header = ",".join(headings)
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=header, comments="")
    return path


@pytest.mark.parametrize(
    "operator", ["modulated-stops", "prandtl-ishlinskii", "rate-dependent", "creeping"]
)
def test_hysteresis(operator, tmp_path, unchanged: Check) -> None:
    volts_file, out = tmp_path / "volts.csv", tmp_path / "set.ssv"
    steadytip("identify", "excitation", volts_file, "-q")
    time, volts = np.loadtxt(volts_file, delimiter=",", skiprows=1, unpack=True)
    substeps = round((time[1] - time[0]) / piezo_stack.MODEL.sample_period)
    run = Runner(piezo_stack.MODEL).run(
        substeps * len(volts), {"volts": np.repeat(volts, substeps)}
    )
    stroke = run["stroke"][substeps - 1 :: substeps]
    stroke += np.random.default_rng(4).normal(0.0, 0.07e-6, len(volts))
    headings = ["time [s]", "volts [V]", "stroke [um]"]
    recording = _write(tmp_path / "stack.csv", headings, [time, volts, 1e6 * stroke])
    options = ("--operator", operator, "--out", out, "--no-report", "-q")
    steadytip("identify", "hysteresis", recording, *options)
    unchanged(f"identify/{operator}", _parameters(out), portable=False)


@pytest.mark.parametrize("form", ["physical", "linear"])
def test_imu(form, tmp_path, unchanged: Check) -> None:
    bench, out = tmp_path / "bench.csv", tmp_path / "set.ssv"
    grid = ("--grid", 45, "--dwell", 0.05, "--ambient", 15, "--ambient", 30)
    steadytip("identify", "turntable", bench, *grid, "-q")
    options = ("--linear",) if form == "linear" else ()
    steadytip("identify", "imu", bench, "--out", out, "--no-report", "-q", *options)
    unchanged(f"identify/imu-{form}", _parameters(out), portable=False)


def test_allan(tmp_path, unchanged: Check) -> None:
    rng = np.random.default_rng(5)
    time = np.arange(60_000) * 1e-3
    channels = ["a1x", "a1z", "a2y", "a2z", "a3x", "a3y"]
    columns = [
        2.5 + rng.normal(0.0, 2e-3, len(time)) + np.cumsum(rng.normal(0.0, 1e-6, len(time)))
        for _ in channels
    ]
    headings = ["time [s]", *(f"{name} [V]" for name in channels)]
    recording, out = _write(tmp_path / "still.csv", headings, [time, *columns]), tmp_path / "n.ssv"
    steadytip("identify", "allan", recording, "--out", out, "--no-report", "-q")
    unchanged("identify/allan", _parameters(out), portable=False)


def test_hand_eye(tmp_path, unchanged: Check) -> None:
    """A smooth turning about all axes, seen by a tracker every 25 ms and by a gyro 4 ms late."""
    rng = np.random.default_rng(6)
    n, period = 8000, 1e-3
    time = np.arange(n) * period
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    tones = np.array([0.7, 1.3, 2.1])
    rates = 0.6 * np.sin(2.0 * np.pi * tones * time[:, None, None] + phase).sum(axis=2)
    truth, attitude = [Rotation.from_euler("xyz", [50, -20, 30], degrees=True)], []
    for turn in Rotation.from_rotvec(rates * period):
        truth.append(truth[-1] * turn)
    attitude = Rotation.concatenate(truth[:-1])
    now, then = np.maximum(np.arange(n) - 4, 0), np.maximum(np.arange(n) // 25 * 25 - 25, 0)
    noise = Rotation.from_rotvec(np.radians(0.1) * rng.normal(size=(n, 3))[then])
    hand, frame = Rotation.from_rotvec([0.3, -0.5, 1.0]), Rotation.from_rotvec([0.2, 0.1, -0.8])
    coils = (frame.inv() * attitude[then] * hand * noise).as_quat()[:, [3, 0, 1, 2]]
    gyro = rates[now] + [0.01, -0.02, 0.005] + rng.normal(0.0, 5e-3, (n, 3))
    force = attitude.inv().apply([0.0, 0.0, 9.80131])
    field = attitude.inv().apply([2e-5, 0.0, -4e-5])
    fresh = (np.arange(n) % 25 == 0) & (np.arange(n) >= 25)
    headings = ["time"]
    headings += [f"{name}_{axis}" for name in ("rate", "force", "field") for axis in "xyz"]
    headings += [*(f"em_attitude_{axis}" for axis in "wxyz"), "em_new", "em_age"]
    columns = [time, gyro, force, field, coils, fresh, np.full(n, 25e-3)]
    recording, out = _write(tmp_path / "run.csv", headings, columns), tmp_path / "mounting.ssv"
    steadytip("identify", "hand-eye", recording, "--out", out, "-q")
    unchanged("identify/hand-eye", _parameters(out), portable=False)


def test_tremor_nn(tmp_path, unchanged: Check) -> None:
    rng = np.random.default_rng(7)
    time = np.arange(1500) * 4e-3
    axes = [
        0.05 * np.sin(2.0 * np.pi * (9.0 + 0.3 * k) * time + k) + 0.005 * rng.normal(size=1500)
        for k in range(3)
    ]
    headings = ["time [s]", "x [mm]", "y [mm]", "z [mm]"]
    recording, out = _write(tmp_path / "still.csv", headings, [time, *axes]), tmp_path / "nn.ssv"
    size = ("--inputs", 8, "--hidden", 1, "--epochs", 2)
    steadytip("identify", "tremor-nn", recording, *size, "--out", out, "-q")
    unchanged("identify/tremor-nn", _parameters(out), portable=False)
