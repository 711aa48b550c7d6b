"""The delay budget, on loops whose answer is known in closed form, and on the shipped one."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, real
from fmu_src.pack.codegen.c_source import sources
from fmu_src.pack.compiler import host
from fmu_src.pack.fmu import archive, native
from fmu_src.pack.fmu.description import content_guid
from harness.analyze import analysis as analysis_module
from harness.analyze import operating_point as operating
from harness.analyze.analysis import analyze
from harness.analyze.delay_budget import BAND, band, delay_budget, left_of, margins
from harness.analyze.linear import OpenedLoop, attenuation, frd, modified
from harness.analyze.multisine import FREQUENCIES, OMEGA, lines_of, multisine, random_phases
from harness.analyze.operating_point import duration
from harness.common.errors import ProblemsError
from harness.scenario.load import load
from tests.harness.cli.test_cli import call
from tests.harness.conftest import PackProbe

pytestmark = pytest.mark.xdist_group("analyze")  # its tests share what takes long

STEP = 4e-3


class Nothing(Parameters):
    """No parameters."""


class Recorded(Inputs):
    """What moves a hand, and what corrects its tip."""

    recorded = boolean("whether there is a recording")
    recorded_x = real("m", "x")
    recorded_y = real("m", "y")
    recorded_z = real("m", "z")
    recorded_velocity = real("m/s", "velocity", shape=3, axes="xyz")
    recorded_acceleration = real("m/s2", "acceleration", shape=3, axes="xyz")
    correction = real("m", "of the tip", shape=3, axes="xyz")


class Share(Parameters):
    """How much of the correction is felt."""

    share = real(None, "of the correction that is sensed", start=0.0)


class Places(Outputs):
    """Where the tip is."""

    moved = real("m", "tip without correction", shape=3, axes="xyz")
    tip = real("m", "tip", shape=3, axes="xyz")
    sensed = real("m", "what a sensor on the handle feels", shape=3, axes="xyz")


class NoState(State):
    """Nothing."""


def frame(p: Share, u: Recorded, x: NoState, T: float) -> tuple[NoState, Places]:
    import casadi as ca

    moved = ca.vertcat(u.recorded_x, u.recorded_y, u.recorded_z)
    sensed = moved + p.share * u.correction
    return x, Places(moved=moved, tip=moved + u.correction, sensed=sensed)


@pytest.fixture(scope="session")
def body(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hand whose tip takes a correction."""
    folder = tmp_path_factory.mktemp("synthetic")
    model = Model("Frame", frame, Share, Recorded, NoState, Places, sample_period=STEP)
    guid = content_guid(model, sources(model, ""))
    path = folder / "Frame.fmu"
    archive.write(path, native.files(model, guid, [host()]))
    return path


ROLES = """
[signals]
tip_uncompensated = "frame.moved_*"
tip   = "frame.tip_*"
actuator_voltage = "gain_*.y"
"""
SENSE = "".join(f'[[wire]]\nfrom = "frame.sensed_{axis}"\nto = "gain_{axis}.u"\n' for axis in "xyz")
Write = Callable[..., Path]


