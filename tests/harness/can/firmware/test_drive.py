"""The board's drive: which commands act, and what takes the stacks to rest."""

import ctypes
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.pack.compiler import compile_c
from harness.can.firmware import sources
from harness.can.firmware.process import FirmwareBoard
from harness.can.protection import CheckStatus
from harness.can.protection import Counter as Sequencer
from harness.can.voltage_ramp import VoltageRamp
from tests.harness.can.firmware.board import (
    COMMAND,
    DBCS,
    FEEDBACK,
    HOLD,
    OFF,
    RUN,
    Frame,
    Host,
    command,
    database,
    protected,
)


def drive(
    host: Host, dbc: str, wanted: Callable[[int], Sequence[float]], count: int, done: int = 0
) -> None:
    """Answer samples by commands in the mode run, up to a number; `done` are answered already."""
    answered = done
    seen = len(host.frames) if done else 0
    fd = dbc == "instrument_fd"
    modulus = 256 if fd else 15
    last = 0x110 if fd else 0x112

    def answer() -> bool:
        nonlocal seen, answered
        fresh = host.frames[seen:]
        seen = len(host.frames)
        for frame in fresh:
            if frame.id == last:
                data = command(dbc, answered % modulus, RUN, *wanted(answered))
                host.write(Frame(COMMAND, data, fd).line)
                answered += 1
        return answered >= count

    host.pump(until=answer)


