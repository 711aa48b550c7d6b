"""Faults that the board injects, each as it shows on the line."""

import re
import time
from collections import Counter

import numpy as np
import pytest

from harness.can.fault_injection import KINDS
from harness.can.firmware import sources
from harness.can.firmware.process import FirmwareBoard, fault_kinds
from tests.harness.can.firmware.board import (
    COMMAND,
    FEEDBACK,
    HEARTBEAT,
    RUN,
    SAMPLES,
    STATUS,
    Frame,
    Host,
    clean_frames,
    command,
    database,
    played,
    protected,
    sample_frames,
    while_sampling,
)
from tests.waiting import wait_until

FROM, TO = 50, 250
WHEN = f"@{FROM * 1e-3}-{TO * 1e-3}"


def test_kinds_are_those_of_the_issue() -> None:
    assert list(fault_kinds()) == [
        *("drop", "delay", "duplicate", "reorder", "corrupt", "freeze", "stick", "wrong-length"),
        *("unknown", "babble", "silence", "bus-off", "unplug", "unavailable"),
    ]
    assert set(fault_kinds()) == set(KINDS), "those of the board in Python"
    header = sources("instrument")["faults.h"]
    assert re.findall(r'X\(\w+, "([\w-]+)"', header) == list(fault_kinds())


def check_drop(seen: list[Frame], clean: list[list[Frame]]) -> None:
    rest = iter(f for frames in clean for f in frames)
    assert all(frame in rest for frame in seen), "not the same frames in the same order"
    inside = sum(map(len, clean[FROM:TO]))
    lost = sum(map(len, clean)) - len(seen)
    assert 0.1 * inside < lost < 0.3 * inside


