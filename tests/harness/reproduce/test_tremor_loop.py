"""The bench of chains in the loop, on a short loop and a made-up hand."""

import numpy as np
import pytest

from harness.reproduce.item import Context
from harness.reproduce.papers.a04 import tremor_loop

SHORT = """
extends = "closed_loop"
seconds = 6.0
[variant.adaptive.part.controller]
tremor_filter = 3
[variant.still.part.controller]
tremor_filter = 4
"""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """Two variants, one of which corrects nothing, on one hand and on the generator."""
    folder = tmp_path_factory.mktemp("data")
    (folder / tremor_loop.HANDS).mkdir()
    time = np.arange(0.0, 8.0, 4e-3)
    tone = 20e-6 * np.sin(2 * np.pi * 9.0 * time[:, None] + np.arange(3.0))
    np.savetxt(
        folder / tremor_loop.HANDS / "hand.csv",
        np.column_stack((time, tone)),
        delimiter=",",
        header="time [s],x [m],y [m],z [m]",
        comments="",
    )
    scenario = folder / "short.toml"
    scenario.write_text(SHORT)
    shares = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tremor_loop, "BENCHES", {str(scenario): "data-sheet noise"})
        found = tremor_loop.run(Context(lambda share, _: shares.append(share), folder))
    assert shares == sorted(shares)
    assert shares[-1] < 1
    return found


def test_chains_are_ranked_on_hands_and_generator(outcome):
    figures = {(f.quantity, f.setting): f.measured for f in outcome.figures}
    assert len(figures) == 2 * 2 * 2 * 2  # definition, mean and worst, variant, motion
    for motion in ("recorded hands", "generator"):
        setting = f"{motion}, data-sheet noise, 1 run"
        assert figures["reduction in band, mean: adaptive", setting] > 40
        assert figures["reduction in band, worst: still", setting] == pytest.approx(0, abs=0.5)


def test_the_plot_shows_what_is_ranked(outcome):
    (plot,) = outcome.plots
    bars = [trace for trace in plot.figure.data if trace.type == "bar"]
    assert [list(bar.y) for bar in bars] == [["still", "adaptive"]] * 2
