"""NIS and NEES of runs whose estimators are as good, better and worse than they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import steadytip
from harness.parts.ports import Column
from harness.results.consistency import mean_interval
from harness.results.metrics import angle_between, rotation_between
from harness.results.recorder import Recorder
from harness.results.run_metadata import RunMetadata

STEP = 1e-3
SECONDS = 4.0
TIME = np.arange(round(SECONDS / STEP)) * STEP
ATTITUDES = {
    "attitude_true": [f"hand.attitude_{c}" for c in "wxyz"],
    "attitude_estimated": [f"filter.attitude_{c}" for c in "wxyz"],
}
POSITIONS = {
    "position_true": [f"hand.tip_{c}" for c in "xyz"],
    "position_estimated": [f"filter.tip_{c}" for c in "xyz"],
}


@pytest.fixture
def recorded(tmp_path):
    """A run with given signals, (n,) each by `part.port`."""

    def recorded(signals, step=STEP, settle=1.0, roles=None, sizes=None):
        columns = [
            Column(name, "Boolean" if values.dtype == bool else "Real", "", "")
            for name, values in signals.items()
        ]
        metadata = RunMetadata(
            step_size=step,
            warm_up=settle,
            parts={"hand": {}, "filter": {}},
            roles=roles or {},
            innovation_sizes=sizes or {},
        )
        recorder = Recorder(tmp_path, columns, step, metadata)
        for row in np.column_stack(list(signals.values())).astype(float):
            recorder.append(row)
        return steadytip.read(recorder.finish(metadata).parent)

    return recorded


def innovations(size, scale=1.0, seed=2, every=1):
    """NIS of a filter whose innovations are `scale` times as large as it expects, and its size."""
    taken = np.arange(len(TIME)) % every == 0
    size = np.where(taken, size, 0)
    draws = np.random.default_rng(seed).normal(size=(len(TIME), 6))
    squared = np.sum(np.where(np.arange(6) < size[:, np.newaxis], scale * draws, 0.0) ** 2, axis=1)
    return {"filter.innovation_squared": squared, "filter.innovation_size": size}


@pytest.mark.parametrize(
    ("scale", "said"), [(1.0, "consistent"), (1.2, "overconfident"), (0.8, "too cautious")]
)
def test_the_mean_tells_on_which_side_a_filter_is_wrong(recorded, scale, said):
    result = recorded(innovations(3, scale, every=5))
    (nis,) = result.consistency
    assert nis.verdict.endswith(said)
    assert nis.mean == pytest.approx(scale**2, abs=0.1)
    metrics = result.metrics
    assert metrics["filter.nis"].value == nis.mean
    assert metrics["filter.nis"].definition.endswith(nis.verdict)
    low, high = (metrics[f"filter.nis_{end}"].value for end in ("low", "high"))
    # 600 corrections after `settle`: the mean of 1800 squares, of variance 2 each.
    assert (low, high) == pytest.approx((1 - 1.96 * (2 / 1800) ** 0.5, 1 + 1.96 / 30), abs=2e-3)
    if said == "consistent":
        assert metrics["filter.nis_inside"].value == pytest.approx(95.0, abs=2.0)


def test_corrections_of_different_sizes_count_by_their_degrees_of_freedom(recorded):
    sizes = np.where(np.arange(len(TIME)) % 10 == 0, 6, np.where(np.arange(len(TIME)) % 2, 2, 0))
    (nis,) = recorded(innovations(sizes)).consistency
    assert nis.independent == 300 * 6 + 1500 * 2
    assert len(nis.squared) == 1800
    assert nis.verdict.endswith("consistent")
    assert nis.inside == pytest.approx(95.0, abs=2.0)


def test_intervals_hold_as_often_as_they_say():
    """300 consistent filters: their means lie in the interval in 95 % of the runs."""
    random = np.random.default_rng(3)
    inside = 0
    for _ in range(300):
        squared = random.chisquare(3, size=50)
        low, high = mean_interval(150.0)
        inside += low <= squared.sum() / 150 <= high
    assert 0.91 < inside / 300 < 0.98


def test_a_correction_that_is_held_over_several_ticks_counts_once(recorded):
    every = innovations(3)
    slow = {name: np.repeat(values[::4], 4) for name, values in every.items()}
    (nis,) = recorded(slow).consistency
    assert len(nis.squared) == 750


def test_what_the_estimator_does_not_vouch_for_does_not_count(recorded):
    signals = innovations(3)
    lost = (TIME > 2.0) & (TIME < 2.5)
    signals["filter.innovation_squared"] = np.where(
        lost | (TIME < 0.9), 1e4, signals["filter.innovation_squared"]
    )
    signals["filter.valid"] = ~lost
    (nis,) = recorded(signals).consistency
    assert nis.verdict.endswith("consistent")


def test_the_scenario_may_say_the_size(recorded):
    signals = innovations(3, every=2)
    del signals["filter.innovation_size"]
    assert recorded(signals).consistency == []
    (nis,) = recorded(signals, sizes={"filter": 3}).consistency
    assert (len(nis.squared), nis.size[0]) == (1500, 3)


def test_an_estimator_that_tells_nothing_has_no_figures(recorded):
    result = recorded({"filter.tip_x": np.sin(TIME), "hand.tip_x": np.sin(TIME)})
    assert result.consistency == []
    never = innovations(np.zeros(len(TIME), dtype=int))
    assert recorded(never).consistency == []
    # Less than a second is left: no basis for a figure, as with all others.
    assert recorded(innovations(3), settle=3.5).consistency == []


def poses(scale, memory, seed=2):
    """Attitude errors in the body with some memory [samples], `scale` times as large as stated."""
    random = np.random.default_rng(seed)
    keep = np.exp(-1.0 / memory)
    error = np.empty((len(TIME), 3))
    error[0] = random.normal(size=3)
    for k in range(1, len(error)):
        error[k] = keep * error[k - 1] + np.sqrt(1 - keep**2) * random.normal(size=3)
    sigma = np.radians([0.1, 0.5, 2.0])
    true = Rotation.from_rotvec(np.outer(TIME, [1.0, -2.0, 0.5]))
    # q = q_hat (x) exp(dtheta / 2)
    estimated = true * Rotation.from_rotvec(scale * sigma * error).inv()
    signals = {}
    for part, rotation in (("hand", true), ("filter", estimated)):
        quaternion = np.roll(rotation.as_quat(), 1, axis=1)
        signals |= {f"{part}.attitude_{c}": quaternion[:, i] for i, c in enumerate("wxyz")}
    stated = {
        f"filter.attitude_sigma_{c}": np.full(len(TIME), sigma[i]) for i, c in enumerate("xyz")
    }
    return signals | stated, error


@pytest.mark.parametrize(
    ("scale", "said"), [(1.0, "consistent"), (1.5, "overconfident"), (0.6, "too cautious")]
)
def test_attitude_errors_are_set_beside_their_stated_deviations_in_the_body(recorded, scale, said):
    """The deviations differ by axis, so that the error in another frame would not fit."""
    signals, error = poses(scale, memory=5)
    result = recorded(signals, roles=ATTITUDES)
    (nees,) = result.consistency
    assert nees.name == "filter.attitude_nees"
    counted = TIME >= 1.0
    np.testing.assert_allclose(
        nees.squared, scale**2 * np.sum(error[counted] ** 2, axis=1), rtol=1e-6
    )
    assert nees.verdict.endswith(said)
    assert {f"filter.attitude_nees{end}" for end in ("", "_low", "_high", "_inside")} <= set(
        result.metrics
    )


def test_errors_that_last_are_fewer_samples(recorded):
    """Of errors with a memory of tau samples, one in tau is independent: sum of exp(-2 k / tau)."""
    for memory in (5, 50):
        (nees,) = recorded(poses(1.0, memory)[0], roles=ATTITUDES).consistency
        assert nees.independent == pytest.approx(3 * 3000 / memory, rel=0.4)


def test_the_interval_of_lasting_errors_is_as_wide_as_it_has_to_be(recorded):
    inside = [
        recorded(poses(1.0, 100, seed)[0], roles=ATTITUDES).consistency[0].verdict
        for seed in range(30)
    ]
    assert sum(verdict.endswith("consistent") for verdict in inside) >= 26


def test_components_that_err_together_are_no_components_of_their_own(recorded):
    error = np.random.default_rng(2).normal(size=len(TIME))
    signals = {}
    for c in "xyz":
        signals |= {f"hand.tip_{c}": 1e-3 * TIME, f"filter.tip_{c}": 1e-3 * TIME + 1e-5 * error}
        signals[f"filter.tip_sigma_{c}"] = np.full(len(TIME), 1e-5)
    (nees,) = recorded(signals, roles=POSITIONS).consistency
    assert nees.independent == pytest.approx(3000, rel=0.1)
    assert nees.verdict.endswith("consistent")


def test_an_error_that_never_changes_is_a_single_sample(recorded):
    signals = {}
    for c in "xyz":
        signals |= {f"hand.tip_{c}": TIME, f"filter.tip_{c}": TIME + 2.0}
        signals[f"filter.tip_sigma_{c}"] = np.ones(len(TIME))
    (nees,) = recorded(signals, roles=POSITIONS).consistency
    assert nees.mean == pytest.approx(4.0)
    assert nees.independent < 2.0
    assert nees.verdict.endswith("consistent")


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_rotation_between_attitudes_takes_one_into_the_other(seed):
    a, b = Rotation.random(2, random_state=seed)
    qa, qb = (np.roll(r.as_quat(), 1)[np.newaxis] for r in (a, b))
    theta = rotation_between(qa, qb)
    np.testing.assert_allclose(
        (a * Rotation.from_rotvec(theta[0])).as_matrix(), b.as_matrix(), atol=1e-9
    )
    np.testing.assert_allclose(rotation_between(qa, -qb), theta, atol=1e-9)
    assert angle_between(qa, qb)[0] == pytest.approx((a.inv() * b).magnitude())


def test_a_size_without_innovations_is_told(write_scenario, tmp_path):
    said = []
    path = write_scenario("[part.a]\nfmu = PROBE\ninnovation_size = 3\n")
    steadytip.run(path, out=tmp_path / "out", report=False, status=said.append)
    assert any(
        "no NIS of 'a', whose 'innovation_size' is 3: it has no output 'innovation_squared'" in text
        for text in said
    )


def test_a_size_below_one_is_refused(write_scenario, tmp_path):
    path = write_scenario("[part.a]\nfmu = PROBE\ninnovation_size = 0\n")
    with pytest.raises(steadytip.SteadytipError, match=r"part\.a\.innovation_size' = 0"):
        steadytip.run(path, out=tmp_path / "out")
