"""Packing and unpacking of frames by code that is generated from the messages.

    raw = round((value - offset) / scale),   value = scale raw + offset

For each message some lines of Python are written and compiled once, with every constant in place:
one `struct` call or one big integer, and the CRC as an exclusive-or of table entries, one table per
byte, because a CRC is linear in the bits of the frame.

| profile | CRC | over |
| --- | --- | --- |
| P01 | 8 bit, x^8 + x^4 + x^3 + x^2 + 1, start 0 | data id (low, high byte), bytes 1 to the end |
| P05 | 16 bit, x^16 + x^12 + x^5 + 1, start 0xFFFF | bytes 2 to the end, data id (low, high byte) |

Source: AUTOSAR, Specification of SW-C End-to-End Communication Protection Library, profiles 1
(data id mode "both") and 5.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable, Sequence

from harness.can.database import Message, Signal
from harness.common.errors import FaultError

__all__ = ["Codec", "crc8"]

_POLYNOMIAL = 0x1D
_STRUCT = {8: "B", 16: "H", 32: "I", 64: "Q"}

Decode = Callable[[bytes], tuple[tuple[float, ...], int]]
Encode = Callable[[Sequence[float], int], bytes]


def _table() -> list[int]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte << 1 ^ (_POLYNOMIAL if byte & 0x80 else 0)
        table.append(byte & 0xFF)
    return table


_CRC8 = _table()


def crc8(data: bytes, start: int = 0) -> int:
    """CRC-8 of SAE J1850 without its start value and final inversion, as profile 1 wants it."""
    for byte in data:
        start = _CRC8[start ^ byte]
    return start


class Codec:
    """One message's frames.

    Attributes:
        message: what it is of.
        source: the generated code.
        is_intact: whether the CRC of a frame of the right length fits; always, without protection.
        counter: of a frame; 0 without protection.
        decode: values in the order of `message.signals`, and a mask with a bit for each that is not
            available or out of its range.
        encode: a frame from values and counter. A value out of range is sent as "not available".
    """

    def __init__(self, message: Message) -> None:
        """Write and compile the code."""
        self.message = message
        space: dict[str, object] = {"crc_hqx": crc_hqx, "FaultError": FaultError}
        lines = [
            *_intact(message, space),
            *_counter(message),
            *_decode(message, space),
            *_encode(message, space),
        ]
        self.source = "\n".join(lines) + "\n"
        exec(compile(self.source, f"<codec of {message.name}>", "exec"), space)
        self.is_intact: Callable[[bytes], bool] = space["is_intact"]  # type: ignore[assignment]
        self.counter: Callable[[bytes], int] = space["counter"]  # type: ignore[assignment]
        self.decode: Decode = space["decode"]  # type: ignore[assignment]
        self.encode: Encode = space["encode"]  # type: ignore[assignment]


def _intact(m: Message, space: dict[str, object]) -> list[str]:
    if m.profile == "none":
        return ["def is_intact(d):", "    return True"]
    if m.profile == "P05":
        space["ID"] = m.data_id.to_bytes(2, "little")
        return [
            "def is_intact(d):",
            "    return crc_hqx(ID, crc_hqx(d[2:], 0xFFFF)) == d[0] | d[1] << 8",
        ]
    return ["def is_intact(d):", f"    return {_crc8_of(m, space)} == d[0]"]


def _crc8_of(m: Message, space: dict[str, object]) -> str:
    """Expression for the CRC of profile 1 of `d`, whose first byte does not matter."""
    count = m.length - 1
    terms = []
    for index in range(count):
        # What a byte contributes: its CRC with zeros behind it.
        name = f"T{index + 1}"
        space[name] = [crc8(bytes([byte]) + bytes(count - 1 - index)) for byte in range(256)]
        terms.append(f"{name}[d[{index + 1}]]")
    constant = crc8(m.data_id.to_bytes(2, "little") + bytes(count))
    return " ^ ".join([*terms, str(constant)])


def _counter(m: Message) -> list[str]:
    value = {"P01": "d[1] & 15", "P05": "d[2]"}.get(m.profile, "0")
    return ["def counter(d):", f"    return {value}"]


def _struct_of(m: Message) -> str | None:
    """Format that takes the signals apart; None where they do not lie on whole bytes."""
    if not m.signals or any(
        s.length not in _STRUCT or s.shift % 8 or not s.little for s in m.signals
    ):
        return None
    ordered = sorted(m.signals, key=lambda s: s.shift)
    if list(m.signals) != ordered:
        return None
    form, at = "<", 0
    for s in ordered:
        gap = s.shift // 8 - at
        if gap < 0:
            return None
        form += f"{gap}x" * bool(gap) + (
            _STRUCT[s.length].lower() if s.signed else _STRUCT[s.length]
        )
        at = s.shift // 8 + s.length // 8
    return form + f"{m.length - at}x" * (m.length > at)


def _names(m: Message) -> list[str]:
    return [f"r{i}" for i in range(len(m.signals))]


def _decode(m: Message, space: dict[str, object]) -> list[str]:
    names = _names(m)
    lines = ["def decode(d):"]
    form = _struct_of(m)
    if form:
        space["unpack"] = struct.Struct(form).unpack
        lines.append(f"    {', '.join(names)}, = unpack(d)")
    else:
        for order in ("little", "big"):
            if any(s.little == (order == "little") for s in m.signals):
                lines.append(f"    {order} = int.from_bytes(d, '{order}')")
        for name, s in zip(names, m.signals, strict=True):
            whole = "little" if s.little else "big"
            lines.append(f"    {name} = {whole} >> {s.shift} & {(1 << s.length) - 1}")
            if s.signed:
                lines.append(f"    {name} -= ({name} >> {s.length - 1}) << {s.length}")
    lines.append("    bad = 0")
    for i, (name, s) in enumerate(zip(names, m.signals, strict=True)):
        outside = _outside(name, s)
        if outside:
            lines.append(f"    if {outside}: bad |= {1 << i}")
    values = [_value(name, s) for name, s in zip(names, m.signals, strict=True)]
    lines.append(f"    return ({''.join(f'{value}, ' for value in values)}), bad")
    return lines


def _outside(name: str, s: Signal) -> str:
    """Condition for a raw value out of range; empty where every one is in range."""
    least = -(1 << s.length - 1) if s.signed else 0
    most = least + (1 << s.length) - 1
    tests = [f"{name} < {s.low}"] * (s.low > least) + [f"{name} > {s.high}"] * (s.high < most)
    if s.missing is not None and s.low <= s.missing <= s.high:
        tests.append(f"{name} == {s.missing}")
    return " or ".join(tests)


def _value(name: str, s: Signal) -> str:
    scaled = name if s.scale == 1.0 else f"{name} * {s.scale!r}"
    return scaled if s.offset == 0.0 else f"{scaled} + {s.offset!r}"


def _encode(m: Message, space: dict[str, object]) -> list[str]:
    names = _names(m)
    lines = ["def encode(values, counter):"]
    if names:
        lines.append(f"    {', '.join(names)}, = values")
    for name, s in zip(names, m.signals, strict=True):
        number = name if s.offset == 0.0 else f"({name} - {s.offset!r})"
        scaled = number if s.scale == 1.0 else f"{number} / {s.scale!r}"
        if s.missing is not None:
            refuse = [f"{name} = {s.missing}"]
        else:
            text = f"message '{m.name}' cannot carry {s.name} ="
            refuse = [f"raise FaultError({text!r} + f' {{{name}:g}} {s.unit}')"]
        low, high = s.range
        margin = abs(s.scale) / 2
        lines += [
            # Not finite compares as false, whatever the limits are.
            f"    if {low - margin!r} < {name} < {high + margin!r}:",
            f"        {name} = round({scaled})",
            "    else:",
            *(f"        {line}" for line in refuse),
        ]
    lines += _pack(m, space)
    return lines


def _pack(m: Message, space: dict[str, object]) -> list[str]:
    """Lines that lay raw values into `d` and return it with counter and CRC."""
    form = _struct_of(m)
    names = _names(m)
    lines = []
    if form:
        space["pack"] = struct.Struct(form).pack
        lines.append(f"    d = bytearray(pack({', '.join(names)}))")
    else:
        big = [(n, s) for n, s in zip(names, m.signals, strict=True) if not s.little]
        little = [(n, s) for n, s in zip(names, m.signals, strict=True) if s.little]
        lines.append(f"    d = bytearray(({_laid(little)}).to_bytes({m.length}, 'little'))")
        if big:
            lines.append(f"    for i, b in enumerate(({_laid(big)}).to_bytes({m.length}, 'big')):")
            lines.append("        d[i] |= b")
    if m.profile == "P01":
        lines += ["    d[1] |= counter", f"    d[0] = {_crc8_of(m, space)}"]
    elif m.profile == "P05":
        lines += [
            "    d[2] = counter",
            "    crc = crc_hqx(ID, crc_hqx(d[2:], 0xFFFF))",
            "    d[0] = crc & 255",
            "    d[1] = crc >> 8",
        ]
    return [*lines, "    return bytes(d)"]


def _laid(raw: Sequence[tuple[str, Signal]]) -> str:
    terms = [f"({name} & {(1 << s.length) - 1}) << {s.shift}" for name, s in raw]
    return " | ".join(terms) or "0"
