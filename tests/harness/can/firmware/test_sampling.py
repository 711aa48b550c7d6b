"""Frames of the board's samples: content, order and period."""

import time
from collections.abc import Sequence

import numpy as np
import pytest

from harness.can.firmware.process import FirmwareBoard, write_samples
from tests.harness.can.firmware.board import (
    DBCS,
    HEARTBEAT,
    SAMPLES,
    STATES,
    Host,
    clean_frames,
    played,
)
from tests.waiting import wait_until


@pytest.mark.parametrize("dbc", DBCS)
def test_frames_are_those_of_cantools_and_crccheck(recording, volts, dbc) -> None:
    [seen] = played(recording, [], dbc=dbc)
    expected = [frame for frames in clean_frames(dbc, volts) for frame in frames]
    assert seen == expected


def test_sampling_waits_for_the_loop_and_says_its_state(recording) -> None:
    with FirmwareBoard(recording) as board:
        host = Host(board.link)
        for state in ("pre-operational", "stopped"):
            host.beat(state)
        host.write("t70205\rt70220500\rt70221\rT00000702105\rr7021\r")  # none is a heartbeat
        begun = time.monotonic()
        wait_until(lambda: host.read() == 0 and len(host.frames) >= 3, what="the third heartbeat")
        assert len(host.frames) <= 3 + (time.monotonic() - begun) / 0.1
        assert {f.id for f in host.frames} == {HEARTBEAT}
        assert {f.data[0] for f in host.frames} == {STATES["pre-operational"]}
        host.pump(until=lambda: host.has_stopped)
        states = [f.data[0] for f in host.frames if f.id == HEARTBEAT]
        assert list(dict.fromkeys(states)) == [127, 5, 4]
        host.write("C\r")
        board.wait(2.0)
        host.close()
    assert not board.link.exists()
    log = board.log
    np.testing.assert_array_equal(log["sample"], np.arange(SAMPLES))
    assert board.summary["samples"] == SAMPLES
    assert board.summary["unsent"] == 0
    assert log["unknown"][-1] == 1  # the heartbeat with 29 bits
    assert log["length"][-1] == 2  # two bytes of state, and the remote frame


def test_a_signal_that_is_not_available_is_sent_so(tmp_path) -> None:
    volts = np.full((20, 9), 1.0)
    volts[3:, 4] = np.nan
    volts[5:, 0] = 5.0  # the converter at its end
    [seen] = played(write_samples(tmp_path / "nan.csv", volts), [])
    raw = {id: [f.data for f in seen if f.id == id] for id in (0x110, 0x111)}
    a3x = [int.from_bytes(data[4:6], "little") for data in raw[0x111]]
    a1x = [int.from_bytes(data[2:4], "little") for data in raw[0x110]]
    assert a3x == [13107] * 3 + [0xFFFF] * 17
    assert a1x == [13107] * 5 + [0xFFFF] * 15


def mean_period(times: Sequence[float]) -> float:
    """Over half of the samples, from each to its partner [s]: a read that is late counts little."""
    half = len(times) // 2
    return float(np.median(np.subtract(times[half : 2 * half], times[:half]))) / half


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_five_seconds_at_1_khz(volts, recording, dbc) -> None:
    """Expected: no frame lost, counters in step, mean period 1 ms within 0.1 %."""
    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        host.pump(until=lambda: any(f.id == 0x110 for f in host.frames))
        host.pump(5.0)
        host.close()
    parts = (0x110, 0x111, 0x112) if dbc == "instrument" else (0x110,)
    of_part = {i: [f.data for f in host.frames if f.id == i] for i in parts}
    modulus = 15 if dbc == "instrument" else 256
    for part in parts:
        counters = [d[1] & 15 if dbc == "instrument" else d[2] for d in of_part[part]]
        assert counters == [k % modulus for k in range(len(counters))]
    times = [t for t, f in zip(host.times, host.frames, strict=True) if f.id == 0x110]
    period = mean_period(times)
    print(f"\n{dbc}: {len(times)} samples, mean period {1e3 * period:.5f} ms")
    assert len(times) >= 4990
    assert period == pytest.approx(1e-3, rel=1e-3)
    assert board.summary["unsent"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("drift", [-8000.0, 8000.0])
def test_a_clock_that_drifts(recording, drift) -> None:
    with FirmwareBoard(recording, loop=True, drift=drift) as board:
        host = Host(board.link)
        host.pump(until=lambda: any(f.id == 0x110 for f in host.frames))
        host.pump(3.0)
        host.close()
    times = [t for t, f in zip(host.times, host.frames, strict=True) if f.id == 0x110]
    period = mean_period(times)
    assert period == pytest.approx(1e-3 / (1 + drift * 1e-6), rel=1e-3)
