"""The board's terminal: the LAWICEL dialogue, stamps, and hosts that leave or are slow."""

import time
from collections.abc import Iterator

import numpy as np
import pytest

from harness.can.firmware.build import build_board
from harness.can.firmware.process import FirmwareBoard
from tests.harness.can.firmware.board import (
    LOOP,
    STATUS,
    STRICT,
    Frame,
    Host,
    clean_frames,
    protected,
    while_sampling,
)


@pytest.fixture
def idle(recording) -> Iterator[Host]:
    """A host whose channel is closed, so that nothing but answers comes."""
    program = build_board("instrument", STRICT)
    with FirmwareBoard(recording, log=False, program=program) as board:
        host = Host(board.link, speak=False)
        yield host
        host.close()


def test_answers_are_those_of_the_lawicel_manual(idle) -> None:
    ok, bad = "", "\a"
    talk = [
        # closed
        *[("C", bad), ("F", bad), ("t0A00", bad), ("S9", bad), ("S", bad), ("V", "V1010")],
        *[("N", "NB001"), ("S8", ok), ("s001C", ok), ("s00G0", bad), ("Y2", ok), ("Z0", ok)],
        *[("Z2", bad), ("", ok), ("Q", bad), ("OO", bad), ("O", ok)],
        # open; a beat that is not operational, so that the board stays quiet
        *[("O", bad), ("S8", bad), ("Z1", bad), ("F", "F00"), ("t70217F", "z"), ("t7FF0", "z")],
        *[("T1FFFFFFF0", "Z"), ("T200000000", bad), ("t8000", bad), ("t7FF9" + "00" * 9, bad)],
        *[("t0A01", bad), ("t0A0100FF", bad), ("t0A01XY", bad), ("r0A08", "z"), ("r0A0800", bad)],
        *[("bA00", bad), ("b0A09" + "00" * 12, "z"), ("d0A09" + "00" * 11, bad)],
        *[("D1FFFFFFFF" + "00" * 64, "Z"), ("t" * 5000, bad), ("V", "V1010"), ("C", ok)],
        ("L", ok),
        # only listening
        *[("t7FF0", bad), ("C", ok), ("C", bad)],
    ]
    for line, answer in talk:
        assert [a for a in idle.ask(f"{line}\r") if a != ok or answer == ok] == [answer], line


def test_stamps_are_the_boards_milliseconds(recording) -> None:
    with FirmwareBoard(recording, log=False) as board:
        host = Host(board.link, stamped=True)
        host.pump(until=lambda: len(host.frames) > 200)
        host.close()
    ids = [f.id for f in host.frames]
    begin = ids.index(STATUS)
    of_samples = [s for i, s in zip(ids[begin:], host.stamps[begin:], strict=True) if i == 0x112]
    assert (np.diff(of_samples) == 1).all()


def test_python_cans_own_slcan_gets_every_frame(recording, volts) -> None:
    import can

    expected = [f for frames in clean_frames("instrument", volts) for f in frames][:300]
    with FirmwareBoard(recording) as board:
        bus = can.Bus(
            interface="slcan", channel=str(board.link), bitrate=1_000_000, sleep_after_open=0
        )
        bus.send(can.Message(arbitration_id=LOOP, is_extended_id=False, data=[5]))
        seen: list[Frame] = []
        while len(seen) < 320:
            if message := bus.recv(1.0):
                seen.append(Frame(message.arbitration_id, bytes(message.data)))
        bus.shutdown()
    assert while_sampling(seen)[:300] == expected


def test_host_that_leaves_and_comes_back_finds_no_old_frames(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        first = Host(board.link)
        first.pump(0.05)
        time.sleep(0.1)  # unread frames pile up
        first.close()
        time.sleep(0.05)
        second = Host(board.link, speak=False)
        assert second.ask("V\r") == ["V1010"]
        assert second.frames == []
        second.write("O\r")
        second.pump(until=lambda: len(second.frames) > 20)
        second.close()


def test_slow_host_gets_whole_lines_and_is_told(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        host.pump(0.05)
        time.sleep(0.8)
        host.pump(0.3)
        host.write("F\r")
        host.pump(until=lambda: any(a.startswith("F") for a in host.answers))
        host.close()
    assert [a for a in host.answers if a not in ("", "z", "\a")] == ["F08"]
    assert board.summary["unsent"] > 100
    for frame in host.frames:
        assert protected("instrument", frame.id, frame.data) == frame.data
