"""Counter, clock, drive and faults, each by itself."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.can.clock import BoardClock
from harness.can.fault_injection import KINDS, InjectedFault, parse
from harness.can.protection import CheckStatus, Counter
from harness.can.voltage_ramp import VoltageRamp

LIMITS = [(0.0, 100.0)] * 3


@pytest.mark.parametrize("modulus", [15, 256])
@given(data=st.data())
def test_what_a_counter_says_depends_on_its_step_alone(modulus, data) -> None:
    first = data.draw(st.integers(0, modulus - 1))
    step = data.draw(st.integers(0, modulus - 1))
    counter = Counter(modulus)
    assert counter.take(first) is CheckStatus.INITIAL
    found = counter.take((first + step) % modulus)
    wanted = {
        0: CheckStatus.REPEATED,
        1: CheckStatus.OK,
        2: CheckStatus.OK_SOME_LOST,
        3: CheckStatus.OK_SOME_LOST,
    }
    assert found is wanted.get(step, CheckStatus.WRONG_SEQUENCE)
    assert counter.in_sequence is (step <= 3)
    assert counter.lost == (step - 1 if step in (2, 3) else 0)


def test_a_wrong_sequence_is_over_with_the_second_good_frame() -> None:
    counter = Counter(15)
    found = [counter.take(value) for value in (0, 7, 8, 9, 10)]
    ok = [CheckStatus.OK] * 2
    assert found == [CheckStatus.INITIAL, CheckStatus.WRONG_SEQUENCE, CheckStatus.SYNC, *ok]


def test_the_value_that_no_counter_has_is_a_wrong_sequence() -> None:
    counter = Counter(15)
    counter.take(14)
    assert counter.take(15) is CheckStatus.WRONG_SEQUENCE


@pytest.mark.parametrize("drift", [-100e-6, 0.0, 37e-6, 100e-6])
def test_the_clock_finds_the_drift_under_late_and_missing_arrivals(drift) -> None:
    chance = random.Random(5)
    clock = BoardClock(1000.0)
    worst = 0.0
    for n in range(40_000):
        due = 1e9 + n * 1000.0 * (1 + drift)
        late = chance.expovariate(1 / 60.0) + (3000.0 if chance.random() < 0.002 else 0.0)
        if n > 5000:
            worst = max(worst, abs(clock.predict(n) - due - 60.0))
        if chance.random() > 0.01:
            clock.take(n, due + late)
    assert clock.drift == pytest.approx(drift, abs=0.5e-6)
    assert worst < 60.0
    assert clock.at(1e9 + 40_000 * 1000.0 * (1 + drift)) == 40_000


def test_a_stall_of_half_a_second_does_not_move_the_clock() -> None:
    clock = BoardClock(1000.0)
    for n in range(2000):
        clock.take(n, n * 1000.0)
    for n in range(2000, 2500):
        clock.take(n, 2_500_000.0)  # all at once
    assert clock.predict(2500) == pytest.approx(2_500_000.0)
    for n in range(2500, 4000):
        clock.take(n, n * 1000.0)
    assert clock.predict(4000) == pytest.approx(4_000_000.0, abs=1.0)


@given(
    st.lists(
        st.tuples(st.booleans(), st.lists(st.floats(0, 100), min_size=3, max_size=3)),
        min_size=1,
        max_size=60,
    )
)
def test_a_drive_never_jumps_and_never_leaves_its_limits(steps) -> None:
    drive = VoltageRamp(LIMITS, 0.2)
    before, asked = list(drive.volts), None
    for follows, wanted in steps:
        now = list(drive.step(wanted if follows else None))
        swing = [abs(w - a) for w, a in zip(wanted, asked, strict=True)] if asked else [0.0] * 3
        for i in range(3):
            assert 0.0 <= now[i] <= 100.0
            most = 0.2 + (swing[i] if follows else 0.0)
            assert abs(now[i] - before[i]) <= most + 1e-9
        before, asked = now, (wanted if follows else None)


def test_an_offset_that_stays_is_learnt() -> None:
    """The transport takes two milliseconds more from now on; or less."""
    for shift in (2000.0, -2000.0):
        clock = BoardClock(1000.0)
        for n in range(2000):
            clock.take(n, n * 1000.0)
        for n in range(2000, 4000):
            clock.take(n, n * 1000.0 + shift)
        assert clock.predict(4000) == pytest.approx(4_000_000.0 + shift, abs=1.0)


def test_a_drive_catches_up_with_what_moves_faster_than_it_may() -> None:
    drive = VoltageRamp(LIMITS, 0.2)
    t = np.arange(2000) * 1e-3
    wanted = 50 + 40 * np.sin(2 * np.pi * 10 * t)
    volts = []
    for w in wanted:
        volts.append(drive.step([w] * 3)[0])
    assert volts[-1] == wanted[-1]
    assert volts[400:] == pytest.approx(wanted[400:], abs=1e-12)


@given(
    st.sampled_from(KINDS),
    st.floats(0, 1),
    st.floats(0, 50).map(lambda x: round(x, 3)),
    st.floats(0.001, 50).map(lambda x: round(x, 3)),
)
def test_a_fault_reads_as_it_is_written(kind, rate, start, length) -> None:
    fault = InjectedFault(
        kind, float(f"{rate:g}"), float(f"{start:g}"), float(f"{start + length:g}")
    )
    if fault.start < fault.end:
        assert parse(str(fault)) == fault


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dorp:0.1", "did you mean 'drop'?"),
        ("drop:1.5", "RATE is a probability"),
        ("drop@3-2", "START comes before END"),
        ("drop=3", "write KIND"),
        ("drop:1e", "could not convert"),
        ("drop@1.2.3-4", "could not convert"),
    ],
)
def test_a_fault_that_is_none_is_refused(text, words) -> None:
    with pytest.raises(SteadytipError) as raised:
        parse(text)
    assert words in str(raised.value)
