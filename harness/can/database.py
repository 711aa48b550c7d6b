"""The messages of a bus, read from a DBC file and checked.

A DBC file says how the bits lie; what it has no words for stands in attributes:

| attribute | of | meaning |
| --- | --- | --- |
| `Baudrate`, `BaudrateCANFD` | bus | bit rates of arbitration and data phase [bit/s] |
| `RampRate` | bus | how fast a command goes to rest, on either side [V/s] |
| `Role` | message | sample, command, feedback, status, heartbeat, other |
| `GenMsgCycleTime`, `Timeout` | message | [ms] |
| `E2EProfile`, `E2EDataID` | message | AUTOSAR end-to-end protection: none, P01, P05 |

Frames of the role `sample` that carry the same counter are one sample. Some signals have a meaning
by their name, all others are ports of the part:

| signal | meaning |
| --- | --- |
| `crc`, `counter` | of the protection, where its profile wants them |
| `sample` | samples since the board began; `counter` of a classic sample frame is its remainder |
| `board_time` | time of the sample by the board's clock [s], wraps round |
| `echo` | sample that a command was computed from |
| `mode` | what the board has to do: `MODES` |
| `*_state` | of a heartbeat: `OPERATIONAL` or another state of CANopen |

A raw value that the file calls "not available" means just that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from fmu_src.errors import SteadytipError
from fmu_src.kit.units import exponents
from harness.common.errors import ProblemsError, nearest
from harness.common.files import is_path

__all__ = ["HOLD", "OFF", "OPERATIONAL", "RUN", "Database", "Message", "Signal", "load"]

OFF, HOLD, RUN = range(3)
"""Modes of a command."""
OPERATIONAL, PRE_OPERATIONAL, STOPPED = 5, 127, 4
"""States of a node, as CANopen numbers them."""

_SHIPPED = files("harness.can") / "dbc"
_ROLES = ("other", "sample", "command", "feedback", "status", "heartbeat")
_MISSING = "not available"
_PLACES = {"P01": {"crc": (0, 8), "counter": (8, 4)}, "P05": {"crc": (0, 16), "counter": (16, 8)}}
"""Start and length of what a profile needs, in bits."""
PROTECTION = ("crc", "counter")
"""Signals that belong to the protection."""
INTERNAL = (*PROTECTION, "sample", "echo", "mode", "board_time")
"""Signals that are no ports."""


@dataclass(frozen=True)
class Signal:
    """One number in a message: value = scale raw + offset.

    Attributes:
        shift: of the raw value in the frame, read as one integer [bit].
        little: byte order of that integer.
        low, high: raw values that are in range.
        missing: raw value for "not available"; None if there is none.
    """

    name: str
    shift: int
    length: int
    little: bool
    signed: bool
    scale: float
    offset: float
    low: int
    high: int
    missing: int | None
    unit: str
    description: str

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest value."""
        ends = (self.low * self.scale + self.offset, self.high * self.scale + self.offset)
        return min(ends), max(ends)

    @property
    def is_whole(self) -> bool:
        """True if its values are integers without a unit."""
        return self.scale == 1.0 and self.offset == 0.0 and not self.unit


@dataclass(frozen=True)
class Message:
    """One frame.

    Attributes:
        id: 11 bit, or 29 where `extended`.
        length: [byte].
        sender: node.
        cycle: [s], 0: none.
        timeout: [s], infinite: none.
        profile: `P01`, `P05` or `none`.
        data_id: of the protection.
        signals: all but `crc` and `counter`.
    """

    name: str
    id: int
    extended: bool
    is_fd: bool
    length: int
    sender: str
    role: str
    cycle: float
    timeout: float
    profile: str
    data_id: int
    signals: tuple[Signal, ...]

    @property
    def modulus(self) -> int:
        """Number of values of the counter; 0 without protection."""
        return {"P01": 15, "P05": 256}.get(self.profile, 0)

    @property
    def ports(self) -> tuple[Signal, ...]:
        """Signals that a part has as ports."""
        return tuple(s for s in self.signals if s.name not in INTERNAL)


