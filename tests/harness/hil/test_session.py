"""Loop and board in two processes on the wall clock. What is judged is never how fast it went."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import can
import numpy as np
import pytest
from typer.testing import CliRunner

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.can.codec import Codec
from harness.can.database import HOLD, OFF, RUN, load
from harness.can.frame_log import read_log
from harness.cli.main import app
from harness.common.errors import PartError
from harness.hil.replay import replay
from harness.hil.session import hil
from tests.harness.conftest import MODES
from tests.waiting import wait_until

# One after the other: two loops at once would take each other's time.
pytestmark = [
    pytest.mark.xdist_group("wall-clock"),
    pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="the bus needs Unix sockets"),
]
ROOT = Path(__file__).parents[3]
COMMAND = [sys.executable, "-c", "from harness.cli.main import main; main()"]
SHORT = {"seconds": 2.0, "warm_up": 0.5}
ON_THE_WIRE = ("lost", "repeated", "crc", "range", "length", "unknown", "bus_off", "unplugged")
"""Faults that no stall of the machine brings about."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return hil("closed_loop_can", overrides=SHORT, out=tmp_path_factory.mktemp("hil"))


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """A bit of everything."""
    faults = ["drop:0.05@0.3-0.6", "corrupt:0.1@0.5-0.8", "silence@1-1.03", "unavailable:0.3@1.2-2"]
    return hil(
        "closed_loop_can",
        overrides=SHORT | {"hil.log": "blf", "hil.overrun": "skip"},
        out=tmp_path_factory.mktemp("faulty"),
        faults=faults,
        fault_seed=3,
        report=False,
    )


def command_codec():
    (command,) = [m for m in load("instrument").sent_by("Loop") if m.role == "command"]
    return command, Codec(command).decode


def unmixed(result) -> None:
    """Each sample that the loop saw is one of the board's, whole, as its number says."""
    world = st.read(result.path / "board")
    number = result.signals("sensors.sample").astype(int)
    seen = number >= 0
    sent = world.signals("sensors.volts_*")[number[seen]]
    got = np.column_stack(
        [result.signals(n) for n in world.table.column_names if n.startswith("sensors.volts_")]
    )[seen]
    assert got.shape[1] == 9
    # Half a step of the message's counts.
    np.testing.assert_allclose(got, sent, atol=0.51 * 5 / 65535)


def test_every_sample_is_the_one_that_the_board_took(run) -> None:
    counts = run.metadata.hil["counts"]
    assert {name: counts[name] for name in ON_THE_WIRE} == dict.fromkeys(ON_THE_WIRE, 0)
    assert len(run.time) == 2000
    unmixed(run)


def test_a_sample_on_the_bus_is_as_good_as_one_in_memory(run, tmp_path) -> None:
    alone = st.run("closed_loop", overrides=SHORT, out=tmp_path, report=False)
    if run.metrics["lost_samples"].value:
        pytest.skip("the machine stalled in mid-run: samples came too late")
    for name in ("reduction_in_band", "tip_rms_uncompensated"):
        assert run.metrics[name].value == pytest.approx(alone.metrics[name].value, rel=0.02)


def test_metrics_and_files_of_a_run(run) -> None:
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert {"reduction_in_band", "lost_samples", "latency_p50", "latency_p99", "overruns"} <= set(
        metrics
    )
    assert 0 < metrics["latency_p50"]["value"] < metrics["latency_p99"]["value"] < 1
    assert 0.5 < metrics["bus_load"]["value"] / 100 < 0.7
    for name in ("frames.log", "results.parquet", "report.html", "board/results.parquet"):
        assert (run.path / name).is_file(), name
    assert not run.metadata.hil["notes"]


def test_the_world_of_the_board_stands_beside_the_loop(run) -> None:
    """What the loop cannot know is in its record all the same, at the samples of its ticks."""
    world = st.read(run.path / "board")
    due = run.signals("sensors.due").astype(int)
    for name in ("instrument.tip_x", "hand.intent_y", "piezo_2.stroke"):
        np.testing.assert_array_equal(run.signals(name), world.signals(name)[due])
    # The command of a sample acts at the next one, or when the machine lets it through.
    applied, sent = world.signals("bus.volts_1"), run.signals("sensors.command.volts_sent_1")
    near = np.lib.stride_tricks.sliding_window_view(sent, 20)
    acted = applied[due[19:-1] + 1]
    assert (np.abs(near[:-1] - acted[:, np.newaxis]).min(axis=1) < 0.00101).all()
    assert np.mean(np.abs(sent[19:-1] - acted) < 0.00101) > 0.5


