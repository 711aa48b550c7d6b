"""Packing and unpacking against cantools, CRCs against crccheck."""

import math

import cantools
import pytest
from crccheck.crc import Crc8Base, Crc16CcittFalse, CrcXmodem
from hypothesis import given
from hypothesis import strategies as st

from harness.can.codec import Codec
from harness.can.database import load
from harness.common.errors import FaultError

SHIPPED = ["instrument", "instrument_fd"]


class Profile1(Crc8Base):
    _poly = 0x1D
    _initvalue = 0
    _xor_output = 0


ODD = """VERSION ""
NS_ :
BS_:
BU_: Loop Board
BO_ 100 Odd: 8 Board
 SG_ a : 3|5@1+ (2,-7) [0|0] "" Loop
 SG_ b : 8|11@1- (0.5,1) [-200|200] "V" Loop
 SG_ c : 39|12@0- (1,0) [0|0] "" Loop
 SG_ d : 43|9@0+ (-0.25,3) [-60|0] "m" Loop
BO_ 2147483748 Far: 3 Board
 SG_ e : 7|24@0+ (1,0) [0|0] "" Loop
BA_DEF_ BO_ "Role" ENUM "other","sample","command","feedback","status","heartbeat";
BA_DEF_DEF_ "Role" "other";
"""


@pytest.fixture(scope="module")
def odd(tmp_path_factory) -> str:
    """Signals that lie on no byte, in both byte orders, and an extended id."""
    path = tmp_path_factory.mktemp("dbc") / "odd.dbc"
    path.write_text(ODD)
    return str(path)


def pairs(dbc: str):
    database = load(dbc)
    oracle = cantools.database.load_file(str(database.path))
    return [(Codec(m), oracle.get_message_by_name(m.name)) for m in database.messages]


SHIPPED_PAIRS = [pair for dbc in SHIPPED for pair in pairs(dbc)]


@pytest.mark.parametrize(("codec", "oracle"), SHIPPED_PAIRS, ids=lambda p: getattr(p, "name", ""))
@given(data=st.data())
def test_values_go_there_and_back_as_cantools_has_them(codec, oracle, data) -> None:
    counter = data.draw(st.integers(0, max(codec.message.modulus, 1) - 1))
    raw = {s.name: data.draw(st.integers(s.low, s.high)) for s in codec.message.signals}
    values = [raw[s.name] * s.scale + s.offset for s in codec.message.signals]
    frame = codec.encode(values, counter)
    assert codec.is_intact(frame)
    assert codec.counter(frame) == (counter if codec.message.modulus else 0)
    decoded, bad = codec.decode(frame)
    assert bad == 0
    assert decoded == pytest.approx(values, rel=1e-12)
    seen = oracle.decode(frame, decode_choices=False)
    assert [seen[s.name] for s in codec.message.signals] == pytest.approx(values, rel=1e-12)
    named = dict(zip((s.name for s in codec.message.signals), values, strict=True))
    protection = {n: seen[n] for n in ("crc", "counter") if n in seen}
    assert oracle.encode({**named, **protection}, strict=False) == frame


@given(data=st.data())
def test_signals_that_lie_on_no_byte(odd, data) -> None:
    for codec, oracle in pairs(odd):
        raw = [data.draw(st.integers(s.low, s.high)) for s in codec.message.signals]
        values = [r * s.scale + s.offset for r, s in zip(raw, codec.message.signals, strict=True)]
        named = dict(zip((s.name for s in codec.message.signals), values, strict=True))
        frame = codec.encode(values, 0)
        assert frame == oracle.encode(named, strict=False)
        assert codec.decode(frame) == (pytest.approx(values), 0)


@given(st.binary(min_size=8, max_size=8))
def test_any_bytes_decode_as_cantools_has_them_and_out_of_range_is_flagged(data) -> None:
    codec, oracle = next(p for p in SHIPPED_PAIRS if p[0].message.name == "BoardStatus")
    seen = oracle.decode(data, decode_choices=False)
    values, bad = codec.decode(data)
    assert values == pytest.approx([seen[s.name] for s in codec.message.signals])
    for index, signal in enumerate(codec.message.signals):
        low, high = signal.range
        inside = low - 1e-9 <= values[index] <= high + 1e-9
        assert bool(bad >> index & 1) is not inside


@pytest.mark.parametrize("dbc", SHIPPED)
@given(data=st.data())
def test_crc_as_crccheck_computes_it(dbc, data) -> None:
    for message in load(dbc).messages:
        codec = Codec(message)
        frame = data.draw(st.binary(min_size=message.length, max_size=message.length))
        id = message.data_id.to_bytes(2, "little")
        if message.profile == "P01":
            right = bytes([Profile1.calc(id + frame[1:])]) + frame[1:]
        elif message.profile == "P05":
            right = Crc16CcittFalse.calc(frame[2:] + id).to_bytes(2, "little") + frame[2:]
        else:
            right = frame
        assert codec.is_intact(right)
        assert codec.is_intact(frame) is (frame == right)


def test_crccheck_and_this_agree_on_the_check_value_of_the_standard() -> None:
    """So that the witness above is one of CRC-8/SAE-J1850's polynomial, without its inversions."""
    assert Profile1.calc(b"123456789") == 0x37
    assert CrcXmodem.calc(b"123456789") == 0x31C3


@pytest.mark.parametrize("value", [5.0, -0.001, math.nan, math.inf])
def test_a_value_that_does_not_fit_is_sent_as_not_available(value) -> None:
    codec = next(p[0] for p in SHIPPED_PAIRS if p[0].message.name == "SensorsA")
    frame = codec.encode([value, 2.5, 2.5], 3)
    assert frame[2:4] == b"\xff\xff"
    _, bad = codec.decode(frame)
    assert bad == 1


def test_a_value_that_does_not_fit_and_has_no_such_word_is_refused_by_name() -> None:
    codec = next(p[0] for p in SHIPPED_PAIRS if p[0].message.name == "BoardHeartbeat")
    with pytest.raises(FaultError, match="'BoardHeartbeat' cannot carry board_state = 300"):
        codec.encode([300.0], 0)
