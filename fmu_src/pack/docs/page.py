"""Entry page of an FMU's documentation: `documentation/index.html`, one file with all it needs.

Text and equations come from the docstring of the model's module, tables from its records, figures
from the recorded function. Nothing in it depends on the machine or the hour.
"""

import base64
import re
from functools import cache
from pathlib import Path

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup

from fmu_src import __version__
from fmu_src.kit.container import Container
from fmu_src.kit.model import Model
from fmu_src.kit.records import Record
from fmu_src.pack.docs import icon, response, variables
from fmu_src.pack.fmu import reference
from fmu_src.pack.fmu.description import COPYRIGHT, LICENSE

PAPERS = {
    "A04": "W. T. Ang, Active Tremor Compensation in Handheld Instrument for Microsurgery, PhD"
    " thesis, Carnegie Mellon University, CMU-RI-TR-04-28, 2004",
    "AKR": "W. T. Ang, P. K. Khosla, C. N. Riviere, Kalman Filtering for Real-Time Orientation"
    " Tracking of Handheld Microsurgical Instrument, Carnegie Mellon University",
    "E13": "N. Enayati, Quaternion-Based Unscented Kalman Filter for Robust Motion Tracking in"
    " Neurosurgery, MSc thesis, Politecnico di Milano, 2013",
    "RK": "H. Ren, P. Kazanzides, Hybrid Attitude Estimation for Laparoscopic Surgical Tools: A"
    " Preliminary Study, Johns Hopkins University",
    "C23": "W.-H. Cheng, Attitude and Angular Velocity Estimation of Surgical Robot Using Sensor"
    " Fusion with Optical Tracker, IMU, and Quaternion-based Extended Kalman Filter, National"
    " Taiwan University, 2023",
}
"""Papers by the short names that docstrings use."""


def html(model: Model, flavour: str) -> str:
    """Write the page.

    Args:
        model: what it is about.
        flavour: `native` or `python`.
    """
    text = model.documentation
    derive_count = model.operations(model.derive_function) if model.derive is not None else ""
    return _environment.get_template("page.html.j2").render(
        model=model,
        flavour=flavour,
        text=Markup(_markdown(text.partition("\n")[2])),
        groups=[
            (title, tuple(variables.rows(record, prefix)))
            for title, record, prefix in _groups(model)
        ],
        responses=None if isinstance(model, Container) else _responses(model),
        papers=[(key, name) for key, name in PAPERS.items() if re.search(rf"\b{key}\b", text)],
        milliseconds=f"{model.sample_period * 1e3:g}",
        step_count=model.operations(model.step_function),
        derive_count=derive_count,
        values=sum(map(len, model.variables.values())),
        stimulated=bool(model.variables["input"]),
        source="" if isinstance(model, Container) else variables.source(model),
        reference=reference,
        response=response,
        icon=base64.b64encode(icon.png()).decode(),
        version=__version__,
        copyright=COPYRIGHT,
        license=LICENSE,
    )


def _markdown(text: str) -> str:
    # Raw HTML stays text: comparisons in a docstring are no tags.
    return str(MarkdownIt("commonmark", {"html": False}).enable("table").render(text))


def _groups(model: Model) -> list[tuple[str, type[Record], str]]:
    """Return the titles, records, and the prefix under which their variables are known."""
    return [
        ("Inputs", model.inputs, ""),
        ("Outputs", model.outputs, ""),
        ("Parameters", model.parameters, ""),
        ("Calculated parameters", model.derived, ""),
        ("State", model.state, "state."),
    ]


@cache
def _responses(model: Model) -> list[response.Response]:
    # Both flavours of a model respond alike, and measuring takes a second or two.
    return response.responses(model)


def _signed(value: float, digits: int) -> str:
    """Format with fixed digits, with a real minus sign, and none before zero."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "\N{MINUS SIGN}")


_environment = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
)
_environment.filters["signed"] = _signed
