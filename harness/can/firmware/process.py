"""The board's program as a process of this one."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmu_src.errors import SteadytipError
from harness.can.database import load
from harness.can.firmware.build import build_board
from harness.common.processes import end_process

__all__ = ["CHANNELS", "FirmwareBoard", "fault_kinds", "write_samples"]

CHANNELS = tuple(
    signal.name.removeprefix("volts_")
    for message in load("instrument").messages
    if message.role == "sample"
    for signal in message.ports
    if signal.name.startswith("volts_")
)
"""Of a sample, in the order of its columns."""
_POLL = 0.002  # s
_START_TIMEOUT = 5.0  # s until the link is there
_END_TIMEOUT = 2.0  # s from asking to killing


@cache
def fault_kinds() -> dict[str, str]:
    """Kinds of faults that the board knows, each with what happens, in the program's own words.

    Raises:
        SteadytipError: the board cannot be built.
    """
    done = subprocess.run([build_board(), "--kinds"], capture_output=True, text=True, check=True)
    return dict(line.split("\t") for line in done.stdout.splitlines())


def write_samples(
    path: Path,
    volts: ArrayLike,
    temperature: ArrayLike | None = None,
    field_new: ArrayLike | None = None,
) -> Path:
    """Write a recording for the board to play.

    Args:
        path: CSV file to write.
        volts: (samples, 9) of the channels in the order of `CHANNELS` [V]; NaN: not available.
        temperature: (samples,) of the board [degC]; 25 throughout if left out.
        field_new: (samples,) whether the magnetometer has measured; always if left out.

    Returns:
        The path.

    Raises:
        SteadytipError: the voltages are not nine to a sample.
    """
    channels = np.asarray(volts, dtype=float)
    if channels.ndim != 2 or channels.shape[1] != len(CHANNELS):
        raise SteadytipError(
            f"{path}: volts have the shape {channels.shape}, they need (samples, {len(CHANNELS)}): "
            f"{', '.join(CHANNELS)}"
        )
    columns = [(f"volts_{c}", "%.7f", volt) for c, volt in zip(CHANNELS, channels.T, strict=True)]
    optional = ("temperature", "%.2f", temperature), ("field_new", "%d", field_new)
    columns += [(n, form, np.asarray(v, float)) for n, form, v in optional if v is not None]
    names, forms, values = zip(*columns, strict=True)
    np.savetxt(path, np.column_stack(values), forms, ",", header=",".join(names), comments="")
    return path


class FirmwareBoard:
    """Starts the board, waits for its link, and ends it in order.

        with FirmwareBoard(samples, faults=["drop:0.01@2-4"], seed=1) as board:
            bus = can.Bus(interface="slcanbulk", channel=str(board.link))
            ...
        board.log["volts_1"]

    Attributes:
        link: path of the terminal to open; a symbolic link.
    """

    def __init__(
        self,
        samples: Path,
        dbc: str = "instrument",
        *,
        link: Path | None = None,
        loop: bool = False,
        drift: float = 0.0,
        faults: Sequence[str] = (),
        seed: int = 0,
        log: bool = True,
        priority: int = 0,
        program: Path | None = None,
    ) -> None:
        """Say what to start; nothing runs yet.

        Args:
            samples: recording as `write_samples` writes it, 1 kHz.
            dbc: name of a shipped DBC file, or path of one with the same messages.
            link: where the terminal is to be found; in a folder of its own if left out.
            loop: play the recording again and again.
            drift: the board's clock runs fast by that much [ppm].
            faults: `KIND[/ID][:RATE][@START-END]` each; `fault_kinds` has the kinds.
            seed: of the faults.
            log: whether to log what is applied in each sample.
            priority: of SCHED_FIFO, 1 to 99, where the system allows it; 0: an ordinary process.
            program: instead of the one that `build_board` makes.
        """
        folder = Path(tempfile.mkdtemp(prefix="steadytip-board-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.link = link or folder / "line"
        self._log = folder / "log.csv" if log else None
        self._dbc, self._program = dbc, program
        self._arguments = ["--link", str(self.link), "--samples", str(samples)]
        self._arguments += ["--drift", str(drift), "--seed", str(seed), "--with-parent"]
        self._arguments += ["--loop"] * loop
        self._arguments += ["--priority", str(priority)] * bool(priority)
        self._arguments += ["--log", str(self._log)] if self._log else []
        for fault in faults:
            self._arguments += ["--fault", fault]
        self._process: subprocess.Popen[str] | None = None
        self._summary = self._errors = ""

    def start(self) -> None:
        """Start the program and wait until its terminal is there.

        Raises:
            SteadytipError: it cannot be built, or ends, with what it says; or it takes too long.
        """
        program = self._program or build_board(self._dbc)
        # A link that another run has left must not pass for this one's.
        if self.link.is_symlink():
            self.link.unlink()
        self._process = subprocess.Popen(
            [program, *self._arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for whoever started it
        )
        end = time.monotonic() + _START_TIMEOUT
        while not self.link.exists():
            self.check()
            if time.monotonic() > end:
                self.stop()
                raise SteadytipError(f"the board did not make its link {self.link} in time")
            time.sleep(_POLL)

    @property
    def is_running(self) -> bool:
        """True while the process is there."""
        return self._process is not None and self._process.poll() is None

    def check(self) -> None:
        """See whether the program has died.

        Raises:
            SteadytipError: it ended by a mistake or a signal; with what it says.
        """
        if self._process is not None and self._process.poll() not in (None, 0):
            code, errors = self._process.returncode, self._collected()
            raise SteadytipError(f"the board ended with status {code}: {errors or 'no word'}")

    def _collected(self) -> str:
        """Return what the ended process wrote to standard error, and keep its summary."""
        assert self._process is not None
        if self._process.stdout is None or not self._process.stdout.closed:
            self._summary, self._errors = self._process.communicate()
        return self._errors.strip()

    def wait(self, timeout: float) -> None:
        """Wait until the program ends by itself, after the recording's end.

        Args:
            timeout: [s].

        Raises:
            SteadytipError: it goes on, or ended by a mistake.
        """
        assert self._process is not None
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise SteadytipError(f"the board still runs after {timeout:g} s") from None
        self.check()

    def stop(self) -> None:
        """End the program: asked first, killed if it does not listen. Safe to call again."""
        if self._process is None:
            return
        end_process(self._process, _END_TIMEOUT)
        self._collected()

    @property
    def log(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the log, one value per sample, once the program has ended.

        `sample`; `volts_1..3` [V] and `mode` as applied from that sample on; and how much has gone
        wrong until then: frames with a wrong `crc`, `length` or `range`, `repeated`, `lost` or out
        of `sequence`, with `unknown` id; events of `timeout` and `heartbeat`.

        Raises:
            SteadytipError: there is no log.
        """
        if self._log is None or not self._log.is_file():
            raise SteadytipError("this board keeps no log, or has not run")
        with self._log.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            rows = np.loadtxt(file, delimiter=",", ndmin=2).reshape(-1, len(names))
        return dict(zip(names, rows.T, strict=True))

    @property
    def summary(self) -> dict[str, int]:
        """`samples` sent, frames `unsent` because the host did not read, `latest_us` wake-up [us].

        Raises:
            SteadytipError: the program has not ended, or not in order.
        """
        try:
            found: dict[str, int] = json.loads(self._summary)
        except json.JSONDecodeError:
            raise SteadytipError("the board has not ended in order, and gives no summary") from None
        return found

    def __enter__(self) -> Self:
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.stop()
        if error is None:
            self.check()
