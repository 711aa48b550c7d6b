"""Every row of the table of faults: detected as named, counted, answered in time, and over."""

import math

import can
import numpy as np
import pytest

from harness.can.codec import Codec
from harness.can.cycle import Tick
from harness.can.database import HOLD, RUN
from harness.can.fault_injection import BABBLE, InjectedFault, parse
from harness.scenario.schema import Hil
from tests.harness.can.virtual import STEP, Rig, truth

BEGUN, FAULTY = 200, 300
"""Ticks that all is well, and when it is well again at the latest."""


def rig_with(*faults: str, dbc: str = "instrument", **more) -> Rig:
    return Rig(dbc, [parse(text) for text in faults], seed=1, **more)


def kinds(rig: Rig) -> set[str]:
    return {event.kind for event in rig.loop.events}


def reaction(rig: Rig, since: int) -> int:
    """Ticks from the beginning of a fault to the command that answers it."""
    return next(k for k, mode in enumerate(rig.modes) if k >= since and mode == HOLD) - since


@pytest.fixture(params=["instrument", "instrument_fd"])
def dbc(request) -> str:
    return request.param


def test_without_faults_every_sample_is_taken_and_every_command_acts_at_the_next(dbc) -> None:
    rig = Rig(dbc)
    rig.run(500)
    assert not any(rig.loop.reception.counts.values())
    assert rig.modes[1:] == [RUN] * 499
    assert rig.input.sample.number == 499
    assert np.allclose(rig.applied[301:], rig.volts[300:-1], atol=0)
    assert np.allclose(rig.volts[300:], rig.wanted[300:], atol=0.001)


@pytest.mark.parametrize("missing", [1, 2])
def test_some_lost(dbc, missing) -> None:
    """The last value is held, its age goes on."""
    rig = rig_with(f"drop@0.2-{0.2 + missing * STEP - 1e-6}", dbc=dbc)
    ages = []
    rig.each = lambda rig: ages.append((rig.input.number - rig.input.sample.number, rig.input.age))
    rig.run(FAULTY)
    counts = rig.loop.reception.counts
    parts = 1 if dbc.endswith("fd") else 3
    assert counts["lost"] >= missing * parts
    assert counts["sequence"] == 0
    assert [ages[200 + i][0] for i in range(missing + 1)] == [*range(1, missing + 1), 0]
    assert ages[200][1] == pytest.approx(STEP + ages[199][1], abs=2e-4)
    assert set(rig.modes[1:]) == {RUN}


def test_wrong_sequence(dbc) -> None:
    """Four samples missing: invalid until two good ones have come, though the timeout is not up."""
    rig = rig_with("drop@0.2-0.203999", dbc=dbc)
    rig.run(FAULTY)
    assert rig.loop.reception.counts["sequence"] == (1 if dbc.endswith("fd") else 3)
    assert rig.loop.reception.counts["timeouts"] == 0
    assert "sequence" in kinds(rig)
    # The frame that jumps, and the first good one after it.
    assert [k for k, mode in enumerate(rig.modes) if mode == HOLD and k] == [204, 205]


def test_repeated(dbc) -> None:
    rig = rig_with("duplicate@0.2-0.25", dbc=dbc)
    rig.run(FAULTY)
    counts = rig.loop.reception.counts
    assert counts["repeated"] >= 50 * (1 if dbc.endswith("fd") else 3)
    assert not counts["sequence"]
    assert not counts["incomplete"]
    assert set(rig.modes[1:]) == {RUN}
    assert rig.input.sample.number == FAULTY - 1


def test_stuck_counter(dbc) -> None:
    """The same frame again and again is one that is repeated, until its age is too high."""
    rig = rig_with("stick@0.2-0.25", dbc=dbc)
    rig.run(FAULTY)
    assert rig.loop.reception.counts["repeated"] >= 40
    # The first stuck frame is a good one, of tick 200.
    assert reaction(rig, 201) <= 5 + 2
    rig.run(5)
    assert rig.modes[-1] == RUN


def test_wrong_crc(dbc) -> None:
    rig = rig_with("corrupt@0.205-0.207", dbc=dbc)
    rig.run(FAULTY)
    counts = rig.loop.reception.counts
    assert counts["crc"] >= 2 * (1 if dbc.endswith("fd") else 3)
    assert rig.input.sample.number == FAULTY - 1
    assert set(rig.modes[1:]) == {RUN}


