"""Parameter files of a filter's covariances, from the noise terms of signals.

An assignment says which parameter takes which term of which signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.kit.records import Scalar
from fmu_src.kit.units import exponents
from fmu_src.pack.discovery import load_model
from harness.common.errors import ProblemsError, nearest
from harness.identify.allan.fit import TERMS, Noise
from harness.identify.parameter_files import write_parameters
from harness.parts.ssv import read_ssv
from harness.recordings.still import StillSignal
from harness.recordings.turntable import ACCELEROMETERS, CHANNELS, MAGNETOMETERS

__all__ = [
    "CONVENTIONS",
    "Assignment",
    "default_assignments",
    "measured_quantity",
    "parse_assignment",
    "write_covariances",
]

CONVENTIONS: Mapping[str, tuple[str, str]] = {
    "rate_noise": ("white", "rate_"),
    "bias_walk": ("walk", "rate_"),
    "rate_bias_walk": ("walk", "rate_"),
    "force_noise": ("white", "force_"),
    "force_bias_walk": ("walk", "force_"),
}
"""Term and port of parameters that estimators with gyros have, whatever group they are in."""
_SIGMA = "magnetometer.sigma"


@dataclass(frozen=True)
class Assignment:
    """A parameter that takes a term of one signal, or the rms over several signals.

    Attributes:
        parameter: element as the model names it.
        term: one of `allan.TERMS`.
        columns: names of the signals.
    """

    parameter: str
    term: str
    columns: tuple[str, ...]


def parse_assignment(text: str) -> Assignment:
    """Parse `gyro.density=white:rate_x` or `PARAMETER=TERM:COLUMN,COLUMN`.

    Raises:
        SteadytipError: the text has another form, or there is no such term.
    """
    parameter, equals, rest = text.partition("=")
    term, colon, columns = rest.partition(":")
    if not (parameter and equals and colon and columns):
        raise SteadytipError(
            f"--into {text}: write PARAMETER=TERM:COLUMN, as accelerometer.density[1]=white:a1x"
        )
    if term not in TERMS:
        raise SteadytipError(f"--into {text}: '{term}' is no term; {nearest(term, TERMS)}")
    return Assignment(parameter, term, tuple(columns.split(",")))


def default_assignments(
    model: str, found: Mapping[str, tuple[Noise, float, str]]
) -> tuple[list[Assignment], list[str]]:
    """Assign terms to parameters by the names of the instrument's channels and ports.

    MicronEstimator takes the density of each channel. Models with parameters that end in one of
    `CONVENTIONS` take the rms over the axes. A parameter keeps its value if its term does not show;
    a note tells it.

    Args:
        model: name of the model.
        found: noise by name of the signal, see `write_covariances`.

    Returns:
        Assignments, and notes.

    Raises:
        SteadytipError: no such model.
    """
    names = [scalar.name for scalar in load_model(model).parameters.scalars()]
    called = {channel(name): name for name in found}
    assignments = [
        Assignment(f"accelerometer.density[{i}]", "white", (called[name],))
        for i, name in enumerate(ACCELEROMETERS, start=1)
        if name in called
    ]
    field = tuple(called[name] for name in MAGNETOMETERS if name in called)
    assignments += [Assignment(_SIGMA, "sample", field)] if field else []
    for parameter in names:
        if parameter.rpartition(".")[2] not in CONVENTIONS:
            continue
        term, port = CONVENTIONS[parameter.rpartition(".")[2]]
        ports = tuple(name for name in found if port in name.lower().replace(".", "_"))
        assignments += [Assignment(parameter, term, ports)] if ports else []
    assignments = [assignment for assignment in assignments if assignment.parameter in names]
    present, notes = [], []
    for assignment in assignments:
        lacking = [
            name for name in assignment.columns if assignment.term not in found[name][0].terms
        ]
        if lacking:
            notes.append(
                f"{', '.join(lacking)}: no {assignment.term} shows; {assignment.parameter} stays"
            )
        else:
            present.append(assignment)
    return present, notes


def measured_quantity(signal: StillSignal, parameters: Path | None) -> tuple[float, str]:
    """Return the factor from the unit of a signal to that of the measured quantity, and this unit.

    Volts of the instrument's own channels are specific force or field. The scale is that of the
    data sheet, or of a parameter file as `identify imu` writes it. Other signals keep their unit.

    Raises:
        SteadytipError: the parameter file lacks the scale of the channel.
    """
    name = channel(signal.name)
    if signal.unit != "V" or name is None:
        return 1.0, signal.unit
    inertial = name in ACCELEROMETERS
    scale = design.ACCELEROMETER_SCALE if inertial else design.MAGNETOMETER_SCALE
    if parameters is not None:
        group = ACCELEROMETERS if inertial else MAGNETOMETERS
        sensor = "accelerometer" if inertial else "magnetometer"
        key = f"{sensor}.scale[{group.index(name) + 1}]"
        values = read_ssv(parameters)
        if key not in values:
            raise SteadytipError(f"parameter set {parameters} has no '{key}'")
        scale = float(values[key].value)
    return 1.0 / scale, "m/s2" if inertial else "T"


def channel(heading: str) -> str | None:
    """Return the instrument's channel that a heading names, as `a1x` in `sensors.volts_a1x`."""
    words = heading.lower().replace(".", "_").split("_")
    return words[-1] if words and words[-1] in CHANNELS else None


