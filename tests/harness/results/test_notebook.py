"""A result in a notebook: tables, figures, and names that are nearly right."""

import numpy as np
import pytest

import steadytip as st


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("notebook") / "out"
    return st.run("closed_loop", overrides={"seconds": 3.5}, out=out, report=False)


def test_a_table_has_the_time_as_index_and_units_beside(result):
    frame = result.to_pandas()
    assert frame.index.name == "time [s]"
    assert list(frame.columns) == [name for name in result.columns if name != "time"]
    np.testing.assert_array_equal(frame["instrument.tip_x"], result.signals("instrument.tip_x"))
    assert frame.attrs["units"]["instrument.tip_x"] == "m"


def test_a_dataset_has_units_and_the_coordinate_time(result):
    data = result.to_xarray()
    np.testing.assert_array_equal(data["instrument.tip_x"], result.signals("instrument.tip_x"))
    np.testing.assert_array_equal(data["time"], result.time)
    assert data["instrument.tip_x"].attrs["units"] == "m"
    assert data.attrs["scenario"] == "closed_loop"
    assert data.sel(time=1.0, method="nearest")["time"] == pytest.approx(1.0)


def test_a_plot_has_a_panel_for_each_unit_and_a_curve_for_each_signal(result):
    figure = result.plot("instrument.tip_*", "controller.volts_1")
    assert [trace.name for trace in figure.data] == [
        *(f"instrument.tip_{axis}" for axis in "xyz"),
        "controller.volts_1",
    ]
    assert {trace.yaxis for trace in figure.data} == {"y", "y2"}
    assert figure.layout.yaxis.title.text == "[m]"
    assert len(result.plot().data) == 6  # the tip without and with compensation
    with pytest.raises(st.SteadytipError, match=r"instrument\.tip_w"):
        result.plot("instrument.tip_w")


def test_a_notebook_shows_figures_with_their_definitions(result):
    page = result._repr_html_()
    assert "<td>reduction_in_band</td>" in page
    assert "rms(bp(y))" in page
    assert "reduction_in_band" in repr(result.metrics)


def test_a_figure_that_is_nearly_called_so_is_suggested(result):
    with pytest.raises(KeyError, match="did you mean 'reduction_in_band'"):
        result.metrics["reduction_inband"]
    with pytest.raises(st.SteadytipError, match="no figure of merit is called 'x'"):
        result.metrics["x"]
    assert result.metrics.get("x") is None
    assert "x" not in result.metrics


def test_what_is_not_installed_says_how_to_get_it(result, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    for convert in (result.to_pandas, result.to_xarray):
        with pytest.raises(st.SteadytipError, match=r"pip install 'steadytip\[notebook\]'"):
            convert()
