"""A run can be cut, restored, repeated and reset; instances do not see each other."""

import numpy as np
import pytest

from tests.contract.conftest import FLAVOURS


def run(instance, inputs, first: int, last: int) -> np.ndarray:
    rows = []
    for k in range(first, last):
        instance.apply(inputs(k))
        instance.step()
        rows.append(instance.values())
    return np.array(rows)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("serialised", [False, True], ids=["in memory", "as bytes"])
def test_cut_run_equals_the_uncut_run_bit_for_bit(start, inputs, flavour, serialised) -> None:
    """Save after 60 samples, restore into another instance that has been elsewhere, go on."""
    uncut = start(flavour)
    first = run(uncut, inputs, 0, 60)
    state = uncut.fmu.getFMUState()
    second = run(uncut, inputs, 60, 120)
    other = start(flavour)
    run(other, inputs, 200, 230)
    if serialised:
        state = other.fmu.deSerializeFMUstate(uncut.fmu.serializeFMUstate(state))
    other.fmu.setFMUState(state)
    other.time = uncut.time - 60 * uncut.period
    np.testing.assert_array_equal(other.values(), first[-1])
    np.testing.assert_array_equal(run(other, inputs, 60, 120), second)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_two_instances_do_not_see_each_other(start, inputs, flavour) -> None:
    alone = run(start(flavour), inputs, 0, 40)
    one, two = start(flavour), start(flavour)
    rows = []
    for k in range(40):
        two.apply(inputs(k + 500))
        two.step()
        rows.append(run(one, inputs, k, k + 1)[0])
    np.testing.assert_array_equal(np.array(rows), alone)


def test_reset_equals_a_fresh_instance(start, inputs) -> None:
    fresh = run(start(), inputs, 0, 40)
    used = start()
    run(used, inputs, 300, 340)
    used.fmu.reset()
    used.fmu.setupExperiment(startTime=0.0)
    used.fmu.enterInitializationMode()
    used.fmu.exitInitializationMode()
    used.time = 0.0
    np.testing.assert_array_equal(run(used, inputs, 0, 40), fresh)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_one_long_step_equals_short_ones_with_held_inputs(start, inputs, flavour) -> None:
    short, long = start(flavour), start(flavour)
    for instance, steps in ((short, 12), (long, 1)):
        instance.apply(inputs(5))
        for _ in range(steps):
            instance.step(12 * instance.period / steps)
    np.testing.assert_array_equal(short.values(), long.values())


def test_steps_shorter_than_a_sample_run_each_instant_once(start, inputs) -> None:
    """A third of a sample period does not divide it in binary; after 30 steps ten samples ran."""
    whole, thirds = start(), start()
    for instance, h in ((whole, whole.period), (thirds, thirds.period / 3)):
        instance.apply(inputs(5))
        for _ in range(round(10 * instance.period / h)):
            instance.step(h)
    np.testing.assert_array_equal(whole.values(), thirds.values())
