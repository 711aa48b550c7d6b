"""Wrong options and recordings, and a board that dies."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from harness.can.firmware.build import build_board
from harness.can.firmware.process import CHANNELS, FirmwareBoard, write_samples
from tests.harness.can.firmware.board import Host
from tests.waiting import wait_until


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "option '--link': it is missing"),
        (["--link", "x"], "option '--samples': it is missing"),
        (["--speed", "2"], "option '--speed': it is not known; --help"),
        (["--log"], "option '--log': it needs a value"),
        (["--seed", "-1"], "--seed '-1': it must be a number in [0, 4294967295]"),
        (["--drift", "fast"], "--drift 'fast': it must be a number in [-10000, 10000]"),
        (["--drift", "nan"], "--drift 'nan': it must be a number"),
        (["--priority", "0"], "--priority '0': it must be a number in [1, 99]"),
        (["--fault", "drip"], "--fault 'drip': the kind is not known; --kinds"),
        (["--fault", "drop:1.1"], "the rate must be a probability, 0 to 1"),
        (["--fault", "drop:-0.1"], "the rate must be a probability, 0 to 1"),
        (["--fault", "drop:0.1@3-2"], "the time must end after it begins"),
        (["--fault", "drop@3"], "the time must be START-END or START-"),
        (["--fault", "drop@-3-4"], "the time must be START-END or START-"),
        (["--fault", "drop@1-2x"], "not of the form KIND[/ID][:RATE][@START-END]"),
        (["--fault", "drop/0x555"], "the id is none of this bus"),
        (["--fault", "silence/0x110"], "only faults of frames have an id"),
        (["--fault", "drop"] * 33, "there are too many faults, more than 32"),
    ],
)
def test_wrong_options_are_told_in_words(arguments, words) -> None:
    done = subprocess.run([build_board(), *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stdout == ""


def test_help_names_every_option() -> None:
    done = subprocess.run([build_board(), "--help"], capture_output=True, text=True, check=True)
    for name in ("link", "samples", "loop", "log", "drift", "fault", "seed", "kinds", "priority"):
        assert f"--{name}" in done.stdout


GOOD = ",".join(f"volts_{name}" for name in CHANNELS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        (f"{GOOD}\n", "it has a header and no samples"),
        (f"{GOOD},volts_x\n", "line 1: a column is not known: 'volts_x'"),
        (f"{GOOD},volts_mx\n", "line 1: a column stands twice: 'volts_mx'"),
        ("temperature\n1\n", "line 1: a column is missing: 'volts_a1x'"),
        (f"{GOOD}\n1,1,1,1,1,1,1,1\n", "line 2: there are more or fewer cells"),
        (f"{GOOD}\n{'1,' * 8}1\n{'1,' * 8}x\n", "line 3: no number: 'x'"),
        (f"{GOOD}\n{'1,' * 8}5.1\n", "line 2: a voltage must be in [0, 5] V, or nan"),
        (f"{GOOD}\n{'1,' * 8}inf\n", "line 2: a voltage must be in [0, 5] V, or nan"),
        (f"{GOOD},temperature\n{'1,' * 9}200\n", "line 2: a temperature must be in [-40, 125]"),
        (f"{GOOD},field_new\n{'1,' * 9}2\n", "line 2: field_new must be 0 or 1, not '2'"),
    ],
)
def test_wrong_recordings_are_told_by_line(tmp_path, text, words) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(SteadytipError) as caught, FirmwareBoard(path):
        pass
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "status 2" in str(caught.value)


def test_a_recording_has_nine_channels(tmp_path) -> None:
    with pytest.raises(SteadytipError, match=r"have the shape \(5, 8\), they need \(samples, 9\)"):
        write_samples(tmp_path / "wrong.csv", np.ones((5, 8)))


def test_a_link_does_not_replace_a_file(recording, tmp_path) -> None:
    path = tmp_path / "precious"
    path.write_text("text")
    done = subprocess.run(
        [build_board(), "--link", path, "--samples", recording], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "there is something else at this path" in done.stderr
    assert path.read_text() == "text"


def test_a_board_that_dies_is_told(recording) -> None:
    board = FirmwareBoard(recording)
    board.start()
    assert board.is_running
    board._process.send_signal(signal.SIGKILL)
    board._process.wait()
    assert not board.is_running
    with pytest.raises(SteadytipError, match=r"the board ended with status -9"):
        board.check()
    with pytest.raises(SteadytipError, match="not ended in order"):
        board.summary  # noqa: B018
    board.stop()
    board.stop()


def test_a_board_whose_parent_dies_ends(recording, tmp_path) -> None:
    link = tmp_path / "line"
    script = (
        "import sys, os, pathlib\n"
        "from harness.can.firmware import FirmwareBoard\n"
        "recording, link = map(pathlib.Path, sys.argv[1:])\n"
        "board = FirmwareBoard(recording, link=link)\n"
        "board.start()\nprint(board._process.pid, flush=True)\nos._exit(0)\n"
    )
    command = [sys.executable, "-c", script, recording, link]
    done = subprocess.run(command, capture_output=True, text=True)
    child = int(done.stdout)

    def has_ended() -> bool:
        try:
            return Path(f"/proc/{child}/stat").read_text().split()[2] == "Z"
        except OSError:
            return True

    wait_until(has_ended, what="the board's end")
    assert not link.is_symlink()


def test_summary_is_json_and_log_is_whole_after_a_signal(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        host.pump(0.1)
        host.close()
    assert set(board.summary) == {"samples", "unsent", "latest_us"}
    assert json.dumps(board.summary)
    assert len(board.log["sample"]) == board.summary["samples"] > 50
