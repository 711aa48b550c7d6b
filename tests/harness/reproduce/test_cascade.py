"""The protocol of A04 5.3.3: trained on one trial, tested on others. Bounds are what is reached."""

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from harness.identify.tremor_nn.cascade import RATE, Architecture, Network, Training
from harness.identify.tremor_nn.fit import unseen_motion
from harness.identify.tremor_nn.read import StillTrial
from harness.reproduce.catalogue import chosen, items
from harness.reproduce.experiments import cascade
from harness.reproduce.experiments.cascade import Hand, protocol
from tests.harness.reproduce.conftest import measured, run_item

WANTED = 39.5
"""Mean reduction of the thesis [%]."""


def _recording(folder, name, seconds, seed):
    count = round(seconds * RATE)
    rng = np.random.default_rng(seed)
    xyz = 5.0 + np.cumsum(rng.standard_normal((count, 3)), axis=0) * [1e-3, 2e-3, 6e-3]
    rows = np.column_stack((np.arange(count), xyz, np.full(count, 200.0)))
    np.savetxt(folder / f"{name}.csv", rows, "%.6f", ",")


@pytest.fixture
def folder(tmp_path):
    for k, name in enumerate(("N_pointing_an01", "N_pointing_an02", "S_pointing_de02")):
        _recording(tmp_path, name, 17.0, k)
    _recording(tmp_path, "S_tracing_de02", 17.0, 9)
    return tmp_path


def test_trials_are_the_axes_of_all_recordings_of_a_hand_on_a_point(folder):
    bench = protocol(folder)
    assert [hand.name for hand in bench.hands] == ["N an", "S de"]
    assert [len(hand.trials) for hand in bench.hands] == [6, 3]
    for hand in bench.hands:
        assert len(hand.tests) == len(hand.trials) - 1
        assert hand.trained not in hand.tests
        for trial in hand.trials:
            assert len(trial.error) == 16 * RATE
            assert trial.error.mean() == pytest.approx(0.0, abs=1e-12)
    assert bench.rms == pytest.approx(
        np.mean([np.std(trial.error) for hand in bench.hands for trial in hand.trials])
    )


def test_the_trial_that_is_trained_on_is_the_middling_one():
    trials = tuple(StillTrial(str(k), k * np.array([-1.0, 1.0])) for k in (1, 4, 9))
    assert Hand("h", trials).trained.name == "4"


def test_scores_are_those_of_motions_that_no_training_sees(folder):
    """Passing everything reduces nothing; passing nothing leaves the motion."""
    bench = protocol(folder)
    hand, size = bench.hands[0], Architecture(1, 0, 1)
    passes = Network(size, 1.0, (), (np.array([1.0, 0.0]),), (0.0,))
    silent = Network(size, 1.0, (), (np.zeros(2),), (0.0,))
    assert bench.score(passes, hand.tests).reduction == pytest.approx(0.0, abs=1e-9)
    raw = np.mean([trial.rms for trial in hand.tests])
    expected = 100 * (1 - bench.rms / raw)
    assert bench.score(silent, hand.tests).reduction == pytest.approx(expected)
    how = Training(epochs=1, copies=1)
    error = hand.trained.error
    assert not np.array_equal(
        unseen_motion(len(error), bench.rms, how.seed, 0),
        unseen_motion(len(error), bench.rms, how.seed, 1),
    )


def test_recordings_that_cannot_be_compared_are_refused(tmp_path):
    _recording(tmp_path, "S_pointing_de02", 17.0, 1)
    with pytest.raises(SteadytipError, match="holds recordings of 1 hands on a point"):
        protocol(tmp_path)
    short = tmp_path / "short"
    short.mkdir()
    _recording(short, "S_pointing_de02", 5.0, 1)
    with pytest.raises(SteadytipError, match="lasts 5 s, and a trial is 16 s"):
        protocol(short)


def test_the_tables_need_recordings():
    known = chosen(["neural-filter"], items())
    assert [item.name for item in known] == ["table-5.1", "table-5.2", "table-5.3"]
    assert all(item.missing(None) for item in known)
    assert chosen(["5.7b"], items()) == [known[1]]


@pytest.fixture(scope="module")
def outcomes(data_dir):
    """Tables with one architecture; the search for the best is for `steadytip reproduce`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cascade, "GRID", (cascade.ONE_FOR_ALL.inputs,))
        return {
            item.name: run_item(item.name, data_dir) for item in chosen(["neural-filter"], items())
        }


@pytest.mark.slow
@pytest.mark.xdist_group("cascade")
def test_the_error_of_other_trials_is_reduced_as_far_as_told(outcomes):
    """Wanted: 39.5 %, and not reached: a linear filter that knows the tests has no more than 40."""
    outcome = outcomes["table-5.1"]
    best = measured(outcome, "of the rmse; mean", "best architecture of each")
    fixed = measured(outcome, "for all")
    ceiling = measured(outcome, "fitted to the tests")
    printed = measured(outcome, "trained as printed")
    assert printed + 5 < fixed <= best < ceiling
    assert fixed == pytest.approx(38.0, abs=0.7)
    assert best == pytest.approx(38.3, abs=0.7)
    assert best < WANTED < ceiling < WANTED + 2


@pytest.mark.slow
@pytest.mark.xdist_group("cascade")
def test_targets_make_no_difference_with_one_architecture(outcomes):
    """With connections from every input to the output, motion and error are one target."""
    outcome = outcomes["table-5.2"]
    motion = measured(outcome, "NN_vm; mean", "50 inputs")
    error = measured(outcome, "NN_err; mean")
    assert error == pytest.approx(motion, abs=2)
    assert error > 29.9  # what the thesis has for it


@pytest.mark.slow
@pytest.mark.xdist_group("cascade")
def test_networks_of_other_hands_do_worse_in_the_mean(outcomes):
    outcome = outcomes["table-5.3"]
    own = measured(outcome, "network of the same hand")
    others = measured(outcome, "network of another hand")
    assert others < own
    assert others > 34.5
    assert 0 <= measured(outcome, "worse than no filter") <= 30
    assert len([f for f in outcome.figures if "trained on" in f.quantity]) == 25
