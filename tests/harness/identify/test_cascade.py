"""Training of the cascade neural filter: by NDEKF, on known systems, and as a command."""

import re

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from fmu_src.kit.runner import Runner
from fmu_src.tremor.cascade_neural import ACTIVATIONS, MODEL, SAMPLE_PERIOD
from harness.identify.tremor_nn import fit as neural
from harness.identify.tremor_nn.cascade import (
    RATE,
    Architecture,
    Network,
    Node,
    Training,
    pseudo_motion,
    train,
    train_filter,
)
from harness.identify.tremor_nn.ndekf import train_output, train_pool
from harness.identify.tremor_nn.read import read_trials
from harness.parts.ssv import read_ssv
from tests.harness.identify.commands import write_csv

QUICK = Training(epochs=2, every=10, copies=1, output_covariance=1e-2)
SMALL = Architecture(inputs=8, hidden=2, spacing=5)
HEADINGS = ["time [s]", "x [mm]", "y [mm]", "z [mm]"]


def _hand(seconds=12.0, seed=5):
    """Drift, and a tremor on it, (n, 3) [m]."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE)
    time = np.arange(count) * SAMPLE_PERIOD
    drift = np.cumsum(rng.standard_normal((count, 3)), axis=0) * 2e-6
    return drift + 2e-5 * np.sin(2 * np.pi * 9.0 * time)[:, None]


def _random_network(seed):
    rng = np.random.default_rng(seed)
    size = Architecture(*map(int, (rng.integers(1, 101), rng.integers(0, 11), rng.integers(1, 6))))
    nodes = tuple(
        Node(int(rng.integers(1, 5)), rng.normal(0, 0.3, size.inputs + 1 + k))
        for k in range(size.hidden)
    )
    out = rng.normal(0, 0.3, size.inputs + 1 + size.hidden)
    return Network(size, 1.3e-4, nodes, (out,), (0.0,))


@pytest.mark.parametrize("seed", range(4))
def test_the_model_is_the_network_of_the_trainer(seed):
    network, place = _random_network(seed), [1e-4, 0.0, -3e-4]
    motion = 0.3 * _hand(2.2, seed)
    run = Runner(MODEL, network.parameters(place)).run(len(motion), {"position": motion + place})
    lead = network.architecture.lead
    for axis in range(3):
        found = run["motion"][lead:, axis] - place[axis]
        np.testing.assert_allclose(found, network.filtered(motion[:, axis]), atol=1e-15)


def test_windows_hold_the_newest_first_and_nothing_of_the_future():
    windows = Architecture(inputs=4, spacing=3).windows(np.arange(30.0))
    np.testing.assert_array_equal(windows[0], [9, 6, 3, 0])
    np.testing.assert_array_equal(windows[-1], [29, 26, 23, 20])


def _sample_by_sample(zeta, wanted, w, v, covariances, noise, drift, activation):
    """The filter of one candidate as A04 5.3.2 prints it."""
    P, S = (np.diag(each) for each in covariances)
    P = P[:-1, :-1]
    for row, target in zip(zeta, wanted, strict=True):
        into = np.append(row, activation.value(w @ row, np))
        psi = v[-1] * activation.slope(w @ row, np)
        A = 1 / (noise + psi**2 * (row @ P @ row) + into @ S @ into)
        miss = target - v @ into
        w, v = w + A * psi * miss * (P @ row), v + A * miss * (S @ into)
        P = P - A * psi**2 * np.outer(P @ row, P @ row) + drift * np.eye(len(w))
        S = S - A * np.outer(S @ into, S @ into) + drift * np.eye(len(v))
    return np.append(w, 0.0), v


@pytest.mark.parametrize("drift", [0.0, 1e-4])
def test_samples_taken_by_blocks_give_the_filter_of_the_thesis(drift):
    rng = np.random.default_rng(8)
    zeta, wanted = rng.standard_normal((45, 5)), rng.standard_normal(45)
    weights = rng.normal(0, 0.5, (2, 2 * len(ACTIVATIONS), 6))
    covariances = rng.uniform(0.1, 0.5, (2, 6))
    found = train_pool(zeta, wanted, weights, covariances, 0.3, drift)
    for k in range(weights.shape[1]):
        w, v = weights[0, k, :-1], weights[1, k]
        activation = list(ACTIVATIONS.values())[k // 2]
        expected = _sample_by_sample(zeta, wanted, w, v, covariances, 0.3, drift, activation)
        np.testing.assert_allclose(found[0, k, :-1], expected[0][:-1], atol=1e-12)
        np.testing.assert_allclose(found[1, k], expected[1], atol=1e-12)


def test_an_output_ends_as_sample_by_sample():
    rng = np.random.default_rng(9)
    zeta, wanted, start = rng.standard_normal((70, 4)), rng.standard_normal(70), np.arange(4.0)
    at_once, in_turn = (train_output(zeta, wanted, start, 0.3, 0.2, q) for q in (0.0, 1e-15))
    np.testing.assert_allclose(at_once, in_turn, atol=1e-12)


def test_a_linear_system_is_found_as_least_squares_find_it():
    """Without hidden units and drift, the filter is recursive least squares with a prior."""
    rng = np.random.default_rng(2)
    u = rng.standard_normal((500, 6))
    t = u @ [0.5, -0.2, 0.0, 0.1, 0.3, 0.0] + 0.2 + 0.05 * rng.standard_normal(500)
    how = Training(epochs=1, noise=0.1, output_covariance=0.5)
    network = train(lambda epoch: (u, t), Architecture(6, 0, 1), 1.0, how)
    zeta = np.column_stack((u, np.ones(500)))
    prior = how.noise / how.output_covariance * np.eye(7)
    np.testing.assert_allclose(
        network.outputs[0], np.linalg.solve(zeta.T @ zeta + prior, zeta.T @ t), atol=1e-10
    )


def test_hidden_units_learn_what_no_linear_filter_can():
    """A known system with a sine in it: most of what linear connections leave goes."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, (600, 3))
    t = 0.4 * u[:, 0] + np.sin(2.0 * u[:, 1] - 1.5 * u[:, 2] + 0.5)
    how = Training(
        epochs=2, noise=0.05, output_covariance=1.0, hidden_covariance=0.3, copies=2, drift=1e-6
    )
    network = train(lambda epoch: (u, t), Architecture(3, 3, 1), 1.0, how)
    assert network.errors[0] > 0.15
    assert network.errors[-1] < 0.25 * network.errors[0]
    assert all(b <= 1.02 * a for a, b in zip(network.errors, network.errors[1:], strict=False))
    # What stays of each stage is the network as it was.
    shorter = train(lambda epoch: (u, t), Architecture(3, 1, 1), 1.0, how)
    np.testing.assert_array_equal(network.cut(1).outputs[-1], shorter.outputs[-1])


