"""Garbage on the board's line, and all faults at once under sanitisers."""

import os
import shutil
import subprocess
import time

import numpy as np
import pytest

from harness.can.firmware import sources
from harness.can.firmware.build import build_board
from harness.can.firmware.process import FirmwareBoard, fault_kinds
from tests.harness.can.firmware.board import (
    COMMAND,
    DBCS,
    FEEDBACK,
    OFF,
    RUN,
    STRICT,
    Frame,
    Host,
    clean_frames,
    command,
    while_sampling,
)
from tests.waiting import wait_until


@pytest.mark.parametrize("dbc", DBCS)
def test_garbage_on_the_line_does_not_disturb(recording, volts, dbc) -> None:
    """Expected: frames as ever, nothing applied; run where undefined behaviour is a trap."""
    rng = np.random.default_rng(11)
    letters = np.frombuffer(b"0123456789ABCDEFtTrRdDbBSsVNFZYx\r\r\r\a\n", np.uint8)
    program = build_board(dbc, STRICT)
    with FirmwareBoard(recording, dbc, program=program) as board:
        host = Host(board.link)
        fd = dbc == "instrument_fd"
        good = Frame(COMMAND, command(dbc, 3, RUN, 10.0, 10.0, 10.0), fd).line
        while not host.has_stopped:
            size = int(rng.integers(1, 60))
            junk = rng.integers(0, 256, size, dtype=np.uint8)
            noise = rng.choice(letters, size)
            cut = good[: int(rng.integers(1, len(good) - 1))]
            text = junk.tobytes() + noise.tobytes() + b"\r"
            # What closes the channel is no garbage but a command, and so is what only listens.
            lines = [x for x in text.split(b"\r") if x not in (b"C", b"O", b"L")]
            os.write(host.fd, b"\r".join(lines) + cut.encode() + b"\r")
            host.pump(2e-3)
        host.close()
    clean = [f for frames in clean_frames(dbc, volts) for f in frames]
    seen = while_sampling(host.frames)
    assert [f for f in seen if f.id != FEEDBACK] == [f for f in clean if f.id != FEEDBACK]
    assert (board.log["volts_1"] == 0).all()
    assert (board.log["mode"] == OFF).all()


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_all_faults_at_once_under_the_sanitisers_of_another_compiler(
    recording, dbc, tmp_path
) -> None:
    """Zig has no run-time part for addresses; the system's compiler may have one."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no other C compiler here")
    for name, text in sources(dbc).items():
        (tmp_path / name).write_text(text)
    units = [n for n in sources(dbc) if n.endswith(".c")]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-g", "-O1"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    done = subprocess.run(
        [compiler, *flags, *units, "-o", "board", "-lm"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    if "cannot find" in done.stderr:
        pytest.skip("the C compiler here has no sanitisers")
    assert done.returncode == 0, done.stderr
    faults = [f"{kind}:0.05" for kind in fault_kinds() if kind not in ("silence", "bus-off")]
    faults = [f"{f.split(':')[0]}:0.002" if f.startswith("unplug") else f for f in faults]
    faults += ["silence:0.002", "bus-off:0.002"]
    options = {"faults": faults, "seed": 2, "program": tmp_path / "board", "loop": True}
    with FirmwareBoard(recording, dbc, **options) as board:
        end = time.monotonic() + 4.0
        while time.monotonic() < end:
            try:
                host = Host(board.link)
            except OSError:
                wait_until(board.link.exists, what="the link's return")
                continue
            try:
                host.pump(end - time.monotonic())
            except OSError:
                pass  # unplugged
            finally:
                host.close()
        assert board.is_running, board.check()
    assert len(board.log["sample"]) > 3000