def check_delay(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [(k, f) for k, frames in enumerate(clean) for f in frames]
    assert Counter(seen) == Counter(f for _, f in flat)
    # Time on the wire goes by the frames that are not late: their sample is the newest so far.
    home: dict[Frame, list[int]] = {}
    for k, f in flat:
        home.setdefault(f, []).append(k)
    now, lags = 0, []
    for frame in seen:
        k = home[frame].pop(0)
        now = max(now, k)
        lags.append(now - k)
    assert max(lags) == 5
    assert np.mean(np.array(lags) > 0) > 0.05


def check_duplicate(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    once = [f for i, f in enumerate(seen) if i == 0 or f != seen[i - 1]]
    assert once == flat
    assert 0.1 < (len(seen) - len(flat)) / sum(map(len, clean[FROM:TO])) < 0.3


def check_reorder(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    swaps, i = 0, 0
    while i < len(flat):
        if seen[i] == flat[i]:
            i += 1
            continue
        assert seen[i : i + 2] == [flat[i + 1], flat[i]]
        swaps, i = swaps + 1, i + 2
    assert swaps > 50


def check_corrupt(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    assert len(seen) == len(flat)
    bad = [(s, f) for s, f in zip(seen, flat, strict=True) if s != f]
    assert len(bad) > 50
    for s, f in bad:
        a, b = (int.from_bytes(x.data, "big") for x in (s, f))
        assert (a ^ b).bit_count() == 1
        assert s.id == HEARTBEAT or protected("instrument", s.id, s.data) != s.data
    assert seen[: 3 * FROM] == flat[: 3 * FROM]


def sensor_data(frames: list[Frame]) -> dict[int, list[bytes]]:
    return {i: [f.data for f in frames if f.id == i] for i in (0x110, 0x111, 0x112)}


def check_freeze(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    for i, frames in sensor_data(seen).items():
        assert [d[1] & 15 for d in frames] == [k % 15 for k in range(SAMPLES)]
        assert all(protected("instrument", i, d) == d for d in frames)
        frozen = [k for k in range(1, SAMPLES) if frames[k][2:] == frames[k - 1][2:]]
        assert 20 < len(frozen) < 60
        assert set(frozen) <= set(range(FROM, TO))
        good = set(range(SAMPLES)) - set(frozen)
        assert all(frames[k] == flat[i][k] for k in good)


def check_stick(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    for i, frames in sensor_data(seen).items():
        stuck = [k for k in range(1, SAMPLES) if frames[k] == frames[k - 1]]
        assert 20 < len(stuck) < 60
        assert set(stuck) <= set(range(FROM, TO))
        assert all(frames[k] == flat[i][k] for k in set(range(SAMPLES)) - set(stuck))


def check_length(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for frames in clean for f in frames]
    assert [f.id for f in seen] == [f.id for f in flat]
    bad = [(s, f) for s, f in zip(seen, flat, strict=True) if s != f]
    assert len(bad) > 50
    assert all(len(s.data) != len(f.data) and len(s.data) <= 8 for s, f in bad)


def check_unknown(seen: list[Frame], clean: list[list[Frame]]) -> None:
    known = {m.frame_id for m in database("instrument").messages}
    foreign = [f for f in seen if f.id not in known]
    assert [f for f in seen if f.id in known] == [f for frames in clean for f in frames]
    assert len({f.id for f in foreign}) > 50


def check_babble(seen: list[Frame], clean: list[list[Frame]]) -> None:
    check_unknown(seen, clean)
    per_sample = np.diff([i for i, f in enumerate(seen) if f.id == 0x112])
    full = per_sample[FROM:TO] >= 8
    assert 0.1 < full.mean() < 0.3
    assert (per_sample[: FROM - 1] < 7).all()


def check_silence(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = [f for k, frames in enumerate(clean) if not FROM <= k < TO for f in frames]
    assert seen == flat


def check_unavailable(seen: list[Frame], clean: list[list[Frame]]) -> None:
    flat = sensor_data([f for frames in clean for f in frames])
    places = set()
    for i, frames in sensor_data(seen).items():
        assert all(protected("instrument", i, d) == d for d in frames)
        for k, (a, b) in enumerate(zip(frames, flat[i], strict=True)):
            for at in (2, 4, 6):
                if a[at : at + 2] != b[at : at + 2]:
                    assert a[at : at + 2] == b"\xff\xff"
                    assert FROM <= k < TO
                    places.add((i, at))
    assert len(places) == 1


CHECKS = {
    "drop:0.2": check_drop,
    "delay:0.2": check_delay,
    "duplicate:0.2": check_duplicate,
    "reorder:0.2": check_reorder,
    "corrupt:0.2": check_corrupt,
    "freeze:0.2": check_freeze,
    "stick:0.2": check_stick,
    "wrong-length:0.2": check_length,
    "unknown:0.2": check_unknown,
    "babble:0.2": check_babble,
    "silence": check_silence,
    "unavailable:0.5": check_unavailable,
}


def test_every_kind_has_a_check() -> None:
    kinds = {fault.partition(":")[0] for fault in CHECKS}
    assert kinds | {"bus-off", "unplug"} == set(fault_kinds())


@pytest.mark.parametrize("fault", CHECKS)
def test_fault_shows_as_it_should_and_again_from_its_seed(recording, volts, fault) -> None:
    """Expected: nothing outside its time; from the same seed the same frames, else others."""
    first, second, other = played(recording, [fault + WHEN], seeds=(3, 3, 4))
    assert first == second
    if ":" in fault:
        assert first != other
    clean = clean_frames("instrument", volts)
    CHECKS[fault](first, clean)
    before = sum(map(len, clean[:FROM]))
    assert first[:before] == [f for frames in clean[:FROM] for f in frames]


def test_fault_of_one_id_and_several_at_once(recording, volts) -> None:
    faults = [f"drop/0x701{WHEN}", f"drop/0x111{WHEN}", "corrupt/0x310"]
    [seen] = played(recording, faults)
    clean = [f for frames in clean_frames("instrument", volts) for f in frames]
    assert len(sensor_data(seen)[0x111]) == SAMPLES - (TO - FROM)
    assert sum(f.id == HEARTBEAT for f in seen) == 1  # of 0, 100 and 200 ms
    assert not {f for f in clean if f.id == STATUS} & set(seen)
    same = (0x110, 0x112, FEEDBACK)
    assert [f for f in seen if f.id in same] == [f for f in clean if f.id in same]


def test_fd_frames_of_wrong_length_are_frames_still(recording, volts) -> None:
    [seen] = played(recording, ["wrong-length:0.3"], dbc="instrument_fd")
    clean = [f for frames in clean_frames("instrument_fd", volts) for f in frames]
    lengths = {len(f.data) for s, f in zip(clean, seen, strict=True) if s != f}
    assert len(lengths) > 8
    assert max(lengths) == 64


def test_bus_off_is_silent_and_refuses_and_says_so(recording, volts) -> None:
    with FirmwareBoard(recording, faults=[f"bus-off{WHEN}"]) as board:
        host = Host(board.link)
        host.pump(until=lambda: "sb000255" in host.answers)
        host.answers.clear()
        host.write("F\r" + Frame(COMMAND, command("instrument", 0, RUN, 1, 1, 1)).line)
        host.pump(until=lambda: "\a" in host.answers)
        assert host.answers[0] == "FA4"
        assert "z" not in host.answers
        host.answers.clear()
        host.write("C\rO\rF\r")  # a host that restarts the controller is told again
        host.pump(until=lambda: "sb000255" in host.answers)
        assert host.answers[:3] == ["", "", "FA4"]
        host.pump(until=lambda: host.has_stopped)
        assert "sa000000" in host.answers
        host.answers.clear()
        host.write("F\r")
        host.pump(until=lambda: "F00" in host.answers)
        host.close()
    clean = clean_frames("instrument", volts)
    seen = while_sampling(host.frames)
    expected = [f for k, frames in enumerate(clean) if not FROM <= k < TO for f in frames]
    assert seen == expected
    assert (board.log["volts_1"] == 0).all(), "the command was heard"


def test_unplugged_and_back_behind_the_same_link(recording) -> None:
    with FirmwareBoard(recording, loop=True, faults=["unplug@0.05-0.15"]) as board:
        host = Host(board.link)
        terminal = str(board.link.readlink())
        with pytest.raises(OSError, match=r"no other end|Input/output error"):
            host.pump()
        gone = time.monotonic()
        assert not board.link.is_symlink()
        wait_until(board.link.exists, what="the link's return", pause=1e-3)
        away = time.monotonic() - gone
        back = Host(board.link)
        back.pump(until=lambda: sum(f.id == STATUS for f in back.frames) >= 1)
        status = next(f.data for f in back.frames if f.id == STATUS)
        for h in (host, back):
            h.close()
        assert terminal.startswith("/dev/pts/")
    assert 0.02 < away < 1.0
    assert int.from_bytes(status[2:6], "little") >= 200, "the board's time stood still"
    assert not board.link.exists()


def test_times_without_end_come_and_go_by_their_rate(recording, volts) -> None:
    """A rate makes episodes of 200 ms out of a fault that otherwise lasts."""
    [seen] = played(recording, ["silence:0.05@0.02-"], seeds=(3,))
    heard = sensor_data(seen)[0x110]
    sent = sensor_data([f for k, v in enumerate(volts) for f in sample_frames("instrument", k, v)])
    begin = next(k for k, data in enumerate(heard) if data != sent[0x110][k])
    assert 20 <= begin < 100
    again = sent[0x110][begin + 200 :]  # until the next episode
    assert len(heard) > begin + 10
    assert heard[begin:] == again[: len(heard) - begin]
