"""What the items measure, beside what the papers have. Bounds are what is reached, not the wish."""

import json

import numpy as np
import pytest

from harness.reproduce.experiments.stack import FINE_RATE, off_line, operator, respond, sine
from tests.harness.reproduce.conftest import measured, run_item


def test_reach_and_speed_are_those_of_table_6_1_but_along_y():
    outcome = run_item("table-6.1")
    assert measured(outcome, "displacement along x") == pytest.approx(1108, abs=1)
    assert measured(outcome, "displacement along y") == pytest.approx(960, abs=1)  # not 1000
    assert measured(outcome, "displacement along z") == pytest.approx(120, abs=0.1)
    assert measured(outcome, "velocity along x") == pytest.approx(22.2, abs=0.1)
    assert measured(outcome, "velocity along y") == pytest.approx(19.2, abs=0.1)  # not 20
    assert measured(outcome, "velocity along z") == pytest.approx(2.4, abs=0.01)
    assert 100 < measured(outcome, "largest sphere") < 120


def test_the_tremor_sphere_of_figure_6_7_lies_in_the_workspace():
    outcome = run_item("figure-6.7")
    assert measured(outcome, "largest sphere") > 50
    boundary = outcome.plots[0].figure.data[0]
    points = np.column_stack((boundary.x, boundary.y, boundary.z))
    nearest = np.linalg.norm(points, axis=1).min()
    # Points of the boundary cannot be nearer than the sphere that fits, nor much farther.
    assert 0.99 * measured(outcome, "largest sphere") / 2 < nearest < 70


def test_the_boundary_of_the_workspace_is_closed():
    """Every edge of its triangles lies between two of them, coinciding points counted as one."""
    from harness.reproduce.experiments.workspace import workspace

    reach = workspace()
    names = {}
    merged = [
        names.setdefault(tuple(np.round(p * 1e9).astype(int)), len(names)) for p in reach.points
    ]
    edges = {}
    for triangle in reach.triangles:
        for a, b in zip(triangle, np.roll(triangle, 1), strict=True):
            edge = tuple(sorted((merged[a], merged[b])))
            edges[edge] = edges.get(edge, 0) + 1
    assert set(edges.values()) == {2}


def test_loops_widen_with_the_rate_as_in_figure_7_1():
    outcome = run_item("figure-7.1")
    assert measured(outcome, "static positioning") == pytest.approx(15, abs=1)
    assert measured(outcome, "width", "19 Hz") > 1.1 * measured(outcome, "width", "; 1 Hz")
    assert measured(outcome, "rms", "19 Hz") > 1.1 * measured(outcome, "rms", "; 1 Hz")


@pytest.mark.parametrize("name", ["figure-7.5", "figure-7.6", "figure-7.7"])
def test_operators_are_those_of_the_equations(name):
    outcome = run_item(name)
    assert len(outcome.figures) >= 2
    for figure in outcome.figures:
        assert figure.measured == pytest.approx(figure.paper, rel=1e-6)


def test_the_identified_operator_lies_over_the_measured_response_of_figure_7_8():
    outcome = run_item("figure-7.8")
    for source, bound in (("saw-tooth", 0.13), ("same sine", 0.11)):
        assert 0.07 < measured(outcome, "rms of measured", source) < bound
    assert measured(outcome, "travel of") == pytest.approx(12.5, abs=0.05)


def test_the_inverse_is_the_mirror_image_of_figure_7_10():
    outcome = run_item("figure-7.10")
    assert measured(outcome, "mirror image") < 1e-3  # uV
    assert measured(outcome, "after its inverse") < 1e-6  # nm


@pytest.mark.slow
@pytest.mark.xdist_group("tracking")
def test_tracking_of_sines_is_better_than_in_table_7_1():
    """Each controller beside the thesis's; the best within what is wanted: 0.13 and 0.45 um."""
    outcome = run_item("table-7.1")
    mean = "mean over sines"
    assert measured(outcome, "rms error, without", mean) == pytest.approx(1.22, rel=0.05)
    assert measured(outcome, "rms error, rate-independent", mean) < 0.15
    assert measured(outcome, "rms error, rate-dependent", mean) < 0.12
    assert measured(outcome, "rms error, modulated", mean) < 0.085
    assert measured(outcome, "rms error with its mean") < 0.085
    assert measured(outcome, "largest error of all") < 0.45
    without = [f for f in outcome.figures if "without" in f.quantity and "Hz sine" in f.setting]
    for figure in without:
        assert figure.measured == pytest.approx(figure.paper, rel=0.1)
    assert len(without) == 7