def test_one_seed_gives_one_network_and_another_another():
    error = _hand(8.0)[:, 0]
    one, same = (train_filter([error], 1e-4, SMALL, QUICK) for _ in range(2))
    other = train_filter([error], 1e-4, SMALL, Training(epochs=2, copies=1, seed=2))
    np.testing.assert_array_equal(one.outputs[-1], same.outputs[-1])
    assert [n.kind for n in one.nodes] == [n.kind for n in same.nodes]
    assert not np.array_equal(one.outputs[-1], other.outputs[-1])


def test_a_filter_trained_on_motion_or_error_takes_the_error_away():
    """On an error that a filter can tell, a tone above the motion; both tell the motion."""
    time = np.arange(round(10 * RATE)) * SAMPLE_PERIOD
    error = 1e-4 * np.sin(2 * np.pi * 4.0 * time)
    for target in ("motion", "error"):
        network = train_filter([error], 1e-4, Architecture(30, 1, 5), QUICK, target)
        assert neural.score(network, [error], 1e-4).reduction > 80


def test_the_motion_that_is_made_up_is_slow_and_as_large_as_wanted():
    motion = pseudo_motion(20_000, 1e-4, np.random.default_rng(1))
    assert np.std(motion) == pytest.approx(1e-4)
    power = np.abs(np.fft.rfft(motion)) ** 2
    frequency = np.fft.rfftfreq(len(motion), SAMPLE_PERIOD)
    assert power[frequency > 1.5].sum() < 0.01 * power.sum()
    assert power[frequency > 0.5].sum() > 0.3 * power.sum()


# The command --------------------------------------------------------------------------------------


