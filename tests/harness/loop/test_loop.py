"""The loop with FMUs by somebody else: what it computes, and how it ends when a part misbehaves."""

import signal
import subprocess
import sys
import time
import types
import zipfile
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import steadytip
from harness.common.errors import PartError, ProblemsError
from harness.parts.kinds import kinds
from harness.parts.ports import Port, Unit
from tests.harness.conftest import MODES, PackProbe, WriteScenario
from tests.waiting import wait_until

TWO = """
[part.late]
fmu = PROBE
[part.early]
fmu = PROBE
"""


each_tick = pytest.mark.usefixtures("tick")


def run(path: Path, tmp_path: Path, **more) -> steadytip.Result:
    return steadytip.run(path, out=tmp_path / "out", report=False, **more)


def misbehaving(mode: str, at: float = 0.5, extra: str = "") -> str:
    return f"""
[part.good]
fmu = PROBE
[part.bad]
fmu = PROBE
mode = {MODES[mode]}
at = {at}
{extra}
[[wire]]
from = "good.count"
to = "bad.add"
"""


@each_tick
def test_a_wire_without_delay_arrives_in_the_same_tick(write_scenario: WriteScenario, tmp_path):
    wire = '[[wire]]\nfrom = "early.count"\nto = "late.add"\n'
    result = run(write_scenario(TWO + wire), tmp_path)
    ticks = np.arange(1, 1001)
    assert np.array_equal(result.signals("early.count"), ticks)
    assert np.array_equal(result.signals("late.count"), 2 * ticks)
    assert np.allclose(result.time, np.arange(1000) * 1e-3, rtol=0, atol=1e-12)


@each_tick
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(delays=st.lists(st.integers(1, 7), min_size=1, max_size=3, unique=True))
def test_a_delayed_wire_gives_the_value_of_that_many_ticks_ago(delays, write_scenario, tmp_path):
    parts = "[part.source]\nfmu = PROBE\n"
    for delay in delays:
        parts += f"[part.sink{delay}]\nfmu = PROBE\n"
        parts += f'[[wire]]\nfrom = "source.count"\nto = "sink{delay}.add"\ndelay = {delay}\n'
    # Tables and arrays of tables may alternate in TOML; the order of parts is that of the file.
    result = run(write_scenario(parts, head="seconds = 0.05\nstep_size = 1e-3\n"), tmp_path)
    source = result.signals("source.count")
    for delay in delays:
        heard = result.signals(f"sink{delay}.count") - np.arange(1, 51)
        # Before its first tick the source had its initial output: no steps.
        assert np.array_equal(heard, np.concatenate([np.zeros(delay), source[:-delay]]))


@each_tick
def test_a_delayed_ring_of_parts_integrates(write_scenario: WriteScenario, tmp_path):
    """Each part adds the other's count of the tick before: the result is a sum of naturals.

    Expected Result: a_k = k + b_(k-1), b_k = k + a_k, from zero.
    """
    text = TWO + (
        '[[wire]]\nfrom = "late.count"\nto = "early.add"\ndelay = 1\n'
        '[[wire]]\nfrom = "early.count"\nto = "late.add"\n'
    )
    result = run(write_scenario(text, head="seconds = 0.03\nstep_size = 1e-3\n"), tmp_path)
    early, late = [], []
    for k in range(1, 31):
        early.append(k + (late[-1] if late else 0))
        late.append(k + early[-1])
    assert np.array_equal(result.signals("early.count"), early)
    assert np.array_equal(result.signals("late.count"), late)


@each_tick
def test_start_values_reach_the_fmu_and_boolean_ports_pass(write_scenario, tmp_path):
    text = """
[part.a]
fmu = PROBE
[part.b]
fmu = PROBE
gain = 2.5
u = 4.0
w = [1.0, 2.0, 3.0]
[[wire]]
from = "a.off"
to = "b.on"
"""
    result = run(write_scenario(text), tmp_path)
    assert (result.signals("b.y") == 10.0).all()
    assert (result.signals("a.off") == 1.0).all()
    assert (result.signals("b.off") == 0.0).all()
    assert result.metadata.parts["b"]["start_values"]["w[2]"] == 2.0
    assert result.table.schema.field("b.off").type == "bool"
    assert result.table.schema.field("b.count").type == "int32"


