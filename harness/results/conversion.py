"""A run for other tools: signals and raw frames as ASAM MDF 4 (MF4).

`results.mf4` has one group of channels on the time of the run, each with unit and description, and
the metadata of the run as its comment. `frames.mf4` is a bus log as ASAM's standard for it says;
what a DBC file says of the frames, tools read from there. The files begin at the first tick and at
the first frame, so that a tool can lay one over the other; of a run without a log it is known only
when it was written.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.can.frame_log import read_log
from harness.common.files import reason, replacing
from harness.results.result import read

if TYPE_CHECKING:
    from harness.results.result import Result

__all__ = ["FRAMES", "SIGNALS", "convert"]

SIGNALS, FRAMES = "results.mf4", "frames.mf4"
_VERSION = "4.10"
_EXTENDED = 0x1FFFFFFF
_DATA, _ERROR, _REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
_FIELDS: Mapping[str, Any] = {
    "BusChannel": "<u1",
    "ID": "<u4",
    "IDE": "<u1",
    "DLC": "<u1",
    "DataLength": "<u1",
    "DataBytes": "(64,)u1",
    "Dir": "<u1",
    "EDL": "<u1",
    "BRS": "<u1",
    "ESI": "<u1",
}
"""Of a frame in a bus log (ASAM MDF, associated standard for bus logging)."""


def convert(run: str | os.PathLike[str], out: Path | None = None) -> list[Path]:
    """Write a run as MF4.

    Args:
        run: its folder, or its record.
        out: folder of the files; that of the run by default.

    Returns:
        The files: signals, and frames where the run has a log of them.

    Raises:
        SteadytipError: there is no record, it cannot be read, asammdf is not installed, or a file
            cannot be written.
    """
    result = read(run)
    folder = out or result.path
    log = (result.metadata.hil or {}).get("log")
    entries = [*read_log(result.path / log)] if log is not None else []
    ticks = [entry.time * 1e-6 for entry in entries if entry.tick is not None]
    written = [folder / SIGNALS]
    with _file(written[0], ticks[0] if ticks else result.file.stat().st_mtime) as mdf:
        _signals(mdf, result)
    frames = [entry.message for entry in entries if entry.tick is None]
    if frames:
        written.append(folder / FRAMES)
        with _file(written[1], frames[0].timestamp * 1e-6) as mdf:
            for kind, name in enumerate((_DATA, _ERROR, _REMOTE)):
                _frames(mdf, name, [frame for frame in frames if _kind(frame) == kind])
    return written


@contextmanager
def _file(target: Path, begun: float) -> Iterator[Any]:
    """Yield an MDF file that is written when everything is in it.

    Args:
        target: its name.
        begun: what its times are counted from [s].
    """
    try:
        from asammdf import MDF
    except ImportError:
        raise SteadytipError("MF4 needs asammdf: pip install 'steadytip[mf4]'") from None
    with MDF(version=_VERSION) as mdf:
        mdf.header.start_time = datetime.fromtimestamp(begun, UTC)
        yield mdf
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with replacing(target) as part:
                # It gives a file an ending of its own unless it has one that it knows.
                whole = part.with_suffix(target.suffix)
                mdf.save(whole, overwrite=True, compression=2).replace(part)
        except OSError as error:
            raise SteadytipError(f"{target} cannot be written: {reason(error)}") from None


def _signals(mdf: Any, result: Result) -> None:
    from asammdf import Signal

    time = result.time
    channels = []
    for field in result.table.schema:
        if field.name == "time":
            continue
        values = result.table.column(field.name).to_numpy()
        told = {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}
        channels.append(
            Signal(
                samples=values.astype("u1") if values.dtype == bool else values,
                timestamps=time,
                name=field.name,
                unit=told.get("unit", ""),
                comment=told.get("description", ""),
            )
        )
    mdf.header.comment = result.metadata.json_text()
    mdf.append(channels, acq_name="signals", comment=result.metadata.title, common_timebase=True)


def _kind(frame: Any) -> int:
    return 1 if frame.is_error_frame else 2 if frame.is_remote_frame else 0


def _frames(mdf: Any, name: str, frames: Sequence[Any]) -> None:
    """One kind of frames."""
    from asammdf import Signal
    from asammdf.blocks.v4_blocks import SourceInformation
    from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS
    from can.util import len2dlc

    begun = mdf.header.start_time.timestamp()
    absent = {"DataBytes", "DataLength", "EDL", "BRS", "ESI"} if name == _REMOTE else set()
    fields = [(f"{name}.{key}", of) for key, of in _FIELDS.items() if key not in absent]
    samples = np.zeros(len(frames), dtype=fields)
    for at, frame in enumerate(frames):
        row = {
            "BusChannel": 1,
            "ID": frame.arbitration_id & _EXTENDED,
            "IDE": frame.is_extended_id,
            "DLC": len2dlc(frame.dlc),
            "DataLength": len(frame.data),
            "Dir": not frame.is_rx,
            "EDL": frame.is_fd,
            "BRS": frame.bitrate_switch,
            "ESI": frame.error_state_indicator,
        }
        record = samples[at]
        for key, value in row.items():
            if key not in absent:
                record[f"{name}.{key}"] = value
        if not absent:
            record[f"{name}.DataBytes"][: len(frame.data)] = np.frombuffer(frame.data, "u1")
    mdf.append(
        Signal(
            samples=samples,
            timestamps=np.array([frame.timestamp * 1e-6 for frame in frames]) - begun,
            name=name,
            source=SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN),
        )
    )
