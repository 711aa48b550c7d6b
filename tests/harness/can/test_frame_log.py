"""Logs of raw frames: what goes in comes out, and other tools read them."""

import can
import pytest

from fmu_src.errors import SteadytipError
from harness.can.frame_log import BUS, FrameLog, read_log
from harness.common.errors import FaultError


def message(time: int, **more) -> can.Message:
    given = {"arbitration_id": 0x110, "is_extended_id": False, "data": b"\x01\x02\x03"} | more
    return can.Message(timestamp=time, **given)


BEGIN = 1_795_888_278_868_997
ENTRIES = [
    message(BEGIN),
    message(BEGIN + 17, is_rx=False, arbitration_id=0xA0, data=bytes(8)),
    message(BEGIN + 1003, is_fd=True, data=bytes(32), bitrate_switch=True),
    message(BEGIN + 1003, is_extended_id=True, arbitration_id=0x1ABCDEF0),
    message(BEGIN + 2500, is_remote_frame=True, data=None, dlc=3),
]


@pytest.mark.parametrize("name", ["frames.log", "frames.blf"])
def test_frames_and_ticks_come_back_to_the_microsecond(name, tmp_path) -> None:
    log = FrameLog(tmp_path / name)
    log.frame(message(BEGIN))
    log.tick(BEGIN + 5, b"\x01\x00\x00\x00\x01\x00\x02\x01")
    for entry in ENTRIES[1:]:
        log.frame(
            message(
                entry.timestamp,
                arbitration_id=entry.arbitration_id,
                is_extended_id=entry.is_extended_id,
                is_fd=entry.is_fd,
                is_rx=entry.is_rx,
                bitrate_switch=entry.bitrate_switch,
                is_remote_frame=entry.is_remote_frame,
                data=None if entry.is_remote_frame else entry.data,
                dlc=entry.dlc,
            )
        )
    log.flush()
    log.close()
    first, tick, *rest = read_log(tmp_path / name)
    assert (tick.time, tick.tick) == (BEGIN + 5, b"\x01\x00\x00\x00\x01\x00\x02\x01")
    for entry, wanted in zip([first, *rest], ENTRIES, strict=True):
        got = entry.message
        assert entry.time == wanted.timestamp
        assert entry.was_sent is not wanted.is_rx
        for name in ("arbitration_id", "is_extended_id", "is_fd", "is_remote_frame"):
            assert getattr(got, name) == getattr(wanted, name), name
        if not wanted.is_remote_frame:
            assert bytes(got.data) == bytes(wanted.data)


def test_candump_s_text_is_that_of_can_utils(tmp_path) -> None:
    log = FrameLog(tmp_path / "frames.log")
    log.frame(message(BEGIN))
    log.close()
    (line,) = (tmp_path / "frames.log").read_text().splitlines()
    assert line.startswith(f"(1795888278.868997) {BUS} 110#010203")


@pytest.mark.parametrize("name", ["frames.log", "frames.blf"])
def test_a_full_disk_is_told(name, tmp_path) -> None:
    (tmp_path / name).symlink_to("/dev/full")

    def fill() -> None:
        log = FrameLog(tmp_path / name)
        for k in range(100_000):
            log.frame(message(BEGIN + k))
        log.close()

    with pytest.raises(FaultError, match="No space left"):
        fill()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("frames.log", b"(12.5) can0 110#0102\n(12.6) can0 nonsense\n", "after 1 frames"),
        ("frames.log", b"\xff\xfe\x00", "cannot be read"),
        ("frames.blf", b"LOGGxxxx", "cannot be read"),
        ("frames.txt", b"", "give one that ends in .log or .blf"),
        ("frames.mp3", None, "does not exist"),
    ],
)
def test_a_log_that_is_none(name, content, words, tmp_path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SteadytipError) as raised:
        list(read_log(path))
    assert words in str(raised.value)


def test_an_empty_log_has_no_entries(tmp_path) -> None:
    (tmp_path / "frames.log").write_bytes(b"")
    assert list(read_log(tmp_path / "frames.log")) == []