def test_the_log_ends_with_the_command_at_rest_and_off(run) -> None:
    database = load("instrument")
    command, decode = command_codec()
    sent = [
        decode(bytes(e.message.data))[0]
        for e in read_log(run.path / "frames.log")
        if e.was_sent and e.message.arbitration_id == command.id
    ]
    modes, volts = np.array([s[0] for s in sent]), np.array([s[1:] for s in sent])
    first = int(np.flatnonzero(modes == RUN)[-1]) + 1
    assert set(modes[first:-3]) == {HOLD}
    assert list(modes[-3:]) == [OFF] * 3
    assert (volts[-3:] == 0).all()
    assert np.abs(np.diff(volts[first - 1 :], axis=0)).max() <= database.ramp_rate * 1e-3 + 2e-3
    assert len(sent) > 2000 + 100


@pytest.mark.parametrize("which", ["run", "faulty"])
def test_a_replay_is_the_same_to_the_last_bit(which, request, tmp_path) -> None:
    result = request.getfixturevalue(which)
    name = "frames.blf" if which == "faulty" else "frames.log"
    again = replay(result.path / name, out=tmp_path, report=False)
    assert again.is_identical
    assert again.commands >= 1900 if which == "run" else again.commands > 1000
    assert again.signals > 90
    np.testing.assert_array_equal(
        again.result.signals("controller.volts_*"), result.signals("controller.volts_*")
    )


def test_a_replay_of_something_else_says_what_differs(run, tmp_path) -> None:
    again = replay(
        run.path / "frames.log",
        overrides={"part.controller.tremor_filter": 1},
        out=tmp_path,
        report=False,
    )
    assert not again.is_identical
    assert again.differing > 900
    assert "controller.volts_1" in again.changed
    assert "sensors.volts_mx" not in again.changed


def test_faults_on_a_real_bus_are_counted_and_nothing_is_mixed(faulty) -> None:
    counts = faulty.metadata.hil["counts"]
    for name in ("lost", "crc", "timeouts", "sequence", "range", "incomplete"):
        assert counts[name] > 0, name
    assert faulty.metrics["invalid"].value > 0
    mode = faulty.signals("sensors.command.mode")
    valid = faulty.signals("sensors.valid")
    assert set(mode[valid == 0]) == {HOLD}
    assert mode[-1] in (HOLD, RUN)
    followed = (valid != 0) & (faulty.signals("sensors.age") < 4.999e-3)
    assert followed.any()
    assert set(mode[followed]) == {RUN}


def test_the_board_as_a_c_program_closes_the_loop_too(tmp_path) -> None:
    """Packing, protection and drive of its own; where the tip was is computed afterwards."""
    result = hil(
        "closed_loop_can", overrides=SHORT | {"hil.board": "c"}, out=tmp_path, report=False
    )
    counts = result.metadata.hil["counts"]
    assert {name: counts[name] for name in ON_THE_WIRE} == dict.fromkeys(ON_THE_WIRE, 0)
    assert not result.metadata.hil["notes"]
    unmixed(result)
    alone = st.run("closed_loop", overrides=SHORT, out=tmp_path / "alone", report=False)
    if not result.metrics["lost_samples"].value:
        for name in ("reduction_in_band", "tip_rms_uncompensated"):
            assert result.metrics[name].value == pytest.approx(alone.metrics[name].value, rel=0.1)
    assert replay(tmp_path / "frames.log", out=tmp_path / "again", report=False).is_identical


def test_the_monitor_is_there_while_the_loop_runs_and_gone_afterwards(tmp_path) -> None:
    pages: list[tuple[str, int]] = []

    def status(text: str) -> None:
        if text.startswith("monitor: "):
            url = text.removeprefix("monitor: ")
            with urllib.request.urlopen(url, timeout=10) as page:
                pages.append((url, page.status))

    overrides = {"seconds": 1.0, "warm_up": 0.0}
    hil(
        "closed_loop_can",
        overrides=overrides,
        out=tmp_path,
        monitor=True,
        report=False,
        status=status,
    )
    ((url, code),) = pages
    assert code == 200
    assert url.startswith("http://127.0.0.1:")
    with pytest.raises(OSError):
        urllib.request.urlopen(url, timeout=2)


