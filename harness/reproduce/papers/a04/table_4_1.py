"""A04 table 4.1: tilt by the linear and by the physical model of the accelerometers."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import SERIES, grid, line
from harness.reproduce.experiments import tilt
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "A04 table 4.1"
PAPER = {
    ("linear", "alpha", "rms"): 2.88,
    ("linear", "alpha", "largest"): 3.95,
    ("linear", "beta", "rms"): 1.64,
    ("linear", "beta", "largest"): 2.36,
    ("physical", "alpha", "rms"): 0.32,
    ("physical", "alpha", "largest"): 0.82,
    ("physical", "beta", "rms"): 0.60,
    ("physical", "beta", "largest"): 0.82,
}
"""[deg]"""


def run(context: Context) -> ItemResult:
    """Calibrate a raw unit on the turntable and turn it through the three sweeps."""
    context.progress(0.0, "calibrating")
    models = tilt.identified()
    context.progress(0.8, "testing")
    found = tilt.sweep(models)
    setting = (
        f"simulated; three sweeps of {tilt.STEP:g} deg steps, {tilt.SHIFT:g} deg off the angles of "
        "the calibration, means of 500 samples"
    )
    rows: list[Row] = []
    for name, errors in found.items():
        for angle, values in errors.counted().items():
            degrees = np.degrees(values)
            for what, value in (
                ("rms", np.sqrt(np.mean(degrees**2))),
                ("largest", np.abs(degrees).max()),
            ):
                paper = PAPER.get((name, angle, what))
                rows.append((f"{what} error of {angle}, {name} model", "deg", paper, value))
        quantity = f"rms error of the attitude with its heading, {name} model"
        rows.append((quantity, "deg", None, np.degrees(np.sqrt(np.mean(errors.attitude**2)))))

    titles = ["alpha alone", "beta alone", "both at once"]
    angles = np.arange(-180.0 + tilt.SHIFT, 180.0, tilt.STEP)
    panels = [
        [
            line(angles, np.degrees(getattr(found[name], angle)[column]), colour,
                 f"{angle}, {name}", mode="lines+markers", dash=dash)
            for name, colour in zip(("linear", "physical"), SERIES, strict=False)
            for angle, dash in (("alpha", "solid"), ("beta", "dot"))
        ]
        for column in range(3)
    ]  # fmt: skip
    plot = grid(
        [panels], "angle, deg", ["error, deg"], 420, shared_yaxes=True, subplot_titles=titles
    )
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(
            Plot(
                "Errors of tilt",
                "As figures 4.5 to 4.7. Where beta's axis is near the vertical, beta is not seen.",
                plot,
            ),
        ),
        notes=(
            "Simulated throughout. The unit is the scenario `raw_unit`: bias, scale and "
            "misalignment of the sizes that data sheet and workshop give, and of cross-axis forms "
            "that no compensation has; its sizes are chosen so that the linear model errs as much "
            "as in the thesis. The physical model is identified, by `steadytip identify imu`, on "
            "the turntable's grid alone.",
            "An angle counts in the sweeps in which it moves, alpha from where the axis of the "
            "instrument is level. The largest error of the thesis's linear model is nearer to its "
            "rms than here.",
        ),
    )


ITEM = Item(
    name="table-4.1",
    source=SOURCE,
    title="Tilt by the linear and the physical model, calibrated on a turntable",
    group="sensing",
    run=run,
    aliases=("figure-4.5", "figure-4.6", "figure-4.7"),
)