@pytest.mark.parametrize("dbc", DBCS)
def test_command_of_a_sample_acts_in_the_next(recording, dbc) -> None:
    """Expected: volts of the next sample are those of the command, all three of one command."""

    def wanted(k: int) -> tuple[float, float, float]:
        return 0.002 * (k % 100), 0.002 * (k // 100), 0.2  # within a sample of rest

    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        drive(host, dbc, wanted, 250)
        host.close()
    log = board.log
    applied = np.column_stack([log[f"volts_{i}"] for i in (1, 2, 3)])[:250]
    acting = log["mode"][:250] == RUN
    of = np.rint((applied[acting, :2] / 0.002) @ [1, 100]).astype(int)  # sample of the command
    commands = np.array([wanted(k) for k in of])
    np.testing.assert_allclose(applied[acting], commands, atol=1e-9)
    late = np.flatnonzero(acting) - 1 - of
    assert late.min() >= 0, "a command acted before it was sent"
    # A host that is held up answers late, but not as a rule.
    assert np.count_nonzero(acting) > 100
    assert np.median(late) == 0
    for key in ("crc", "length", "repeated", "sequence", "range", "unknown"):
        assert log[key][-1] == 0, key
    data = [f.data for f in host.frames if f.id == FEEDBACK]
    message = database(dbc).get_message_by_frame_id(FEEDBACK)
    for j, frame in enumerate(data[: len(applied) // 10]):
        decoded = message.decode(frame, decode_choices=False)
        volts = [decoded[f"applied_{i}"] for i in (1, 2, 3)]
        np.testing.assert_allclose(volts, applied[10 * j], atol=1e-9)
        assert decoded["applied_mode"] == log["mode"][10 * j]


@pytest.mark.parametrize("dbc", DBCS)
def test_silence_takes_the_stacks_to_rest_without_a_jump(recording, dbc) -> None:
    with FirmwareBoard(recording, dbc, loop=True) as board:
        host = Host(board.link)
        drive(host, dbc, lambda k: (10.0, 5.0, 2.502), 150)
        host.pump(0.2)
        host.close()
    log = board.log
    applied = np.column_stack([log[f"volts_{i}"] for i in (1, 2, 3)])
    assert applied.max(axis=0) == pytest.approx([10.0, 5.0, 2.502])
    assert np.abs(np.diff(applied, axis=0)).max() <= 0.2 + 1e-9
    last = np.flatnonzero(log["mode"] == RUN)[-1]
    fall = applied[last] - 0.2 * np.arange(len(applied) - last)[:, None]
    np.testing.assert_allclose(applied[last:], np.maximum(fall, 0.0), atol=1e-9)
    assert len(fall) > 120
    assert log["timeout"][-1] - log["timeout"][last] == 1


def test_loop_that_stops_takes_the_stacks_to_rest_and_sampling_goes_on(recording) -> None:
    """Expected: commands do not count while the loop's node says that it has stopped."""
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        drive(host, "instrument", lambda k: (2.0, 2.0, 2.0), 50)
        host.beat("stopped")
        host.is_beating = False
        drive(host, "instrument", lambda k: (2.0, 2.0, 2.0), 90, done=50)
        host.close()
    log = board.log
    assert log["volts_1"].max() == pytest.approx(2.0)
    assert log["volts_1"][-1] == 0
    assert log["mode"][-1] == OFF


def test_lost_heartbeat_takes_the_stacks_to_rest_in_spite_of_commands(recording) -> None:
    with FirmwareBoard(recording, loop=True) as board:
        host = Host(board.link)
        drive(host, "instrument", lambda k: (0.2, 0.2, 0.2), 20)
        host.is_beating = False
        drive(host, "instrument", lambda k: (0.2, 0.2, 0.2), 450, done=20)
        host.close()
    log = board.log
    assert log["volts_1"].max() == pytest.approx(0.2)
    assert log["heartbeat"][[200, 440]].tolist() == [0, 1]
    assert log["mode"][440] == OFF
    assert log["volts_1"][440] == 0


# The board's portable part as a library, a millisecond a call.
_SHIM = """
#include "board.h"
static Board board;
__attribute__((visibility("default"))) void begin(void)
{
    Frame beat = {.id = BUS_LOOP_HEARTBEAT_FRAME_ID, .length = 1, .data = {5}};
    board_start(&board);
    board_hear(&board, &beat);
}
__attribute__((visibility("default"))) void hear(int fd, int length, const uint8_t *data)
{
    Frame f = {.id = BUS_PIEZO_COMMAND_FRAME_ID, .fd = fd, .length = length};
    for (int i = 0; i < length; i++) f.data[i] = data[i];
    board_hear(&board, &f);
}
__attribute__((visibility("default"))) void tick(unsigned *out)
{
    static Frame frames[BOARD_FRAMES];
    static const Sample sample;
    Frame beat = {.id = BUS_LOOP_HEARTBEAT_FRAME_ID, .length = 1, .data = {5}};
    const Counts *c = &board.counts;
    if (board.ms % 100 == 0) board_hear(&board, &beat);
    board_tick(&board, &sample, frames);
    for (int i = 0; i < 3; i++) out[i] = board.applied[i];
    out[3] = board.mode;
    const unsigned counts[] = {c->crc,   c->length, c->repeated, c->lost, c->sequence,
                               c->range, c->timeout};
    for (int i = 0; i < 7; i++) out[4 + i] = counts[i];
}
"""


@cache
def shim(dbc: str) -> ctypes.CDLL:
    texts = {n: t for n, t in sources(dbc).items() if not n.startswith(("host", "faults"))}
    texts["shim.c"] = _SHIM
    arguments = ["shim.c", "board.c", "bus.c", "-std=c99", "-shared", "-fPIC", "-O1", "-o", "shim"]
    return ctypes.CDLL(str(compile_c(texts, arguments, "shim")))


@dataclass(frozen=True)
class Sent:
    """A command of a test: its counter is so many after the one before."""

    step: int
    mode: int
    raw: tuple[int, int, int]
    spoilt: bool
    length: int


raw_volts = st.one_of(st.integers(0, 50000), st.sampled_from([0, 50000, 50001, 0xFFFE, 0xFFFF]))
sent = st.builds(
    Sent,
    step=st.sampled_from([1, 1, 1, 1, 1, 1, 0, 2, 3, 4, 7]),
    mode=st.sampled_from([RUN, RUN, RUN, HOLD, OFF, 3, 15]),
    raw=st.tuples(raw_volts, raw_volts, raw_volts),
    spoilt=st.sampled_from([False] * 9 + [True]),
    length=st.sampled_from([0] * 9 + [-1, 1]),
)
ticks = st.lists(
    st.one_of(sent, sent, sent, st.none(), st.integers(2, 12)), min_size=1, max_size=60
)


class Model:
    """What the board should do with its commands, from the parts that the loop's side has."""

    def __init__(self, modulus: int) -> None:
        self.sequence = Sequencer(modulus)
        self.quiet = 99
        self.good: Sent | None = None
        self.drive = VoltageRamp([(0, 50000)] * 3, 100)
        self.mode = OFF
        self.counts = Counter()

    def hear(self, s: Sent, counter: int) -> None:
        if s.length:
            self.counts["length"] += 1
        elif s.spoilt:
            self.counts["crc"] += 1
        elif self.is_usable(counter):
            if s.mode > RUN or (s.mode != OFF and max(s.raw) > 50000):
                self.counts["range"] += 1
            else:
                self.good, self.quiet = s, 0

    def is_usable(self, counter: int) -> bool:
        status = self.sequence.take(counter)
        self.counts["repeated"] += status is CheckStatus.REPEATED
        self.counts["sequence"] += status is CheckStatus.WRONG_SEQUENCE
        self.counts["lost"] += self.sequence.lost
        return status in (CheckStatus.INITIAL, CheckStatus.OK, CheckStatus.OK_SOME_LOST)

    def tick(self) -> None:
        if self.quiet == 5:
            self.counts["timeout"] += 1
            self.sequence.silence()
        led = self.good is not None and self.quiet < 5
        self.mode = self.good.mode if led else OFF
        self.drive.step(None if self.mode == OFF else self.good.raw)
        self.quiet += 1


@pytest.mark.parametrize("dbc", DBCS)
@settings(max_examples=100)
@given(script=ticks)
def test_commands_are_judged_by_the_table_of_faults(dbc, script) -> None:
    """Expected: what is applied is in range, moves only as it may, and is what the table says."""
    fd = dbc == "instrument_fd"
    modulus = 256 if fd else 15
    library, out = shim(dbc), (ctypes.c_uint * 11)()
    library.begin()
    model, counter = Model(modulus), 0
    before, asked = [0, 0, 0], None
    for item in [*script, 510]:
        if isinstance(item, Sent):
            counter = (counter + item.step) % modulus
            signals = dict(zip(("volts_1", "volts_2", "volts_3"), item.raw, strict=True))
            message = database(dbc).get_message_by_frame_id(COMMAND)
            zeros = {signal.name: 0 for signal in message.signals}
            values = zeros | signals | {"mode": item.mode, "counter": counter}
            data = bytearray(
                protected(dbc, COMMAND, message.encode(values, scaling=False, strict=False))
            )
            if item.spoilt:
                data[-1] ^= 0x10
            data = data[: len(data) - 1] if item.length < 0 else data + bytes(item.length)
            library.hear(fd, len(data), bytes(data))
            model.hear(item, counter)
        for _ in range(item if isinstance(item, int) else 1):
            library.tick(out)
            model.tick()
            applied = out[:3]
            assert applied == model.drive.volts
            assert out[3] == model.mode
            for i in range(3):
                # No faster than the ramp, and what the command moves meanwhile.
                follows = asked is not None and model.mode != OFF
                moved = abs(model.good.raw[i] - asked[i]) if follows else 0
                assert abs(applied[i] - before[i]) <= 100 + moved
                assert applied[i] <= 50000
            before = applied
            asked = model.good.raw if model.mode != OFF else None
    names = ("crc", "length", "repeated", "lost", "sequence", "range", "timeout")
    assert dict(zip(names, out[4:], strict=True)) == {n: model.counts[n] for n in names}
    assert list(out[:3]) == [0, 0, 0], "silence does not take it to rest"
