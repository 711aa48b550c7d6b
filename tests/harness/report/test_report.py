"""The report is one file that stands on its own."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import steadytip as st
from harness.report.figures import figures
from harness.results.metrics import MetricInputs


@pytest.fixture(scope="module")
def closed_loop(tmp_path_factory: pytest.TempPathFactory) -> st.Result:
    folder = tmp_path_factory.mktemp("loop")
    return st.run("closed_loop", out=folder, overrides={"seconds": 5.0})


def page_without_scripts(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    return re.sub(r"<script.*?</script>", "", text, flags=re.S)


def test_a_report_shows_everything_that_the_loop_has(closed_loop):
    page = page_without_scripts(closed_loop.report)
    for title in (
        "Tip error",
        "One second of it",
        "Spectra",
        "Voltages",
        "Hysteresis",
        "Attitude error",
        "Consistency of &#39;estimator&#39;",
        "Figures of merit",
        "The run",
        "Parts",
        "Scenario",
    ):
        assert f"<h2>{title}</h2>" in page
    for name, metric in closed_loop.metrics.items():
        assert f"<code>{name}</code>" in page
        assert metric.definition.split("|")[0][:30].replace("'", "&#39;") in page
    for part in closed_loop.metadata.parts.values():
        assert part["guid"] in page
        assert part["sha256"] in page
    assert "seconds = 5.0" in page  # the override


def test_attenuation_from_a_record_is_that_of_the_loop():
    """Noise as tremor, 0.8 of it cancelled 3 ms late, noise on the tip.

    Expected Result: |1 - 0.8 exp(-i w 3 ms)|, phase -w 3 ms.
    """
    step, n = 1e-3, 40_000
    generator = np.random.default_rng(1)
    low_pass = signal.butter(2, 25.0, fs=1 / step, output="sos")
    moved = 1e-5 * signal.sosfilt(low_pass, generator.normal(size=(n, 3)), axis=0)
    tip = moved - 0.8 * np.vstack([np.zeros((3, 3)), moved[:-3]])
    tip += 1e-7 * generator.normal(size=(n, 3))
    drawn = figures(
        np.arange(n) * step, MetricInputs(step=step, tip_uncompensated=moved, tip=tip), None, ()
    )
    (plot,) = (plot for plot in drawn if plot.title == "Attenuation")
    left, phase = plot.figure.data
    turns = 2j * np.pi * left.x * 3e-3
    np.testing.assert_allclose(left.y, np.abs(1 - 0.8 * np.exp(-turns)), atol=0.03)
    np.testing.assert_allclose(phase.y, -np.degrees(turns.imag), atol=3.0)


def test_a_report_loads_nothing_from_anywhere(closed_loop):
    page = page_without_scripts(closed_loop.report)
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#|data:)", page)
    assert "@import" not in page
    assert "<link" not in page


def test_a_scenario_without_roles_has_a_report_too(write_scenario, tmp_path):
    path = write_scenario('title = "a < b & c"\n[part.a]\nfmu = PROBE\n')
    page = page_without_scripts(st.run(path, out=tmp_path / "out").report)
    assert "<h1>a &lt; b &amp; c</h1>" in page
    assert "<h2>Tip error</h2>" not in page
    assert "<h2>Figures of merit</h2>" in page


def test_a_run_that_ended_early_says_so_in_its_report(write_scenario, tmp_path):
    path = write_scenario("[part.a]\nfmu = PROBE\nmode = 1\nat = 0.5\n")
    with pytest.raises(st.PartError) as caught:
        st.run(path, out=tmp_path / "out")
    page = page_without_scripts(caught.value.result.report)
    assert "The run ended early." in page
    assert "no more after 0.5 s" in page
