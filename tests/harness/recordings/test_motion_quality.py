"""Every defect is found from the size on that the docs state, and a good recording has none."""

import numpy as np
import pytest

from harness.recordings.findings import FindingsError, refuse
from harness.recordings.motion import read_recording, recordings
from harness.recordings.motion_quality import assess_motion, interpolation_error
from tests.harness.recordings import hands


def place(row):
    return f"row {row}"


def names(time, position):
    return {finding.name for finding in assess_motion(time, position, place).findings}


@pytest.mark.parametrize("options", [{}, {"rate": 100.0}, {"rate": 1000.0}, {"noise": 1e-6}])
def test_a_good_recording_has_no_finding(options):
    for seed in range(10):
        assert names(*hands.draw_hand(seed, **options)) == set()


def test_recorded_hands_have_no_finding(data_dir):
    for path in recordings([data_dir / "hand_motion_m2s2"]):
        recording = read_recording(path)
        assert names(recording.time, recording.position) == set(), path


@pytest.mark.parametrize("name", hands.DEFECTS)
def test_a_defect_is_found_in_95_of_100_trials(name):
    insert, size, also = hands.DEFECTS[name]
    trials = 20
    found = 0
    for seed in range(trials):
        rng = np.random.default_rng(1000 + seed)
        seen = names(*insert(*hands.draw_hand(seed), size, rng))
        assert seen <= {name, *also}
        found += name in seen
    assert found >= 0.95 * trials


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "thousandth"), (1e6, "millionth"), (1e-3, "thousand times")]
)
def test_time_in_another_unit_is_refused_with_the_likely_one(factor, unit):
    time, position = hands.draw_hand(1)
    (finding,) = assess_motion(time * factor, position, place).findings
    assert (finding.name, finding.severity) == ("time-unit", "stop")
    assert unit in finding.text


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e-3])
def test_a_length_in_another_unit_is_refused(factor):
    time, position = hands.draw_hand(1)
    (finding,) = assess_motion(time, position * factor, place).findings
    assert (finding.name, finding.severity) == ("length-unit", "stop")


def test_even_times_take_the_place_of_noisy_stamps():
    time, position = hands.draw_hand(3)
    stamps, _ = hands.noisy_stamps(time, position, 1e-3, np.random.default_rng(1))
    used = assess_motion(stamps, position, place)
    assert [f.severity for f in used.findings] == ["repaired"]
    off = used.time - time
    assert np.std(off) < 0.1e-3  # from 1 ms
    assert used.position is position or np.array_equal(used.position, position)


def test_single_precision_stamps_after_hours_are_noisy_stamps():
    time, position = hands.draw_hand(3)
    stamps = (time + 20_000).astype(np.float32).astype(float)
    used = assess_motion(stamps, position, place)
    assert [f.name for f in used.findings] == ["noisy-clock"]
    assert np.std(used.time - time) < 0.1e-3


def test_uneven_samples_with_right_stamps_are_left_alone():
    time, position = hands.draw_hand(3)
    when, moved = hands.uneven_samples(time, position, 5e-4, np.random.default_rng(1))
    used = assess_motion(when, moved, place)
    assert [(f.name, f.severity) for f in used.findings] == [("uneven-clock", "note")]
    assert np.array_equal(used.time, when)


def test_noisy_stamps_and_lost_samples_are_told_apart():
    time, position = hands.draw_hand(3)
    rng = np.random.default_rng(1)
    stamps, _ = hands.noisy_stamps(time, position, 4e-4, rng)
    keep = rng.random(len(time)) > 0.02
    keep[[0, -1]] = True
    used = assess_motion(stamps[keep], position[keep], place)
    assert [f.name for f in used.findings] == ["noisy-clock", "lost-samples"]
    assert np.std(used.time - time[keep]) < 0.1e-3


def test_held_samples_are_used_once_each():
    time, position = hands.draw_hand(3, rate=100.0)
    used = assess_motion(*hands.held(time, position, 10, None), place)
    assert [f.name for f in used.findings] == ["held-samples"]
    assert np.array_equal(used.position, position[: len(used.position)])
    assert len(used.time) >= len(time) - 1


def test_a_glitch_is_named_with_place_and_size():
    time, position = hands.draw_hand(3)
    position[1234, 1] += 2e-4
    (finding,) = assess_motion(time, position, place).findings
    assert (finding.name, finding.severity) == ("glitch", "stop")
    assert "y is off by 0.2 mm" in finding.text
    assert finding.where == "row 1234, at 4.9360 s"


def test_a_jump_is_no_glitch():
    time, position = hands.draw_hand(3)
    position[1234:, 1] += 2e-4
    (finding,) = assess_motion(time, position, place).findings
    assert (finding.name, finding.severity) == ("jump", "stop")
    assert "y jumps by 0.2 mm" in finding.text
    assert finding.where == "row 1234, at 4.9360 s"


def test_a_glitch_is_repaired_where_that_is_asked_for():
    time, position = hands.draw_hand(3)
    bad = position.copy()
    bad[1234, 1] += 2e-4
    used = assess_motion(time, bad, place, ["glitch"])
    assert [(f.name, f.severity) for f in used.findings] == [("glitch", "repaired")]
    assert np.abs(used.position - position).max() < 2e-6
    assert abs(bad[1234, 1] - position[1234, 1]) > 1e-4  # the recording itself is left alone


def test_a_planar_recording_is_no_defect():
    time, position = hands.draw_hand(3)
    position[:, 2] = 0.0
    assert names(time, position) == set()


def test_a_small_glitch_does_not_stop_a_run():
    time, position = hands.draw_hand(3)
    position[1234, 1] += 6e-6
    (finding,) = assess_motion(time, position, place).findings
    assert (finding.name, finding.severity) == ("glitch", "note")


@pytest.mark.parametrize(("rate", "severity"), [(20.0, "stop"), (30.0, "stop"), (45.0, "note")])
def test_a_rate_below_the_band_is_found(rate, severity):
    found = assess_motion(*hands.draw_hand(3, rate=rate), place).findings
    assert [(f.name, f.severity) for f in found] == [("sampled-too-slowly", severity)]


def test_coarse_values_are_found_and_nothing_else():
    time, position = hands.draw_hand(3)
    assert names(time, np.round(position / 1e-6) * 1e-6) == set()
    assert names(time, np.round(position / 1e-5) * 1e-5) == {"coarse"}


def test_a_motionless_recording_says_so_and_does_not_stop():
    time, position = hands.draw_hand(3)
    (finding,) = assess_motion(time, np.zeros_like(position), place).findings
    assert (finding.name, finding.severity) == ("no-motion", "note")


def test_the_interpolation_error_of_a_cubic_is_zero_at_uneven_times():
    time = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 50))
    values = np.column_stack([time**3 - 4 * time, 2 + time**2])
    assert np.abs(interpolation_error(time, values)).max() < 1e-9 * values.max()


def test_accepting_a_finding_by_name_goes_on():
    time, position = hands.draw_hand(3)
    position[1234, 1] += 2e-4
    findings = assess_motion(time, position, place).findings
    with pytest.raises(FindingsError, match=r"row 1234.*--accept glitch") as raised:
        refuse("hand.csv", findings)
    assert raised.value.findings == findings
    refuse("hand.csv", findings, {"glitch"})