@dataclass(frozen=True)
class Database:
    """All messages of a bus.

    Attributes:
        name: of the file.
        nodes: in the file's order.
        bitrate, data_bitrate: [bit/s]; the same for a classic bus.
        ramp_rate: [V/s].
    """

    name: str
    path: Path
    nodes: tuple[str, ...]
    messages: tuple[Message, ...]
    bitrate: float
    data_bitrate: float
    ramp_rate: float

    def sent_by(self, node: str) -> tuple[Message, ...]:
        """Messages of a node."""
        return tuple(m for m in self.messages if m.sender == node)

    def received_by(self, node: str) -> tuple[Message, ...]:
        """Messages of all other nodes."""
        return tuple(m for m in self.messages if m.sender != node)

    @property
    def is_fd(self) -> bool:
        """True if any frame is one of CAN FD."""
        return any(m.is_fd for m in self.messages)

    def seconds(self, message: Message) -> float:
        """Time that a frame of it holds the bus at most [s]."""
        return frame_time(message.length, message.is_fd, self.bitrate, self.data_bitrate)


def frame_time(
    length: int, is_fd: bool, bitrate: float, data_bitrate: float, extended: bool = False
) -> float:
    """Time that a frame holds the bus, with as many stuff bits as there can be [s] (ISO 11898-1).

    Args:
        length: of the data [byte].
        is_fd: of CAN FD, with the bit rate switched.
        bitrate: [bit/s].
        data_bitrate: of the data phase [bit/s].
        extended: 29 bit of identifier.
    """
    more = 20 if extended else 0
    if not is_fd:
        stuffed = 34 + more + 8 * length
        return (stuffed + (stuffed - 1) // 4 + 13) / bitrate
    slow = 17 + more
    fast = 5 + 8 * length
    check = 4 + (17 if length <= 16 else 21)
    data_phase = fast + (fast - 1) // 4 + check + -(-check // 4)
    return (slow + (slow - 1) // 4 + 13) / bitrate + data_phase / data_bitrate


def load(dbc: str) -> Database:
    """Read and check a DBC file.

    Args:
        dbc: path, or name of a shipped one.

    Raises:
        ProblemsError: everything that is wrong with it.
        SteadytipError: it does not exist, or is no DBC file, or cantools is not there.
    """
    try:
        import cantools
    except ImportError:
        raise SteadytipError(
            "boards on a CAN bus need cantools and python-can: pip install 'steadytip[hil]'"
        ) from None
    path = _locate(dbc)
    try:
        found = cantools.database.load_file(str(path), database_format="dbc", strict=True)
    except (cantools.database.Error, UnicodeDecodeError, OSError) as error:
        raise SteadytipError(f"{path} is no DBC file that can be used: {error}") from None
    attributes = {n: a.value for n, a in (found.dbc.attributes or {}).items()}
    bitrate = float(attributes.get("Baudrate", 1e6))
    problems: list[str] = []
    messages = tuple(_message(m, problems) for m in found.messages)
    problems += _clashes(messages)
    if problems:
        raise ProblemsError(path.name, problems)
    return Database(
        name=path.stem,
        path=path,
        nodes=tuple(node.name for node in found.nodes),
        messages=messages,
        bitrate=bitrate,
        data_bitrate=float(attributes.get("BaudrateCANFD", bitrate)),
        ramp_rate=float(attributes.get("RampRate", math.inf)),
    )


def _locate(dbc: str) -> Path:
    if is_path(dbc):
        path = Path(dbc)
        if not path.is_file():
            raise SteadytipError(f"DBC file {path} does not exist")
        return path
    known = {Path(str(item)).stem: Path(str(item)) for item in _SHIPPED.iterdir()}
    if dbc not in known:
        raise SteadytipError(
            f"no DBC file is called '{dbc}'; {nearest(dbc, known)} "
            "One of your own is given by its path, ending in .dbc."
        )
    return known[dbc]


def _attribute(message: Any, name: str, default: Any) -> Any:
    attribute = message.dbc.attributes.get(name)
    return default if attribute is None else attribute.value


def _choice(message: Any, name: str, choices: Sequence[str], problems: list[str]) -> str:
    """Return an attribute that is one of several words, written as a number or as itself."""
    value = _attribute(message, name, choices[0])
    if isinstance(value, int) and 0 <= value < len(choices):
        return choices[value]
    if value in choices:
        return str(value)
    problems.append(f"message '{message.name}': {name} = {value!r} is none of {', '.join(choices)}")
    return choices[0]


def _message(m: Any, problems: list[str]) -> Message:
    where = f"message '{m.name}'"
    if m.is_multiplexed():
        problems.append(f"{where} is multiplexed, which is not supported: give each part an id")
    if len(m.senders) != 1:
        problems.append(f"{where} has {len(m.senders)} senders; it needs one")
    profile = _choice(m, "E2EProfile", ("none", "P01", "P05"), problems)
    for name, place in _PLACES.get(profile, {}).items():
        signal = next((s for s in m.signals if s.name == name), None)
        if signal is None or (signal.start, signal.length) != place:
            problems.append(
                f"{where}: profile {profile} needs a signal '{name}' of {place[1]} bits at bit "
                f"{place[0]}"
            )
    timeout = _attribute(m, "Timeout", 0)
    return Message(
        name=m.name,
        id=m.frame_id,
        extended=m.is_extended_frame,
        is_fd=m.is_fd,
        length=m.length,
        sender=m.senders[0] if m.senders else "",
        role=_choice(m, "Role", _ROLES, problems),
        cycle=(m.cycle_time or 0) * 1e-3,
        timeout=timeout * 1e-3 if timeout else math.inf,
        profile=profile,
        data_id=_attribute(m, "E2EDataID", 0),
        signals=tuple(
            _signal(where, m.length, s, problems)
            for s in m.signals
            if not (profile in _PLACES and s.name in PROTECTION)
        ),
    )


def _signal(where: str, length: int, s: Any, problems: list[str]) -> Signal:
    what = f"{where}, signal '{s.name}'"
    if s.is_float:
        problems.append(f"{what} is a float, which is not supported: give it a scale")
    try:
        exponents(s.unit or "1")
    except SteadytipError as error:
        problems.append(f"{what}: {error}")
    little = s.byte_order == "little_endian"
    # Of a big-endian signal DBC gives the most significant bit, bytes numbered from the other end.
    from_end = 8 * length - (8 * (s.start // 8) + 7 - s.start % 8) - s.length
    shift = s.start if little else from_end
    scale, offset = float(s.conversion.scale), float(s.conversion.offset)
    least, most = (
        (-(1 << s.length - 1), (1 << s.length - 1) - 1) if s.is_signed else (0, (1 << s.length) - 1)
    )
    ends = sorted(
        round((end - offset) / scale) if end is not None else raw
        for end, raw in ((s.minimum, least), (s.maximum, most))
    )
    missing = [raw for raw, text in (s.choices or {}).items() if str(text) == _MISSING]
    low, high = max(ends[0], least), min(ends[1], most)
    if missing and low <= missing[0] <= high:
        problems.append(f"{what}: {missing[0]} is not available and in range at once")
    return Signal(
        name=s.name,
        shift=shift,
        length=s.length,
        little=little,
        signed=s.is_signed,
        scale=scale,
        offset=offset,
        low=low,
        high=high,
        missing=missing[0] if missing else None,
        unit=s.unit or "",
        description=s.comment or "",
    )


def _clashes(messages: Sequence[Message]) -> Iterator[str]:
    """Names that would become one port, and samples whose parts do not count alike."""
    seen: dict[tuple[str, str], str] = {}
    for message in messages:
        for signal in message.ports:
            other = seen.setdefault((message.sender, signal.name), message.name)
            if other != message.name:
                yield f"signal '{signal.name}' is in '{other}' and in '{message.name}'"
    groups: Mapping[str, list[Message]] = {
        sender: [m for m in messages if m.sender == sender and m.role == "sample"]
        for sender in {m.sender for m in messages}
    }
    for parts in groups.values():
        if any(m.profile == "none" for m in parts):
            yield "messages of the role sample need a profile: their counters tell them apart"
        elif len({m.modulus for m in parts}) > 1:
            yield f"{', '.join(m.name for m in parts)} are one sample and need one profile"