def _write(path, position):
    time = np.arange(len(position)) * SAMPLE_PERIOD
    return write_csv(path, np.column_stack((time, 1e3 * position)), HEADINGS, "%.6f")


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    return _write(tmp_path_factory.mktemp("hand") / "still.csv", _hand(6.0))


SIZE = ("--inputs", 8, "--hidden", 1, "--epochs", 2)


def test_a_recording_becomes_a_set_that_a_run_accepts(still, tmp_path, identify):
    import steadytip as st

    out = tmp_path / "sets" / "nn.ssv"
    shown = identify.accepts("tremor-nn", still, "--test", still, *SIZE, "-o", out)
    assert f"parameters: {out}" in shown
    for role in ("trained", "rest", "other"):
        assert f"mean {role} " in shown
    values = read_ssv(out)
    assert values["unit_1.kind"].value in (1, 2, 3, 4)
    assert values["unit_2.kind"].value == 0
    assert values["input_scale"].unit == "m"
    assert not any(name.startswith("origin") for name in values)
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    page = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    for title in ("By hidden units", "Before and after"):
        assert f"<h3>{title}</h3>" in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#|data:)", page)

    scenario = tmp_path / "one.toml"
    scenario.write_text('seconds = 0.1\nstep_size = 4e-3\n[part.filter]\nfmu = "CascadeNeural"\n')
    result = st.run(
        scenario,
        overrides={"part.filter.parameters": str(out)},
        out=tmp_path / "out",
        report=False,
    )
    used = result.metadata.parts["filter"]["start_values"]
    assert used["output.weights[3]"] == values["output.weights[3]"].value


def test_mistakes_end_with_2_and_say_what_to_do(still, tmp_path, identify):
    rest = _write(tmp_path / "rest.csv", np.zeros((1500, 3)))
    for arguments, message in (
        ([tmp_path / "no.csv"], "no.csv does not exist"),
        ([still, "--inputs", 101], "--inputs 101: must be in [1, 100], which is what the model"),
        ([still, "--hidden", 11], "--hidden 11: must be in [0, 10]"),
        ([still, "--spacing", 0], "--spacing 0: must be in [1, 5]"),
        ([still, "--axes", "xq"], "--axes xq: must be some of xyz, each once"),
        ([still, "--epochs", 0], "--epochs 0: must be in [1, 1000]"),
        ([still, "--intent", -3], "--intent -3: must be above 0"),
        ([still, "--seed", -1], "--seed -1: must be 0 or more"),
        ([still, "--fit", "half"], "--fit half: write START:END in seconds"),
        ([still, "--fit", "0:2", "--inputs", 100], "501 samples at 250 Hz, and the window is 496"),
        ([still, "--out", tmp_path / "x.csv"], "a parameter set ends in .ssv"),
        (
            [rest, "--axes", "y"],
            "does not move at all; nothing can be learnt from it, leave the axis out",
        ),
    ):
        assert message in identify.refuses("tremor-nn", *arguments)


def test_a_hand_that_moves_is_told(tmp_path, identify):
    moving = _write(tmp_path / "moving.csv", 60 * _hand(6.0))
    shown = identify.accepts(
        "tremor-nn", moving, *SIZE, "--axes", "x", "-o", tmp_path / "m.ssv", "--no-report"
    )
    assert "mm rms, which is more than holding still" in shown


def test_other_rates_are_brought_to_that_of_the_model(tmp_path):
    fast = np.linspace(0, 4, 4001)
    slow = 1e-4 * np.column_stack([np.sin(2 * np.pi * f * fast) for f in (0.5, 1.0, 2.0)])
    table = np.column_stack((fast, 1e3 * slow))
    path = write_csv(tmp_path / "fast.csv", table, HEADINGS, "%.9f")
    (trial,) = read_trials(path, "y", "100%")
    expected = slow[::4, 1] - slow[::4, 1].mean()
    np.testing.assert_allclose(trial.error, expected, atol=1e-10)


def test_trials_that_cannot_be_trained_on_are_refused():
    with pytest.raises(
        SteadytipError, match="trial 1: 50 samples at 250 Hz, and the window is 36 long"
    ):
        train_filter([np.arange(50.0)], 1e-4, SMALL)
    with pytest.raises(SteadytipError, match="trial 1: does not move at all"):
        train_filter([np.zeros(500)], 1e-4, SMALL)
