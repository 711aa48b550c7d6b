"""A thousand random sequences of faults: no crash, nothing stale or mixed taken for fresh."""

import math
import random

import numpy as np
import pytest

from harness.can.database import HOLD, RUN
from harness.can.fault_injection import KINDS, InjectedFault
from tests.harness.can.virtual import STEP, Rig, truth

SEEDS = 1000
QUICK = 40
TICKS, CLEAN = 700, 330
"""Of a sequence, and of its end, in which nothing goes wrong: longer than the longest timeout."""
ALTERS = {"freeze", "unavailable"}
"""What a board does to its values before it protects them: nobody can see that from outside."""


def sequence(seed: int) -> list[InjectedFault]:
    chance = random.Random(seed)
    faults = []
    for _ in range(chance.randint(1, 5)):
        start = chance.uniform(0.02, (TICKS - CLEAN) * STEP - 0.03)
        end = min(start + chance.choice([0.002, 0.01, 0.05, 0.3]), (TICKS - CLEAN) * STEP)
        rate = chance.choice([0.02, 0.2, 0.7, 1.0])
        faults.append(InjectedFault(chance.choice(KINDS), rate, start, end))
    return faults


def check(seed: int) -> None:
    faults = sequence(seed)
    kinds = {fault.kind for fault in faults}
    # A stuck frame that is late on top can be a whole cycle of the classic counter old, and then
    # nothing tells it from a new one (see `harness.can.protection`).
    dbc = "instrument_fd" if seed % 3 == 0 or {"stick", "delay"} <= kinds else "instrument"
    altered = bool(ALTERS & kinds)
    fresh_at = [0]

    def each(rig: Rig) -> None:
        held = rig.input.sample
        if held is None:
            return
        if not altered:
            for i, (name, value) in enumerate(zip(rig.names, held.values, strict=True)):
                if name.startswith("volts_"):
                    assert abs(value - truth(held.number, i)) < 4e-5, name
        age = rig.tick - held.number
        assert age >= 0
        if rig.modes[-1] == RUN:
            # Whatever is acted upon is younger than the timeout, by the board's own count.
            assert not rig.input.fault
            assert age * STEP <= 5e-3 + 1e-9
        if not rig.input.fault:
            fresh_at[0] = rig.tick
        assert rig.tick - fresh_at[0] <= 8 or rig.modes[-1] == HOLD

    rig = Rig(dbc, faults, seed, each=each)
    rig.run(TICKS)
    # Unplugged boards come back, too: no restart, no help from outside.
    assert rig.modes[-1] == RUN
    assert rig.input.sample.number == TICKS - 1
    volts, wanted, modes = np.array(rig.volts), np.array(rig.wanted), np.array(rig.modes)
    assert volts.min() >= 0
    assert volts.max() <= 100
    most = rig.database.ramp_rate * STEP
    change = np.abs(np.diff(volts, axis=0)).max(axis=1)
    asked = np.abs(np.diff(wanted, axis=0)).max(axis=1)
    # On the way to rest at the ramp's rate; else as the controller asks, and the ramp beside it.
    assert (change[modes[1:] == HOLD] <= most + 0.0021).all()
    assert (change <= asked + most + 0.0021).all()
    applied = np.array(rig.applied)
    assert applied.min() >= 0
    assert applied.max() <= 100


def test_random_sequences() -> None:
    for seed in range(QUICK):
        check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(8))
def test_a_thousand_random_sequences(block) -> None:
    for seed in range(QUICK + block, SEEDS, 8):
        check(seed)


def test_truth_tells_samples_and_signals_apart() -> None:
    """What the sequences rest on: no two samples within a cycle of the counter look alike."""
    for n in range(900):
        for other in range(n + 1, min(n + 40, 900)):
            assert not math.isclose(truth(n, 3), truth(other, 3), abs_tol=1e-3)