def test_each_part_gets_its_own_seed_from_the_scenarios(write_scenario, tmp_path):
    path = write_scenario(TWO.replace("[part.early]", "[part.early]\nseed = 7"))
    first = run(path, tmp_path).metadata.parts
    other = run(path, tmp_path, overrides={"seed": 2}).metadata.parts
    assert first["early"]["seed"] == other["early"]["seed"] == 7
    assert first["late"]["seed"] != other["late"]["seed"]
    assert 0 <= first["late"]["seed"] <= 1000
    assert run(path, tmp_path).metadata.parts == first


@each_tick
@pytest.mark.parametrize(
    ("mode", "text"),
    [
        ("fails", r"fmi2DoStep returned Error\. The FMU says: no more after 0.5 s"),
        ("gives_nan", "its output 'y' is nan"),
        ("is_fatal", "fmi2DoStep returned Fatal"),
        ("discards", "fmi2DoStep returned Discard"),
    ],
)
def test_a_part_that_misbehaves_ends_the_run_by_name_and_time(mode, text, write_scenario, tmp_path):
    with pytest.raises(PartError, match=text) as caught:
        run(write_scenario(misbehaving(mode)), tmp_path)
    error = caught.value
    assert str(error).startswith("part 'bad' ended the run at t = 0.5 s: ")
    assert (error.part, error.time) == ("bad", 0.5)
    # Everything before is there, the tick that failed is not.
    assert np.array_equal(error.result.signals("good.count"), np.arange(1, 501))
    assert error.result.error == str(error)
    assert steadytip.read(tmp_path / "out").time[-1] == pytest.approx(0.499)


@each_tick
def test_nan_is_not_handed_on_to_the_next_part(write_scenario, tmp_path):
    """The next part would refuse the value and be blamed for it."""
    text = misbehaving("gives_nan") + '[[wire]]\nfrom = "bad.y"\nto = "good.u"\ndelay = 1\n'
    text += '[part.next]\nfmu = PROBE\n[[wire]]\nfrom = "bad.y"\nto = "next.u"\n'
    with pytest.raises(PartError, match=r"part 'bad' .* output 'y' is nan"):
        run(write_scenario(text), tmp_path)


@each_tick
def test_a_part_that_hangs_ends_the_run_within_its_limit(write_scenario, tmp_path):
    path = write_scenario(misbehaving("hangs", extra="step_limit = 1.0"))
    begun = time.perf_counter()
    with pytest.raises(
        PartError, match=r"'bad' did not come back .* t = 0.5 s .*step_limit of 1 s"
    ) as caught:
        run(path, tmp_path)
    assert time.perf_counter() - begun < 8.0
    assert len(caught.value.result.time) == 500


@each_tick
def test_a_step_that_takes_too_long_ends_the_run(write_scenario, tmp_path, monkeypatch):
    monkeypatch.setattr("harness.loop.loop._POLL", 1.0)  # the watching thread looks away
    path = write_scenario(misbehaving("is_slow", extra="step_limit = 1.0"))
    with pytest.raises(
        PartError, match=r"'bad' took 1.5\d* s for its step at t = 0.5 s, more than"
    ):
        run(path, tmp_path)


def test_a_part_that_does_not_initialise_is_named_with_its_own_words(write_scenario, tmp_path):
    path = write_scenario(misbehaving("fails_to_start"))
    with pytest.raises(PartError) as caught:
        run(path, tmp_path)
    assert str(caught.value) == (
        "part 'bad' does not start: fmi2ExitInitializationMode returned Error. "
        "The FMU says: gain 1 does not suit me"
    )
    assert caught.value.result is None
    assert list((tmp_path / "out").iterdir()) == []


@each_tick
def test_an_input_that_is_refused_is_named_with_value_unit_and_the_fmus_words(
    write_scenario, tmp_path
):
    text = """
[part.big]
fmu = PROBE
gain = 10.0
u = 50.0
[part.small]
fmu = PROBE
[[wire]]
from = "big.y"
to = "small.u"
delay = 1
"""
    with pytest.raises(PartError) as caught:
        run(write_scenario(text), tmp_path)
    text = str(caught.value)
    assert text.startswith("part 'small' ended the run at t = 0 s: input 'u' = 500 m was refused")
    assert text.endswith("The FMU says: u = 500 is too much for me")


def replaced(probe: PackProbe, *replacements, **more) -> str:
    return f'[part.p]\nfmu = "{probe(*replacements, **more).as_posix()}"\n'