def write_covariances(
    path: Path,
    model: str,
    assignments: Sequence[Assignment],
    found: Mapping[str, tuple[Noise, float, str]],
) -> Path:
    """Write the parameters that take terms to a parameter file.

    Args:
        path: file to write.
        model: name of the model.
        assignments: which parameter takes which term.
        found: noise by name of the signal, the factor to the measured quantity, and its unit.

    Raises:
        ProblemsError: no such parameter or signal, a term that does not show, another unit, or
            values that the model would refuse.
        SteadytipError: no such model, or the file cannot be written.
    """
    scalars = {scalar.name: scalar for scalar in load_model(model).parameters.scalars()}
    problems: list[str] = []
    values: dict[str, float] = {}
    for assignment in assignments:
        text = f"{assignment.parameter}={assignment.term}:{','.join(assignment.columns)}"
        if assignment.parameter not in scalars:
            hint = nearest(assignment.parameter, scalars)
            problems.append(f"{text}: {model} has no parameter '{assignment.parameter}'; {hint}")
            continue
        scalar, sizes = scalars[assignment.parameter], []
        for name in assignment.columns:
            if name not in found:
                problems.append(f"{text}: there is no column '{name}'; {nearest(name, found)}")
                continue
            noise, factor, unit = found[name]
            refusal = _refusal(scalar, assignment.term, name, noise, unit)
            if refusal:
                problems.append(f"{text}: {refusal}")
            else:
                sizes.append(factor * noise.terms[assignment.term].value)
        if len(sizes) == len(assignment.columns):
            values[scalar.name] = float(np.sqrt(np.mean(np.square(sizes))))
    if problems:
        raise ProblemsError(f"{path} is not written", problems)
    return write_parameters(
        path, scalars.values(), values, "the noise is not of the size that the model takes"
    )


def _refusal(scalar: Scalar, term: str, name: str, noise: Noise, unit: str) -> str:
    if term not in noise.terms:
        shown = ", ".join(noise.terms) or "nothing"
        return (
            f"'{name}' shows no {term} ({shown} only); record longer, or leave the parameter as it "
            "is"
        )
    given = (unit or "1") + TERMS[term][1]
    wanted = scalar.field.unit or "1"
    if _exponents(given) != _exponents(wanted):
        return f"'{name}' has its {term} in {given}, and the parameter is in {wanted}"
    return ""


def _exponents(unit: str) -> dict[str, float]:
    # `1/s0.5` parses; a number alone does not.
    return exponents(unit) if unit != "1" else {}
