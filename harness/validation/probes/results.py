"""Comparison of what the FMU computes with what it promises: items A7, C3."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from ctypes import c_double, c_size_t, c_uint
from pathlib import Path
from typing import Any

from harness.validation.checks import PROBES, Failure, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import FmuInstance, Host, initialising

REFERENCES = "extra/org.fmi-standard.fmi-ls-ref"
"""Where an FMU holds reference results (layered standard FMI-LS-REF)."""
_DIFFERENCES = (1e-6, 1e-8)
"""Steps of the finite differences, relative to an input's value, nominal value or 1: a model that
is steep there bends within the larger one, rounding spoils the smaller one where it is flat."""
_POINTS = (3, 11, 40)
"""Steps of the usual motion of the inputs at whose values derivatives are compared."""
_ROUNDING = 32
"""Units in the last place by which rounding may move an output."""
_AGREE = 1e-4
"""Relative difference of a derivative from the finite difference."""


@PROBES.check("C3.derivatives", "error", "directional derivatives are those of the outputs")
def _derivatives(host: Host) -> Iterator[str]:
    if not host.facts["has_derivatives"]:
        raise Skip("providesDirectionalDerivative is false")
    inputs = host.inputs
    outputs = host.variables("Real", causality="output")
    if not inputs or not outputs:
        raise Skip("needs a Real input and a Real output")
    slave = initialising(host)
    # A model may jump or bend at one point, as a quantiser does, but hardly at all of them.
    wrong = [_disagreements(slave, inputs, outputs, k) for k in _POINTS]
    for pair in wrong[0]:
        if all(pair in others for others in wrong):
            output, known = pair
            exact, difference = wrong[0][pair]
            yield (
                f"d {output} / d {known} = {exact:.9g}, finite differences give {difference:.9g}"
            )
    yield Note(f"{len(outputs)} outputs by {len(inputs)} inputs, in initialisation mode")


def _disagreements(
    slave: FmuInstance, inputs: list[dict[str, Any]], outputs: list[dict[str, Any]], k: int
) -> dict[tuple[str, str], tuple[float, float]]:
    """Return derivative and finite difference, by output and input, where they disagree."""
    slave.stimulate(k)
    unknown = (c_uint * len(outputs))(*(v["reference"] for v in outputs))
    exact = (c_double * len(outputs))()
    parted = {}
    for known in inputs:
        reference, seed = (c_uint * 1)(known["reference"]), (c_double * 1)(1.0)
        slave.need(
            "fmi2GetDirectionalDerivative",
            *(unknown, c_size_t(len(outputs)), reference, c_size_t(1), seed, exact),
        )
        rows = [_differences(slave, known, outputs, step) for step in _DIFFERENCES]
        for place, output in enumerate(outputs):
            here = [row[place] for row in rows if row is not None]
            if here and not any(_agree(exact[place], *other) for other in here):
                parted[output["name"], known["name"]] = exact[place], here[0][0]
    return parted


def _agree(exact: float, difference: float, rounding: float) -> bool:
    return abs(exact - difference) <= _AGREE * max(abs(exact), abs(difference)) + rounding


def _differences(
    slave: FmuInstance, known: dict[str, Any], outputs: list[dict[str, Any]], share: float
) -> list[tuple[float, float]] | None:
    """Return central differences of all outputs by one input, and their rounding errors.

    None where the input has no room for them.
    """
    at = float(slave.get(known))
    step = share * float(known["nominal"] or abs(known["start"] or 0.0) or 1.0)
    values = []
    for end in (at - step, at + step):
        if slave.set_to(known, end) >= FmiStatus.Discard:
            return None
        values.append([slave.get(v) for v in outputs])
    slave.set_to(known, at)
    # An output may be a small difference of values as large as the others.
    largest = max(abs(value) for row in values for value in row)
    rounding = _ROUNDING * sys.float_info.epsilon * largest / step
    return [((high - low) / (2 * step), rounding) for low, high in zip(*values, strict=True)]


# ---- Reference results --------------------------------------------------------------------------


def _table(path: Path) -> dict[str, list[float]]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        header, *rows = list(csv.reader(file, skipinitialspace=True))
    try:
        return {
            name.strip(): [float(row[column]) for row in rows if row]
            for column, name in enumerate(header)
        }
    except (ValueError, IndexError) as error:
        raise Failure(f"{path.name} is no table of numbers: {error}") from None


def _options(path: Path) -> dict[str, float]:
    options = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        name, _, value = line.replace("=", ",").partition(",")
        try:
            options[name.strip()] = float(value)
        except ValueError:
            continue
    return options


@PROBES.check("A7.reference", "error", "the FMU reproduces the reference results inside it")
def _reference(host: Host) -> Iterator[str]:
    folder = Path(host.facts["folder"]) / REFERENCES
    results = sorted(folder.glob("*_ref.csv"))
    if not results:
        raise Skip(f"there are none in {REFERENCES}")
    for path in results:
        yield from _reproduce(host, path)


def _reproduce(host: Host, path: Path) -> Iterator[str]:
    base = path.name.removesuffix("_ref.csv")
    expected = _table(path)
    times = expected.pop("time", None)
    options_file, inputs_file = path.with_name(f"{base}_ref.opt"), path.with_name(f"{base}_in.csv")
    options = _options(options_file) if options_file.exists() else {}
    inputs = _table(inputs_file) if inputs_file.exists() else {}
    input_times = inputs.pop("time", [])
    variables = {v["name"]: v for v in host.facts["variables"]}
    for name in (*expected, *inputs):
        if name not in variables:
            yield f"{path.name}: the FMU has no variable '{name}'"
            return
    if not times:
        yield f"{path.name} has no column 'time'"
        return
    start, step = options.get("StartTime", times[0]), options.get("StepSize") or host.step
    tolerance = options.get("RelTol", 1e-4)

    def put_in(k: int) -> None:
        for name, column in inputs.items():
            value = _at(start + k * step, input_times, column, variables[name])
            if slave.set_to(variables[name], value) >= FmiStatus.Discard:
                raise Failure(f"{base}: '{name}' = {value} is refused{host.said()}")

    slave = initialising(host, start)
    put_in(0)
    slave.need("fmi2ExitInitializationMode")
    scale = {name: max(map(abs, column), default=0.0) for name, column in expected.items()}
    worst = (0.0, "", 0.0)
    row = k = 0
    while row < len(times):
        if times[row] <= start + (k + 1e-6) * step:
            for name, column in expected.items():
                gap = abs(float(slave.get(variables[name])) - column[row])
                share = gap / scale[name] if scale[name] else gap
                if not share <= worst[0]:
                    worst = (share, name, times[row])
            row += 1
            continue
        put_in(k)
        slave.need("fmi2DoStep", start + k * step, step, 1)
        k += 1
    share, name, when = worst
    if not share <= tolerance:
        yield (
            f"{path.name}: '{name}' at t = {when:g} s is off by {share:.3g} of its largest value, "
            f"RelTol allows {tolerance:g}"
        )
    yield Note(f"{base}: {len(times)} rows, worst {share:.3g} of the largest value")


def _at(t: float, times: list[float], column: list[float], variable: dict[str, Any]) -> Any:
    """Return the input at a time: interpolated if it is continuous, else held."""
    after = next((n for n, at in enumerate(times) if at > t + 1e-9 * (abs(t) + 1e-3)), len(times))
    before = max(after - 1, 0)
    value = column[before]
    if variable["variability"] == "continuous" and 0 < after < len(times):
        share = (t - times[before]) / (times[after] - times[before])
        value += share * (column[after] - value)
    return value if variable["type"] == "Real" else round(value)