@pytest.mark.parametrize(
    ("replacement", "text"),
    [
        (('guid="probe-1"', 'guid="other"'), "the GUID is 'other', not 'probe-1'"),
        (('fmiVersion="2.0"', 'fmiVersion="3.0"'), r"is FMI 3\.0; the harness runs FMI 2\.0"),
        (("CoSimulation modelId", "ModelExchange modelId"), "model exchange only"),
        (('causality="output"', 'causality="outpt"'), "breaks the FMI schema"),
    ],
)
def test_an_fmu_that_is_not_what_it_should_be_is_refused(
    replacement, text, pack_probe, write_scenario, tmp_path
):
    if "CoSimulation" in replacement[0]:
        more = [(' canHandleVariableCommunicationStepSize="true"', "")]
    else:
        more = []
    with pytest.raises(steadytip.SteadytipError, match=text):
        run(write_scenario(replaced(pack_probe, replacement, *more)), tmp_path)


def test_an_fmu_for_another_machine_is_refused_with_what_it_has(
    pack_probe, write_scenario, tmp_path
):
    path = write_scenario(replaced(pack_probe, folder="vax64"))
    with pytest.raises(ProblemsError, match=r"part 'p': probe.fmu has no binary .* it has vax64"):
        run(path, tmp_path)


def test_a_binary_that_does_not_load_is_named(pack_probe, write_scenario, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_scenario(replaced(pack_probe, binary=b"no library"))
    with pytest.raises(PartError, match=r"part 'p' does not start: probe\.fmu does not load"):
        steadytip.run(path, out="out", report=False)
    assert Path.cwd() == tmp_path


def test_files_that_are_missing_or_no_fmus_are_all_named_at_once(write_scenario, tmp_path):
    (tmp_path / "text.fmu").write_text("not a zip")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w"):
        pass
    names = ("gone", "text", "empty")
    path = write_scenario("".join(f'[part.{n}]\nfmu = "{n}.fmu"\n' for n in names))
    with pytest.raises(ProblemsError) as caught:
        run(path, tmp_path)
    assert [problem.split(":")[0] for problem in caught.value.problems] == [
        "part 'gone'",
        "part 'text'",
        "part 'empty'",
    ]
    assert "does not exist" in caught.value.problems[0]
    assert "is not an FMU" in caught.value.problems[1]
    assert "modelDescription.xml is missing" in caught.value.problems[2]


class Ramp:
    """A kind of part that is not ours: gives its time, and the largest input that it has seen."""

    def __init__(self, name, settings, seed):
        self.name = name
        self.inputs = [Port("u")]
        self.outputs = [Port("t", unit=Unit("s")), Port("peak")]
        self.seconds = float(settings["ramp"])
        self.closed = 0

    @classmethod
    def prepare(cls, settings, progress):
        return settings

    def start(self, run, connected, initialised, u, y):
        assert list(connected) == ["u"]
        self.u, self.y = u, y

    def advance(self, t, h):
        self.y[:] = t, max(self.y[1], self.u[0])

    def close(self):
        self.closed += 1

    def metadata(self):
        return {"kind": "ramp"}


def test_a_kind_of_part_from_elsewhere_takes_part(tmp_path, monkeypatch, write_scenario):
    """An entry point is all that a new kind needs: the loop cannot tell it from an FMU."""
    monkeypatch.setitem(sys.modules, "elsewhere", types.SimpleNamespace(Ramp=Ramp))
    point = EntryPoint("ramp", "elsewhere:Ramp", "steadytip.parts")
    monkeypatch.setattr("harness.parts.kinds.entry_points", lambda group: [point])
    kinds.cache_clear()
    try:
        text = '[part.r]\nramp = 0.5\n[[wire]]\nfrom = "r.peak"\nto = "r.u"\ndelay = 1\n'
        result = run(write_scenario(text), tmp_path)
    finally:
        kinds.cache_clear()
    assert np.allclose(result.signals("r.t"), np.arange(500) * 1e-3)
    assert (result.signals("r.peak") == 0.0).all()


@pytest.mark.parametrize("patch", ["", "harness.loop.native.library = lambda: None; "])
def test_ctrl_c_ends_the_run_in_order(patch, write_scenario, tmp_path):
    path = write_scenario(TWO, head="seconds = 3600.0\nstep_size = 1e-3\n")
    code = f"import harness.loop.native; {patch}from harness.cli.main import main; main()"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            code,
            "run",
            str(path),
            "--out",
            str(tmp_path / "out"),
            "--no-report",
        ],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    stream = tmp_path / "out" / "results.arrows"
    wait_until(lambda: stream.exists() and stream.stat().st_size > 100_000, what="the record")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "stopped by the user at t =" in errors
    result = steadytip.read(tmp_path / "out")
    assert result.file.name == "results.parquet"
    assert np.array_equal(result.signals("early.count"), np.arange(1, len(result.time) + 1))