@pytest.mark.slow
@pytest.mark.xdist_group("tracking")
def test_tracking_of_several_tones_is_better_than_in_table_7_2():
    """Wanted: 0.11 um, 0.45 um at the largest."""
    outcome = run_item("table-7.2")
    assert measured(outcome, "rms error, rate-independent") < 0.18
    assert measured(outcome, "rms error, rate-dependent") < 0.1
    assert measured(outcome, "rms error with its mean") < 0.09
    assert measured(outcome, "largest error of all") < 0.45


@pytest.mark.slow
@pytest.mark.xdist_group("tracking")
def test_tracking_of_recorded_tremor_is_better_than_in_table_7_3(data_dir):
    """Wanted: 0.12 um, 0.45 um at the largest."""
    outcome = run_item("table-7.3", data_dir)
    assert measured(outcome, "rms error, rate-independent") < 0.18
    assert measured(outcome, "rms error, rate-dependent") < 0.1
    assert measured(outcome, "rms error with its mean") < 0.09
    assert measured(outcome, "largest error of all") < 0.45


@pytest.mark.slow
@pytest.mark.xdist_group("tracking")
def test_slopes_of_slow_and_wide_plays_go_along_lines_as_in_figure_7_11():
    outcome = run_item("figure-7.11")
    assert measured(outcome, "largest rms distance") < 0.07
    for play in range(2, 9):
        assert measured(outcome, f"W_{play}") == pytest.approx(1, abs=0.2)
    assert measured(outcome, "W_1") < 0.7


@pytest.mark.slow
@pytest.mark.xdist_group("tracking")
def test_the_error_budget_names_what_costs_most():
    outcome = run_item("error-budget")
    whole = measured(outcome, "all of it")
    assert measured(outcome, "no sensor noise while") < 0.5 * whole
    assert measured(outcome, "creep left out") > 1.3 * whole
    assert measured(outcome, "4 stops") > 1.2 * whole
    drifted = measured(outcome, "gain 1 % off", "after 10 s")
    assert drifted > 1.5 * whole
    assert measured(outcome, "gain adapted") < 1.15 * whole
    assert measured(outcome, "loops 5 % wider") > 1.5 * whole


@pytest.mark.parametrize("name", ["table-6.1", "figure-7.6"])
def test_an_item_gives_the_same_twice(name):
    first, second = run_item(name), run_item(name)
    assert json.dumps([f.entry() for f in first.figures]) == json.dumps(
        [f.entry() for f in second.figures]
    )


def test_the_bench_holds_a_voltage_and_reads_at_the_end_of_the_sample():
    """A held voltage seen at 1 kHz is the fine response at the ends of its samples."""
    volts = np.repeat([0.0, 30.0, 60.0, 20.0], 5)
    fine = respond(np.repeat(volts, 10), 10_000.0)
    np.testing.assert_array_equal(respond(volts), fine[9::10])


def test_the_sine_of_the_bench_has_the_travel_of_the_thesis():
    """And, where nothing holds the voltage, its distance from a line: 1.19 um in Table 7.1."""
    volts, stroke = sine(10.0, 2)
    assert len(volts) == 200
    assert np.ptp(stroke) == pytest.approx(12.5e-6, rel=5e-3)
    assert np.std(off_line(*sine(10.0, 2, FINE_RATE))) == pytest.approx(1.19e-6, rel=0.05)


def test_the_operator_of_the_bench_follows_the_definition():
    """Against (7.1), (7.4), (7.8) written out."""
    volts = 60 * np.sin(np.linspace(0, 12, 400))
    thresholds, weights = (0.0, 7.0, 21.0), (0.5, 0.3, 0.2)
    zones, saturation = (0.0, 20.0), (1.0, -0.4)
    plays = np.zeros(3)
    expected = []
    for v in volts:
        plays = np.maximum(v - np.array(thresholds), np.minimum(v + np.array(thresholds), plays))
        y = np.dot(weights, plays)
        expected.append(saturation[0] * y + saturation[1] * max(y - zones[1], 0))
    np.testing.assert_allclose(
        operator(volts, thresholds, weights, zones, saturation), expected, atol=1e-9
    )