def test_crc_of_another_id(dbc) -> None:
    """A frame that is right, but for its id."""
    rig = Rig(dbc)
    rig.run(BEGUN)
    messages = {m.id: m for m in rig.database.sent_by("Board")}
    a, feedback = 0x110, 0x120
    frame = Codec(messages[feedback]).encode([2, 10.0, 20.0, 30.0], 5)
    frame = frame.ljust(messages[a].length, b"\0")
    rig.inject = [(a, frame, messages[a].is_fd, False)]
    rig.run(1)
    assert rig.loop.reception.counts["crc"] == 1
    rig.run(20)
    assert set(rig.modes[1:]) == {RUN}


def test_nothing_within_the_timeout(dbc) -> None:
    """Estimator told, command on hold and on its way to rest, and back without a jump."""
    rig = rig_with("silence@0.2-0.25", dbc=dbc)
    told = []
    rig.each = lambda rig: told.append(not rig.input.fault)
    rig.run(900)
    assert reaction(rig, 200) <= 5 + 2
    assert rig.loop.reception.counts["timeouts"] >= 1
    assert "timeouts" in kinds(rig)
    assert not any(told[207:250])
    volts = np.array(rig.volts)
    most = rig.database.ramp_rate * STEP
    held = np.flatnonzero(np.array(rig.modes) == HOLD)[1:]
    assert (np.abs(volts[held] - volts[held - 1]) <= most + 1e-3).all()
    assert (volts[held[-1]] < volts[held[0]]).all()
    # Over again once two good samples have followed the one that jumps, without a jump; where the
    # counter has gone round meanwhile, once the board has told its own, each 100 ms.
    over = 252 if dbc.endswith("fd") else 300
    assert rig.modes[over:] == [RUN] * len(rig.modes[over:])
    back = np.abs(np.diff(volts[250:], axis=0))
    swing = 40 * 2 * math.pi * 3 * STEP
    assert back.max() <= most + swing + 0.003
    assert np.allclose(volts[-1], rig.wanted[-1], atol=0.001)


def test_a_part_of_a_sample_that_stays_away_makes_all_of_it_old() -> None:
    """The magnetometer's frame alone: its timeout is 20 ms, but a sample is a whole."""
    rig = Rig()
    rig.run(BEGUN)
    hear = rig.receive
    rig.receive = lambda m: hear(m) if m.arbitration_id != 0x112 else None
    rig.run(50)
    counts = rig.loop.reception.counts
    assert reaction(rig, BEGUN) <= 5 + 2
    assert counts["incomplete"] >= 30
    assert counts["timeouts"] == 1
    rig.receive = hear
    rig.run(60)
    assert rig.modes[-1] == RUN
    assert rig.input.sample.number == rig.tick - 1


def test_a_short_silence_is_over_at_once(dbc) -> None:
    rig = rig_with("silence@0.21-0.219", dbc=dbc)
    rig.run(300)
    assert rig.modes[221:] == [RUN] * len(rig.modes[221:])
    assert rig.input.sample.number == 299


def test_late_samples_are_not_taken_for_later_ones() -> None:
    """Thirty samples held up and then all at once: the counter went round, their age counts."""
    rig = Rig()
    rig.run(205)
    held_up: list = []
    hear = rig.receive
    rig.receive = held_up.append
    rig.run(30)
    rig.receive = hear
    for message in held_up:
        message.timestamp = rig.time
        hear(message)
    rig.run(60)
    assert set(rig.modes[212:300]) <= {HOLD, RUN}
    for k, mode in enumerate(rig.modes[212:235], start=212):
        assert mode == HOLD, k
    rig.run(40)
    assert rig.input.sample.number == rig.tick - 1
    assert rig.modes[-1] == RUN