@pytest.fixture
def write(body: Path, probe: Path, tmp_path: Path) -> Write:
    """Writes a scenario of a frame, and somebody else's FMUs as gains along each axis."""

    def scenario(
        gain: float = 0.9,
        delay: int = 1,
        share: float = 0.0,
        roles: str = ROLES,
        sense: str = SENSE,
        gain_fmu: Path = probe,
    ) -> Path:
        path = tmp_path / "case.toml"
        text = (
            f'seconds = 2.0\nstep_size = {STEP}\n[part.frame]\nfmu = "{body.as_posix()}"\n'
            f"share = {share}\n"
        )
        for axis in "xyz":
            text += f'[part.gain_{axis}]\nfmu = "{gain_fmu.as_posix()}"\ngain = {-gain}\n'
        text += sense
        for axis in "xyz":
            text += f'[[wire]]\nfrom = "gain_{axis}.y"\nto = "frame.correction_{axis}"\n'
            text += f"delay = {delay}\n"
        path.write_text(text + roles)
        return path

    return scenario


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One realisation and little learning: what these loops need."""
    monkeypatch.setattr(operating, "REALISATIONS", 1)
    monkeypatch.setattr(operating, "RUNS", 7)
    monkeypatch.setattr(operating, "LEARNING", 1.5)


def bears(gain: float, delay: float, wanted: float) -> float:
    """Further delay at which wanted is left at the upper edge of the band [s]."""
    return math.acos((1 + gain**2 - wanted**2) / (2 * gain)) / (2 * np.pi * BAND[1]) - delay


def scalar(gain: float, delay: float) -> OpenedLoop:
    one = np.broadcast_to(np.eye(3), (len(OMEGA), 3, 3)).astype(complex)
    command = -gain * np.exp(-1j * OMEGA * delay)[:, None, None] * one
    return OpenedLoop(frd(one), frd(one), frd(command), frd(0 * one), frd(one))


def test_a_multisine_is_read_back_and_a_slow_transient_is_not_seen():
    lines = np.linspace(1.0, 0.2, len(FREQUENCIES)) * np.exp(1j * random_phases(3, 1))
    time = np.arange(2500) * STEP
    found = lines_of(time, multisine(time, 0.0, lines)[:, None] + np.exp(-time / 2.0)[:, None])
    assert np.abs(found[:, 0] - lines)[FREQUENCIES >= 2.0].max() < 1e-3


@settings(max_examples=4)
@given(
    gain=st.floats(0.75, 1.2),
    delay=st.floats(0.0, 3e-3),
    wanted=st.floats(0.45, 0.8),
)
def test_the_delay_that_is_borne_is_that_of_the_closed_formula(gain, delay, wanted):
    """Expected Result: |1 - g exp(-i w T)| = a at 12 Hz, where it is largest in the band."""
    loop = scalar(gain, delay)
    assert np.allclose(
        left_of(attenuation(loop)), np.abs(1 - gain * np.exp(-1j * OMEGA * delay)), atol=1e-12
    )
    found = delay_budget(loop, wanted)
    expected = bears(gain, delay, wanted)
    if expected > 0:
        assert found.spare_everywhere == pytest.approx(expected, abs=1e-6)
        at_it = attenuation(modified(loop, found.spare_everywhere))
        assert band(left_of(at_it)).max() == pytest.approx(wanted, abs=1e-5)
    assert found.best == pytest.approx(-delay, abs=2e-5)
    if found.spare is not None and found.spare_everywhere is not None:
        assert found.spare >= found.spare_everywhere


def test_what_is_not_met_as_it_is_bears_no_delay():
    found = delay_budget(scalar(0.3, 1e-3), 0.5)
    assert found.spare is None
    assert found.spare_everywhere is None


def test_margins_of_a_feedback_loop_are_those_of_the_closed_formula():
    """L = -g exp(-i w T): the phase reaches a half turn more where w T is pi."""
    delay, gain = 20e-3, 2.0
    one = np.eye(3)[None, :, :]
    returned = (
        -gain
        * np.exp(-1j * OMEGA * delay)[:, None, None]
        * one
        / (1 + 1j * OMEGA / 60)[:, None, None]
    )
    measured = np.broadcast_to(one, returned.shape).astype(complex)
    found = margins(
        OpenedLoop(frd(measured), frd(measured), frd(measured), frd(returned), frd(measured))
    )
    crossover = 60 * math.sqrt(gain**2 - 1)
    phase = math.pi - crossover * delay - math.atan(crossover / 60)
    assert found.phase == pytest.approx(phase % (2 * math.pi), abs=0.02)
    assert found.delay == pytest.approx((phase % (2 * math.pi)) / crossover, rel=0.05)


@pytest.mark.parametrize("delay", [1, 10])
def test_a_gain_and_a_delay_from_the_fmus(write, quick, delay):
    """Expected Result: A = 1 - g exp(-i w d T); all phase is the wire's, longer than a half turn
    at d = 10, T = 4 ms and 20 Hz."""
    found = analyze(write(gain=0.9, delay=delay), wanted=0.7)
    late = delay * STEP
    expected = 1 - 0.9 * np.exp(-1j * OMEGA * late)
    for response in (found.measured, found.from_parts):
        assert np.abs(response - expected[:, None, None] * np.eye(3)).max() < 1e-6
    assert [stage.wire for stage in found.stages] == [False, False, True, False]
    (wire,) = (stage for stage in found.stages if stage.wire)
    assert np.allclose(wire.delay, late, atol=1e-7)
    for stage in found.stages:
        if not stage.wire:
            assert np.abs(stage.phase).max() < 1e-6
    assert not found.loop.feedback
    assert found.margins is None
    assert found.fitted == ()
    assert not found.doubtful.any()
    if delay == 1:
        assert found.budget.spare_everywhere == pytest.approx(bears(0.9, late, 0.7), abs=1e-5)
    else:
        assert found.budget.spare_everywhere is None


def test_feedback_is_seen_in_the_wiring_and_closed(write, quick):
    """A sensor that feels half of the correction. Expected Result: A = 1 - g D / (1 + s g D)."""
    found = analyze(write(gain=0.9, delay=2, share=0.5))
    late = np.exp(-1j * OMEGA * 2 * STEP)
    expected = 1 - 0.9 * late / (1 + 0.45 * late)
    for response in (found.measured, found.from_parts):
        assert np.abs(response - expected[:, None, None] * np.eye(3)).max() < 1e-4
    assert found.loop.feedback
    assert found.margins.modulus == pytest.approx(np.abs(1 + 0.45 * late).min(), abs=1e-4)
    assert any(note.startswith("feedback") for note in found.notes)


def test_an_fmu_that_cannot_save_its_state_gives_the_same(write, quick, pack_probe: PackProbe):
    path = pack_probe(('canGetAndSetFMUstate="true" canSerializeFMUstate="true"', ""))
    plain, replayed = analyze(write()), analyze(write(gain_fmu=path))
    assert np.abs(plain.from_parts - replayed.from_parts).max() < 1e-12
    assert any("gain_x, gain_y, gain_z cannot save" in note for note in replayed.notes)


def test_the_command_writes_table_page_and_json(write, quick, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ("analyze", str(write()), "--attenuation", "0.7", "--json", "out/numbers.json")
    code, out, err = call(monkeypatch, capsys, *arguments)
    assert (code, err) == (0, "")
    assert "What each part costs" in out
    assert "→ frame, 1 sample -11.5 4.00 -14.4 4.00 -17.3 4.00 wire" in out
    assert "feed-forward" in out
    page = (tmp_path / "build/analyze/case/delay_budget.html").read_text("utf-8")
    for title in ("What is left of a motion", "What each part costs", "What delay it bears"):
        assert title in page
    entries = json.loads((tmp_path / "out/numbers.json").read_text("utf-8"))
    keys = {"source", "quantity", "unit", "paper", "measured", "setting"}
    assert all(set(entry) == keys and math.isfinite(entry["measured"]) for entry in entries)
    numbers = {entry["quantity"]: entry["measured"] for entry in entries}
    left = abs(1 - 0.9 * np.exp(-2j * np.pi * 10 * STEP))
    assert numbers["tip motion by hand motion at 10 Hz, whole loop"] == pytest.approx(left)
    assert numbers["delay of the wire to frame, 1 sample at 8 Hz"] == pytest.approx(4.0)
    everywhere = "largest further delay with 0.7 left everywhere from 8 to 12 Hz"
    assert numbers[everywhere] == pytest.approx(1e3 * bears(0.9, STEP, 0.7), abs=1e-3)


@pytest.mark.parametrize("wanted", [0.0, 1.0, 1.5, -0.1, math.nan])
def test_a_share_that_is_none_is_refused_with_its_range(wanted):
    with pytest.raises(SteadytipError, match=r"--attenuation .* is between 0 and 1, as in"):
        analyze("closed_loop", wanted=wanted)


def test_an_unknown_scenario_is_refused_with_the_nearest(monkeypatch, capsys):
    code, _, err = call(monkeypatch, capsys, "analyze", "closed_lop")
    assert code == 2
    assert "did you mean 'closed_loop'?" in err


def test_missing_roles_are_named_all_at_once(write):
    with pytest.raises(ProblemsError) as caught:
        analyze(write(roles=""))
    assert [
        f"signals.{role}" in text
        for role, text in zip(("tip_uncompensated", "tip"), caught.value.problems, strict=True)
    ] == [True, True]


def test_a_loop_without_a_word_on_its_command_is_opened_at_the_delayed_wire(write, quick):
    roles = "\n".join(line for line in ROLES.splitlines() if "actuator_voltage" not in line)
    found = analyze(write(roles=roles))
    assert np.abs(found.from_parts - found.measured).max() < 1e-6
    with pytest.raises(
        ProblemsError, match=r"signals\.actuator_voltage is missing, and no wire has a delay"
    ):
        analyze(write(roles=roles, sense="", delay=0))


def test_a_command_that_nothing_senses_for_is_named(write):
    with pytest.raises(ProblemsError, match="nothing senses the hand: no wires lead from 'frame'"):
        analyze(write(sense=""))


def test_a_scenario_without_a_hand_says_which_inputs_one_has(write_scenario):
    path = write_scenario("[part.a]\nfmu = PROBE\n")
    with pytest.raises(SteadytipError, match=r"moves the hand as a recording does.*recorded_x"):
        analyze(path)


def test_a_recording_that_is_too_short_is_told_with_what_is_needed(write, recording):
    with pytest.raises(ProblemsError, match=r"the motion lasts 1\.996 s, the analysis needs 12 s"):
        analyze(write(), motion=recording)


def test_without_python_control_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(analysis_module, "find_spec", lambda name: None)
    with pytest.raises(SteadytipError, match=r"pip install 'steadytip\[analyze\]'"):
        analyze("closed_loop")


def test_a_run_takes_as_long_as_it_says(write):
    assert duration(load(write())) == pytest.approx(12.0)


@pytest.mark.slow
def test_the_shipped_loop():
    """Feed-forward, tremor halved, intent left alone, parts as they are built and as the whole is.

    Where parts are fitted, this is on one realisation of the motion, and the whole of another.
    """
    found = analyze("closed_loop")
    assert not found.loop.feedback
    assert np.sqrt(np.mean(band(left_of(found.measured)) ** 2)) < 0.6
    assert np.linalg.norm(found.measured, ord=2, axis=(1, 2))[FREQUENCIES <= 2.0].max() < 1.15
    difference = band(left_of(found.measured - found.from_parts))
    assert np.sqrt(np.mean(difference**2)) < 0.08
    ten = int(np.argmin(np.abs(FREQUENCIES - 10.0)))
    stages = {stage.label: stage for stage in found.stages}
    assert stages["→ piezo_1 … piezo_3, 1 sample"].delay[ten] == pytest.approx(1e-3, abs=1e-6)
    # The accelerometers' filter, 10.56 ms, lags by 33.6 degrees; the estimator hands the channels
    # on as they are, and the controller's filter makes up for it.
    assert np.degrees(stages["sensors"].phase[ten]) == pytest.approx(-33.6, abs=4.0)
    assert abs(np.degrees(stages["estimator"].phase[ten])) < 5
    assert 25 < np.degrees(stages["controller"].phase[ten]) < 55
    assert {"controller", "piezo_1"} <= set(found.fitted)
    assert not {"hand", "instrument", "sensors", "estimator"} & set(found.fitted)
    assert np.sqrt(np.mean(band(found.held_out) ** 2)) < 0.2
    assert np.sqrt(np.mean(band(found.scatter) ** 2)) < 0.08
    assert found.budget.spare is not None
