"""MF4: what asammdf and python-can read back is what the run has."""

import json
import random
import sys
import xml.sax.saxutils as xml
from pathlib import Path

import can
import numpy as np
import pytest
from asammdf import MDF
from typer.testing import CliRunner

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.can.codec import Codec
from harness.can.database import load
from harness.can.frame_log import FrameLog, read_log
from harness.cli.main import app
from harness.results.conversion import FRAMES, SIGNALS, convert
from tests.harness.hil.synthetic import record

BEGUN = 1_700_000_000_000_000  # us


def a_log(path: Path, database) -> list[can.Message]:
    """Samples of the board with a tick after each, and one of every other kind of frame."""
    chance = random.Random(5)
    codecs = {m.name: Codec(m) for m in database.messages}
    frames = []
    for index in range(200):
        at = BEGUN + 1000 * index
        for offset, name in enumerate(("SensorsA", "SensorsB", "SensorsM")):
            message = codecs[name].message
            values = [chance.uniform(*s.range) for s in message.signals]
            data = codecs[name].encode(values, index % 15)
            frames.append(
                can.Message(
                    timestamp=at + 20 * offset,
                    arbitration_id=message.id,
                    is_extended_id=False,
                    data=data,
                )
            )
        command = codecs["PiezoCommand"].message
        data = codecs["PiezoCommand"].encode([2.0, 10.0, 20.0, 30.0], index % 15)
        frames.append(
            can.Message(
                timestamp=at + 300,
                arbitration_id=command.id,
                is_extended_id=False,
                data=data,
                is_rx=False,
            )
        )
    late = BEGUN + 200_000
    frames += [
        can.Message(timestamp=late, arbitration_id=0x1ABCDEF, is_extended_id=True, data=b"\x01"),
        can.Message(
            timestamp=late + 1, arbitration_id=0x123, is_extended_id=False, is_fd=True,
            bitrate_switch=True, data=bytes(range(48)), dlc=48,
        ),
        can.Message(
            timestamp=late + 2, arbitration_id=0x110, is_extended_id=False, is_remote_frame=True,
            dlc=3,
        ),
        can.Message(timestamp=late + 3, arbitration_id=0x40, is_error_frame=True, data=bytes(8)),
    ]  # fmt: skip
    log = FrameLog(path)
    for index, frame in enumerate(frames):
        log.frame(can.Message(**{k: getattr(frame, k) for k in KEPT}))
        if index % 4 == 3 and index < 800:
            log.tick(BEGUN + 1000 * (index // 4) + 250, bytes(8))
    log.close()
    return frames


KEPT = (
    "timestamp", "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "dlc",
    "data", "is_fd", "is_rx", "bitrate_switch",
)  # fmt: skip


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    """A run with a log, the frames of that, and the files that were made of it."""
    folder = tmp_path_factory.mktemp("run")
    result = record(folder, ["drop:0.1"], ticks=200, hil={"log": "frames.log"})
    frames = a_log(folder / "frames.log", load("instrument"))
    return result, frames, convert(folder, folder / "mf4")


def test_signals_come_back_with_values_units_and_descriptions(converted):
    result, _, (signals, _) = converted
    assert signals.name == SIGNALS
    with MDF(signals) as mdf:
        assert len(mdf.groups) == 1
        names = {name for name in mdf.channels_db if name != "time"}
        assert names == set(result.table.column_names) - {"time"}
        for field in result.table.schema:
            if field.name == "time":
                continue
            channel = mdf.get(field.name)
            values = result.table.column(field.name).to_numpy()
            np.testing.assert_array_equal(channel.samples, values)
            np.testing.assert_array_equal(channel.timestamps, result.time)
            assert channel.unit == field.metadata[b"unit"].decode()
            assert channel.comment == field.metadata[b"description"].decode()
        assert mdf.get("sensors.age").unit == "s"
        assert mdf.get("sensors.sample").samples.dtype == np.int32


def test_a_file_of_signals_says_what_run_it_is_and_when_it_began(converted):
    result, _, (signals, _) = converted
    with MDF(signals) as mdf:
        assert mdf.header.start_time.timestamp() == pytest.approx(1e-6 * BEGUN + 250e-6, abs=2e-6)
        text = xml.unescape(mdf.header.comment, {"&quot;": '"'})
    metadata = json.loads(text[text.index("{") : text.rindex("}") + 1])
    assert metadata["title"] == result.metadata.title
    assert metadata["hil"]["counts"] == result.metadata.hil["counts"]


def test_python_can_reads_every_frame_back(converted):
    """Ticks are none; candump's text itself forgets the length of a remote frame."""
    result, frames, (_, path) = converted
    assert path.name == FRAMES
    logged = [e.message for e in read_log(result.path / "frames.log") if e.tick is None]
    with can.MF4Reader(path) as reader:
        read = list(reader)
    assert len(read) == len(logged) == len(frames)
    for frame, log, back in zip(frames, logged, read, strict=True):
        assert back.timestamp == pytest.approx(1e-6 * frame.timestamp, abs=1e-6)
        plain = not (frame.is_error_frame or frame.is_remote_frame)
        for key in KEPT[1:]:
            assert getattr(back, key) == getattr(frame if plain else log, key), (key, frame)


def test_asammdf_takes_signals_out_of_the_frames_by_the_dbc(converted):
    _, frames, (_, path) = converted
    database = load("instrument")
    (message,) = [m for m in database.messages if m.name == "SensorsB"]
    decode = Codec(message).decode
    sent = [decode(bytes(f.data))[0] for f in frames if f.arbitration_id == message.id]
    with MDF(path) as mdf:
        out = mdf.extract_bus_logging({"CAN": [(str(database.path), 0)]})
    for index, signal in enumerate(message.signals):
        channel = out.get(signal.name)
        np.testing.assert_allclose(channel.samples, [values[index] for values in sent], rtol=1e-12)
        assert channel.unit == signal.unit
    assert channel.timestamps[1] - channel.timestamps[0] == pytest.approx(1e-3, abs=1e-6)


def test_the_command_converts_a_run_without_a_bus(write_scenario, tmp_path, monkeypatch):
    out = tmp_path / "out"
    st.run(write_scenario("[part.a]\nfmu = PROBE\n"), out=out, report=False)
    done = CliRunner().invoke(app, ["convert", str(out)])
    assert done.exit_code == 0
    assert done.output.replace("\n", "").endswith(SIGNALS)
    assert sorted(path.name for path in out.glob("*.mf4")) == [SIGNALS]
    with MDF(out / SIGNALS) as mdf:
        assert mdf.get("a.y").unit == "m"


@pytest.mark.parametrize("gone", ["frames.log", "results.parquet"])
def test_what_is_missing_is_named(gone, tmp_path):
    record(tmp_path, ticks=50, hil={"log": "frames.log"})
    (tmp_path / gone).unlink(missing_ok=True)
    with pytest.raises(SteadytipError, match=gone):
        convert(tmp_path)
    assert not list(tmp_path.glob("*.mf4*"))


def test_without_asammdf_it_says_what_to_install(tmp_path, monkeypatch):
    record(tmp_path, ticks=50)
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(SteadytipError, match=r"pip install 'steadytip\[mf4\]'"):
        convert(tmp_path)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    record(tmp_path / "run", ticks=50)
    (tmp_path / "file").touch()
    with pytest.raises(SteadytipError, match=r"file/results\.mf4 cannot be written"):
        convert(tmp_path / "run", tmp_path / "file")