@pytest.mark.parametrize("times", [2, 3])
def test_not_available(dbc, times) -> None:
    """Held and counted; the third in a row is a fault."""
    rig = Rig(dbc)
    seen = []
    rig.each = lambda rig: seen.append(dict(zip(rig.names, rig.input.sample.values, strict=True)))
    rig.run(BEGUN)
    values = rig.board.transmit
    rig.board.transmit = lambda given: values({**given, "volts_a2y": math.nan})
    rig.run(times)
    rig.board.transmit = values
    rig.run(10)
    index = rig.names.index("volts_a2y")
    for tick in range(BEGUN, BEGUN + times):
        assert seen[tick]["volts_a2y"] == pytest.approx(truth(BEGUN - 1, index), abs=4e-5)
    assert rig.loop.reception.counts["range"] == times
    assert [k for k, mode in enumerate(rig.modes) if mode == HOLD and k] == (
        [BEGUN + 2] if times == 3 else []
    )
    assert ("range" in kinds(rig)) == (times == 3)


def test_incomplete() -> None:
    """A sample whose second frame is missing is dropped; its other frames meet no other."""
    rig = Rig()
    rig.run(BEGUN)
    hear = rig.receive
    rig.receive = lambda m: hear(m) if m.arbitration_id != 0x111 else None
    rig.run(1)
    rig.receive = hear
    assert rig.input.sample.number == BEGUN - 1
    rig.run(1)
    assert rig.loop.reception.counts["incomplete"] == 1
    expected = [truth(BEGUN + 1, i) for i, n in enumerate(rig.names) if n != "field_new"]
    got = [v for v, n in zip(rig.input.sample.values, rig.names, strict=True) if n != "field_new"]
    assert got == pytest.approx(expected, abs=4e-5)


def test_wrong_length(dbc) -> None:
    rig = rig_with("wrong-length@0.2-0.202", dbc=dbc)
    rig.run(FAULTY)
    assert rig.loop.reception.counts["length"] >= 2
    assert set(rig.modes[1:]) == {RUN}


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame"])
def test_remote_and_error_frames_with_an_id_of_ours(kind) -> None:
    rig = Rig()
    rig.run(BEGUN)
    odd = {kind: True, **({"dlc": 8} if kind == "is_remote_frame" else {"data": bytes(8)})}
    rig.receive(can.Message(timestamp=rig.time, arbitration_id=0x110, is_extended_id=False, **odd))
    assert rig.loop.reception.counts["length"] == 1
    rig.run(20)
    assert set(rig.modes[1:]) == {RUN}


def test_an_extended_id_of_the_same_number_is_another_id() -> None:
    rig = Rig()
    rig.inject = [(0x110, bytes(8), False, True)]
    rig.run(1)
    assert rig.loop.reception.counts["unknown"] == 1


def test_unknown_ids_do_nothing_until_they_babble(dbc) -> None:
    rig = rig_with("unknown:0.02@0.2-0.4", "babble@0.6-1.0", dbc=dbc)
    rig.run(600)
    assert rig.loop.reception.counts["unknown"] > 0
    assert "babbling" not in kinds(rig)
    quiet = rig.loop.reception.load
    rig.run(400)
    assert rig.loop.reception.counts["unknown"] > 400 * BABBLE
    (event,) = [event for event in rig.loop.events if event.kind == "babbling"]
    assert "bus load" in event.text
    assert rig.loop.reception.peak_load > quiet + 0.5
    assert set(rig.modes[1:]) == {RUN}


def test_bus_off(dbc) -> None:
    rig = rig_with("bus-off@0.2-0.3", dbc=dbc)
    rig.run(400)
    assert rig.loop.reception.counts["bus_off"] == 1
    assert reaction(rig, 200) == 0
    assert rig.modes[303:] == [RUN] * len(rig.modes[303:])


def test_unplugged_and_back(dbc) -> None:
    rig = rig_with("unplug@0.2-1.2", dbc=dbc)
    rig.run(1500)
    assert rig.loop.reception.counts["unplugged"] == 1
    assert reaction(rig, 200) == 0
    assert rig.modes[1203:] == [RUN] * len(rig.modes[1203:])
    assert rig.input.sample.number == rig.tick - 1


def test_heartbeat_lost() -> None:
    rig = Rig()
    rig.run(BEGUN)
    hear = rig.receive
    rig.receive = lambda m: hear(m) if m.arbitration_id != 0x701 else None
    rig.run(400)
    assert rig.loop.reception.counts["heartbeat"] == 1
    # The last one was that of tick 100.
    assert reaction(rig, 100) <= 300 + 2
    rig.receive = hear
    rig.run(101)
    assert rig.modes[-1] == RUN


