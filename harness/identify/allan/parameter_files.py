"""From noise terms to a filter's covariances: which parameter takes which term of which signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.device import design
from fmu_src.kit.records import Scalar
from fmu_src.kit.units import exponents
from fmu_src.pack.build import load_model
from harness.common.errors import ProblemsError, SteadytipError, nearest
from harness.identify.allan.fit import TERMS, Noise, Record
from harness.identify.imu.turntable import ACCELEROMETERS, CHANNELS
from harness.identify.parameter_files import write_scalars
from harness.parts.ssv import read_ssv

__all__ = ["CONVENTIONS", "Wish", "in_quantity", "parse_wish", "shipped_wishes", "write_set"]

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
class Wish:
    """A parameter that is to take a term of one signal, or the rms of several.

    Attributes:
        parameter: element as the model names it.
        term: one of `allan.TERMS`.
        columns: names of the signals.
    """

    parameter: str
    term: str
    columns: tuple[str, ...]


def parse_wish(text: str) -> Wish:
    """`gyro.density=white:rate_x` or `PARAMETER=TERM:COLUMN,COLUMN`.

    Raises:
        SteadytipError: not of that form, or no such term.
    """
    parameter, equals, rest = text.partition("=")
    term, colon, columns = rest.partition(":")
    if not (parameter and equals and colon and columns):
        raise SteadytipError(
            f"--into {text}: write PARAMETER=TERM:COLUMN, as accelerometer.density[1]=white:a1x"
        )
    if term not in TERMS:
        raise SteadytipError(f"--into {text}: '{term}' is no term; {nearest(term, TERMS)}")
    return Wish(parameter, term, tuple(columns.split(",")))


def shipped_wishes(
    model: str, found: Mapping[str, tuple[Noise, float, str]]
) -> tuple[list[Wish], list[str]]:
    """What a model takes of signals that are called as the instrument's channels and ports are.

    Of MicronEstimator each channel's density; of models with parameters that end in one of
    `CONVENTIONS` the rms over the axes. A term that does not show leaves its parameter as it is,
    which the notes say.

    Args:
        model: whose parameters they are.
        found: noise by the signal's name, and what measures it.

    Returns:
        What goes where, and notes.

    Raises:
        SteadytipError: no such model.
    """
    names = [scalar.name for scalar in load_model(model).parameters.scalars()]
    called = {channel(name): name for name in found}
    wishes = [
        Wish(f"accelerometer.density[{i}]", "white", (called[name],))
        for i, name in enumerate(ACCELEROMETERS, start=1)
        if name in called
    ]
    field = tuple(called[name] for name in CHANNELS[len(ACCELEROMETERS) :] if name in called)
    wishes += [Wish(_SIGMA, "sample", field)] if field else []
    for parameter in names:
        if parameter.rpartition(".")[2] not in CONVENTIONS:
            continue
        term, port = CONVENTIONS[parameter.rpartition(".")[2]]
        ports = tuple(name for name in found if port in name.lower().replace(".", "_"))
        wishes += [Wish(parameter, term, ports)] if ports else []
    wishes = [wish for wish in wishes if wish.parameter in names]
    there, notes = [], []
    for wish in wishes:
        lacking = [name for name in wish.columns if wish.term not in found[name][0].terms]
        if lacking:
            notes.append(f"{', '.join(lacking)}: no {wish.term} shows; {wish.parameter} stays")
        else:
            there.append(wish)
    return there, notes


def in_quantity(record: Record, parameters: Path | None) -> tuple[float, str]:
    """Factor from a signal's unit to what it measures, and that unit.

    Volts of the instrument's own channels are specific force or field by their scale, which is the
    data sheet's, or that of a parameter set as `identify imu` writes it; all else is what it is.

    Raises:
        SteadytipError: a set without the channel's scale.
    """
    name = channel(record.name)
    if record.unit != "V" or name is None:
        return 1.0, record.unit
    inertial = name in ACCELEROMETERS
    scale = design.ACCELEROMETER_SCALE if inertial else design.MAGNETOMETER_SCALE
    if parameters is not None:
        group = ACCELEROMETERS if inertial else CHANNELS[len(ACCELEROMETERS) :]
        sensor = "accelerometer" if inertial else "magnetometer"
        key = f"{sensor}.scale[{group.index(name) + 1}]"
        values = read_ssv(parameters)
        if key not in values:
            raise SteadytipError(f"parameter set {parameters} has no '{key}'")
        scale = float(values[key].value)
    return 1.0 / scale, "m/s2" if inertial else "T"


def channel(heading: str) -> str | None:
    """The instrument's channel that a heading names, as `a1x` in `sensors.volts_a1x`."""
    words = heading.lower().replace(".", "_").split("_")
    return words[-1] if words and words[-1] in CHANNELS else None


def write_set(
    path: Path,
    model: str,
    wishes: Sequence[Wish],
    found: Mapping[str, tuple[Noise, float, str]],
) -> Path:
    """Write the parameters that take the terms.

    Args:
        path: file to write.
        model: whose parameters they are.
        wishes: what goes where.
        found: noise by the signal's name, the factor to what it measures, and that unit.

    Raises:
        ProblemsError: no such parameter or signal, a term that does not show, another unit, or
            values that the model would refuse.
        SteadytipError: no such model, or the file cannot be written.
    """
    scalars = {scalar.name: scalar for scalar in load_model(model).parameters.scalars()}
    problems: list[str] = []
    values: list[tuple[Scalar, float]] = []
    for wish in wishes:
        text = f"{wish.parameter}={wish.term}:{','.join(wish.columns)}"
        if wish.parameter not in scalars:
            hint = nearest(wish.parameter, scalars)
            problems.append(f"{text}: {model} has no parameter '{wish.parameter}'; {hint}")
            continue
        scalar, sizes = scalars[wish.parameter], []
        for name in wish.columns:
            if name not in found:
                problems.append(f"{text}: there is no column '{name}'; {nearest(name, found)}")
                continue
            noise, factor, unit = found[name]
            trouble = _trouble(scalar, wish.term, name, noise, unit)
            if trouble:
                problems.append(f"{text}: {trouble}")
            else:
                sizes.append(factor * noise.terms[wish.term].value)
        if len(sizes) == len(wish.columns):
            values.append((scalar, float(np.sqrt(np.mean(np.square(sizes))))))
    if problems:
        raise ProblemsError(f"{path} is not written", problems)
    return write_scalars(path, values, "the noise is not of the size that the model takes")


def _trouble(scalar: Scalar, term: str, name: str, noise: Noise, unit: str) -> str:
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