def test_a_recording_plays_in_place_of_the_plants(run, tmp_path) -> None:
    """Of the board's own record: the same samples go over the bus again."""
    channel = str(tmp_path / "bus")
    source = str(run.path / "board" / "results.parquet")
    board = start(
        *("board", "closed_loop_can", "--channel", channel, "--recording", source),
        *("--out", str(tmp_path / "board")),
    )
    try:
        overrides = {
            "seconds": 1.0,
            "warm_up": 0.0,
            "hil.board": "none",
            "hil.startup_timeout": 60.0,
            "part.sensors.channel": channel,
        }
        again = hil("closed_loop_can", overrides=overrides, out=tmp_path / "loop", report=False)
    finally:
        board.send_signal(signal.SIGINT)
        said, _ = board.communicate(timeout=60)
    assert "Traceback" not in said
    number = again.signals("sensors.sample").astype(int)
    sent = st.read(run.path / "board").signals("sensors.volts_a1x")[number]
    np.testing.assert_allclose(again.signals("sensors.volts_a1x"), sent, atol=0.51 * 5 / 65535)


def start(*arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [*COMMAND, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_ctrl_c_brings_the_command_to_rest_and_keeps_the_record(tmp_path) -> None:
    out = tmp_path / "out"
    process = start("hil", "closed_loop_can", "--seconds", "60", "--out", str(out))
    log = out / "frames.log"
    wait_until(lambda: log.is_file() and log.stat().st_size > 100_000)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 1, said
    assert "stopped by the user" in said
    result = st.read(out)
    assert "stopped by the user" in result.error
    assert len(result.time) > 300
    world = st.read(out / "board")
    assert (world.signals("bus.volts_?")[-1] == 0).all()
    assert "Traceback" not in said


def test_a_board_that_is_killed_leaves_the_loop_on_hold(tmp_path) -> None:
    out = tmp_path / "out"
    process = start("hil", "closed_loop_can", "--seconds", "4", "--no-report", "--out", str(out))
    log = out / "frames.log"
    wait_until(lambda: log.is_file() and log.stat().st_size > 100_000)
    (children,) = Path(f"/proc/{process.pid}/task/{process.pid}").glob("children")
    os.kill(int(children.read_text().split()[0]), signal.SIGKILL)
    said, _ = process.communicate(timeout=60)
    assert "Traceback" not in said
    result = st.read(out)
    mode = result.signals("sensors.command.mode")
    assert mode[-1] == HOLD
    assert (result.signals("sensors.command.volts_sent_?")[-1] == 0).all()
    assert any("board ended with exit code -9" in note for note in result.metadata.hil["notes"])
    kinds = {kind for _, kind, _ in result.metadata.hil["events"]}
    assert {"timeouts", "heartbeat"} <= kinds


def test_a_part_that_hangs_in_mid_run_is_not_waited_for(pack_probe, tmp_path) -> None:
    """The watchdog ends the run, and the command goes to rest all the same."""
    probe = pack_probe()
    path = tmp_path / "hangs.toml"
    path.write_text(
        f'extends = "closed_loop_can"\nseconds = 30.0\n[part.probe]\nfmu = "{probe.as_posix()}"\n'
        f"mode = {MODES['hangs']}\nat = 1.0\n[hil]\nwatchdog = 0.2\n"
    )
    begun = time.monotonic()
    with pytest.raises(PartError, match=r"its watchdog of the wall clock of 0\.2 s") as raised:
        hil(str(path), out=tmp_path / "out", report=False)
    assert raised.value.part == "probe"
    assert time.monotonic() - begun < 30
    assert raised.value.result is not None
    command, decode = command_codec()
    last = [e for e in read_log(tmp_path / "out" / "frames.log") if e.was_sent][-50:]
    sent = [
        decode(bytes(e.message.data))[0] for e in last if e.message.arbitration_id == command.id
    ]
    assert sent[-1] == (OFF, 0.0, 0.0, 0.0)


def test_nobody_on_the_bus(tmp_path) -> None:
    with pytest.raises(PartError, match=r"no complete sample within 0\.3 s") as raised:
        hil(
            "closed_loop_can",
            overrides={
                "hil.board": "none",
                "hil.startup_timeout": 0.3,
                "part.sensors.channel": str(tmp_path / "bus"),
            },
            out=tmp_path / "out",
        )
    assert "nothing of the DBC file was heard" in str(raised.value)
    assert not (tmp_path / "out" / "results.arrows").exists()


def test_a_part_on_a_bus_needs_the_wall_clock(tmp_path) -> None:
    with pytest.raises(SteadytipError, match="steadytip hil closed_loop_can"):
        st.run("closed_loop_can", out=tmp_path)


def test_a_loop_without_a_bus_keeps_to_the_clock(tmp_path) -> None:
    result = hil(
        "closed_loop", overrides={"seconds": 0.5, "warm_up": 0.0}, out=tmp_path, report=False
    )
    assert len(result.time) == 500
    assert result.metadata.wall > 0.49


def test_a_board_for_a_loop_without_a_bus_is_a_mistake(tmp_path) -> None:
    with pytest.raises(SteadytipError, match="no part on a CAN bus"):
        hil("closed_loop", overrides={"hil.board": "python"}, out=tmp_path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("part.sensors.interfaec=3", "did you mean 'interface'?"),
        ("part.sensors.node=Bord", "did you mean 'Board'?"),
        ("part.sensors.can=instrumnet", "did you mean 'instrument'?"),
        ("hil.overrun=never", "hil.overrun"),
        ("part.sensors.interface=socketcam", "not at 'socketcam'"),
    ],
)
def test_mistakes_are_named(setting, words, tmp_path) -> None:
    arguments = ["hil", "closed_loop_can", "--seconds", "1", "--out", str(tmp_path / "x")]
    with pytest.raises(SteadytipError) as raised:
        CliRunner().invoke(app, [*arguments, "--set", setting], catch_exceptions=False)
    assert words in str(raised.value)


def test_two_parts_on_a_bus_are_a_mistake(tmp_path) -> None:
    with pytest.raises(SteadytipError, match="2 parts on a CAN bus: hand, sensors"):
        hil("closed_loop_can", overrides={"part.hand.can": "instrument"}, out=tmp_path)


def test_a_board_that_only_drives_gets_its_commands_by_the_clock(tmp_path) -> None:
    """Sensors and hand stay FMUs; the stacks are on the bus."""
    text = load("instrument").path.read_text()
    for id in (272, 273, 274):
        text = text.replace(f'BA_ "Role" BO_ {id} 1;\n', "")
    dbc = tmp_path / "stacks.dbc"
    dbc.write_text(text)
    other = can.Bus(interface="virtual", channel="stacks")
    result = hil(
        "closed_loop",
        overrides={
            "seconds": 0.5,
            "warm_up": 0.0,
            "part.piezo_1.can": str(dbc),
            "part.piezo_1.interface": "virtual",
            "part.piezo_1.channel": "stacks",
            "part.piezo_1.replaces": ["piezo_2", "piezo_3"],
        },
        out=tmp_path / "out",
        report=False,
    )
    command, decode = command_codec()
    frames = []
    while (message := other.recv(0)) is not None:
        frames.append(message)
    other.shutdown()
    sent = [decode(bytes(m.data))[0] for m in frames if m.arbitration_id == command.id]
    running = [volts for mode, *volts in sent if mode == RUN]
    assert len(running) >= 499
    np.testing.assert_allclose(
        running[-400:], result.signals("controller.volts_?")[-400:], atol=0.00101
    )
    assert sent[-1] == (OFF, 0.0, 0.0, 0.0)
    assert (result.signals("piezo_1.valid") == 1).all()


@pytest.fixture(scope="module")
def minute(tmp_path_factory):
    """In memory."""
    out = tmp_path_factory.mktemp("minute")
    return st.run("closed_loop", overrides={"seconds": 60.0}, out=out, report=False)


@pytest.mark.slow
@pytest.mark.parametrize("interface", ["unixbus", "slcanbulk"])
def test_a_minute_over_two_processes(interface, minute, tmp_path) -> None:
    """No sample lost or mixed, and the tremor cancelled as in the pure co-simulation.

    Machines are shared and stall for longer than a sample may be late: of two tries one counts.
    """
    for attempt in range(2):
        result = hil(
            "closed_loop_can",
            overrides={"seconds": 60.0, "part.sensors.interface": interface},
            out=tmp_path / f"{attempt}",
            report=False,
        )
        unmixed(result)
        counts = result.metadata.hil["counts"]
        assert {name: counts[name] for name in ON_THE_WIRE} == dict.fromkeys(ON_THE_WIRE, 0)
        lost = result.metrics["lost_samples"].value
        stalled = counts["late"] + counts["timeouts"] + counts["overruns"]
        assert lost == 0 or stalled, "samples went missing, and nobody was late"
        if lost == 0:
            break
    if lost:
        pytest.skip(f"the machine stalled in both minutes: {lost:g} samples came too late")
    for name in ("reduction_in_band", "reduction_a_posteriori"):
        assert abs(result.metrics[name].value - minute.metrics[name].value) <= 2.0, name