def test_a_board_that_is_not_operational_any_more() -> None:
    rig = Rig()
    rig.run(BEGUN)
    rig.inject = [(0x701, bytes([4]), False, False)]
    rig.run(1)
    assert rig.modes[-1] == HOLD
    rig.run(101)
    assert rig.modes[-1] == RUN


def test_a_board_that_begins_anew_is_followed(dbc) -> None:
    rig = Rig(dbc)
    rig.run(2000)
    rig.tick = 0
    rig.run(BEGUN)
    assert rig.input.sample.number == BEGUN - 1
    assert rig.modes[-1] == RUN


@pytest.mark.parametrize("overrun", ["catch-up", "skip"])
def test_samples_that_came_at_once_are_taken_one_by_one_or_skipped(overrun) -> None:
    rig = Rig(policy=Hil(overrun=overrun))
    rig.run(BEGUN)
    begin, held, steps = rig.begin, [], []
    rig.begin = lambda _: None
    rig.run(4)  # the loop sleeps
    rig.begin = begin
    while not held or held[-1] < BEGUN + 3:
        rig.begin(Tick(rig.tick, rig.time))
        held.append(rig.input.sample.number)
        steps.append(rig.input.steps)
    assert held == ([200, 201, 202, 203] if overrun == "catch-up" else [203])
    assert sum(steps) == 4


def test_a_command_out_of_range_is_held_and_then_a_fault() -> None:
    rig = Rig()
    rig.run(600)
    last = rig.volts[-1]
    for tick in range(4):
        command = rig.loop.command([50.0, 101.0, 50.0])
        if tick < 2:
            assert command.mode == RUN
            assert command.volts == pytest.approx(last, abs=2e-3)
        else:
            assert command.mode == HOLD
    assert rig.loop.reception.counts["range"] == 4


def test_a_board_that_hears_nothing_goes_to_rest(dbc) -> None:
    rig = Rig(dbc)
    rig.run(BEGUN)
    rig.deaf = True
    rig.run(700)
    applied = np.array(rig.applied)
    most = rig.database.ramp_rate * STEP
    assert np.allclose(applied[BEGUN + 2 : BEGUN + 5], applied[BEGUN + 1], atol=0)
    after = applied[BEGUN + 8 :]
    assert (np.diff(after, axis=0) <= 0).all()
    assert (np.abs(np.diff(after, axis=0)) <= most + 1e-9).all()
    assert (applied[-1] == 0).all()
    rig.deaf = False
    rig.run(700)
    assert np.abs(np.diff(np.array(rig.applied)[900:], axis=0)).max() <= 1.0  # 0.2 + 0.75 V
    assert np.allclose(rig.applied[-1], rig.volts[-2], atol=0)


def test_the_same_faults_and_seed_give_the_same_run() -> None:
    def one(seed: int) -> tuple[list, list]:
        rig = Rig(faults=[InjectedFault("drop", 0.1), InjectedFault("reorder", 0.05)], seed=seed)
        rig.run(300)
        return rig.volts, rig.modes

    assert one(3) == one(3)
    assert one(3) != one(4)


class Batched(Rig):
    """A loop that decodes no frame before its tick begins."""

    arrived: tuple[can.Message, ...] = ()

    def receive(self, frame: can.Message) -> None:
        self.arrived = (*self.arrived, frame)

    def begin(self, tick: Tick) -> None:
        self.input, self.arrived = self.loop.cycle(self.arrived, tick), ()


def test_a_tick_is_the_same_whether_frames_are_decoded_on_arrival_or_all_at_once() -> None:
    faults = [InjectedFault("drop", 0.1), InjectedFault("reorder", 0.05)]
    seen: tuple[list, list] = ([], [])
    for kind, inputs in zip((Rig, Batched), seen, strict=True):
        kind(faults=faults, seed=3, each=lambda rig, to=inputs: to.append(rig.input)).run(300)
    assert seen[0] == seen[1]
    assert any(taken.fault for taken in seen[0])
