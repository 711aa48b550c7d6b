"""Reference results inside an FMU, by which an importer can check itself.

The default experiment, from the start values, on a smooth motion of every input. The results come
from the recorded function evaluated in Python, not from the binary that they are to check. Files
are those of the FMI cross-check (rules 4.1), named by a manifest of the layered standard FMI-LS-REF
(1.0.0-alpha.1) and tied together by an experiments file (MA-HS-Experiments, a draft).

| symbol | meaning |
| --- | --- |
| k, T | sample number, sample period [s] |
| u[k] | input of sample k, set at k T; a row of the inputs is held for EVERY samples |
| y[k] | outputs of sample k: read after the step from k T to (k+1) T, hence the row of (k+1) T |

Row 0 holds what initialisation mode shows: y[0], too, but for a container.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from lxml import etree

from fmu_src.kit.model import Model
from fmu_src.kit.records import Scalar
from fmu_src.kit.runner import Runner
from fmu_src.pack.fmu.description import DEFAULT_SAMPLES, to_xml

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
TOLERANCE = 1e-6
"""Allowed difference from the reference, relative to the largest value of an output."""
OUTPUTS = 10
"""Most outputs in a reference (cross-check rules 4.1)."""
EVERY = 5
"""Rows of both tables are that many samples apart, to keep the FMU small."""
REACH = {
    "m": 7e-6,  # tremor, or half of a stack's stroke
    "m/s": 5e-4,
    "m/s2": 0.03,
    "rad/s": 0.01,
    "rad/s2": 0.5,
    "V": 20.0,
    "T": 20e-6,
    "s": 2e-3,
    None: 0.02,
}
"""How far an input that rests at zero moves, by unit; about what a tremor of 10 Hz makes of it."""
_SHARE = 0.02
"""How far any other moves, relative to its start."""
TONE = 10.0
"""Frequency of the faster part of the motion [Hz]."""
_SLOW = 1.3
"""Frequency of the slower part [Hz]; no simple ratio to the other."""
_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
_DESCRIPTION = "Layered Standard providing information on related files included in an FMU."


def reach(scalar: Scalar) -> float:
    """Return the range of an input about its start, within its limits."""
    field = scalar.field
    wanted = _SHARE * abs(scalar.start) if scalar.start else REACH.get(field.unit, 0.0)
    return min(wanted, field.max - scalar.start, scalar.start - field.min)


def stimulus(model: Model) -> np.ndarray:
    """Return the inputs of the reference, a row every EVERY samples, the last at the end.

    Numbers are those of the file, that is, rounded to six digits. Booleans are the opposite of
    their start from 0.6 to 0.7 of the run. Shape (DEFAULT_SAMPLES / EVERY + 1, inputs).
    """
    k = np.arange(0, DEFAULT_SAMPLES + 1, EVERY)
    t = k * model.sample_period
    columns: list[list[float]] = []
    for place, scalar in enumerate(model.variables["input"]):
        if scalar.field.kind == "Real":
            fast = np.sin(2 * np.pi * TONE * t + place)
            slow = np.sin(2 * np.pi * _SLOW * t + 2 * place)
            exact = scalar.start + reach(scalar) * (0.7 * fast + 0.3 * slow)
            columns.append([float(f"{value:.6g}") for value in exact])
        else:
            other = (k >= 0.6 * DEFAULT_SAMPLES) & (k < 0.7 * DEFAULT_SAMPLES)
            columns.append(np.where(other, 1 - scalar.start, scalar.start).tolist())
    return np.array(columns).reshape(-1, len(k)).T


def compared_outputs(model: Model) -> list[str]:
    """Return the names of at most OUTPUTS outputs: first elements before second ones."""
    scalars = model.variables["output"]
    seen: dict[int, int] = {}
    ranks = []
    for scalar in scalars:
        ranks.append(seen.get(id(scalar.field), 0))
        seen[id(scalar.field)] = ranks[-1] + 1
    first = sorted(range(len(scalars)), key=lambda place: (ranks[place], place))[:OUTPUTS]
    return [scalars[place].name for place in sorted(first)]


def outputs(
    model: Model, u: np.ndarray, make: Callable[[Model], Runner] = Runner
) -> tuple[np.ndarray, np.ndarray]:
    """Run a model from its start values.

    Args:
        model: what to run.
        u: inputs of each sample, shape (samples, inputs).
        make: gives what runs it.

    Returns:
        What initialisation shows, shape (outputs,), and the run, shape (samples, outputs).
    """
    names = [scalar.name for scalar in model.variables["input"]]
    runner = make(model)
    run = runner.run(len(u), {name: u[:, place] for place, name in enumerate(names)})
    # Outputs are scalars or columns; a matrix would have to be stacked by columns.
    # Ports of a matrix go by columns.
    y = np.column_stack([values.T.reshape(-1, len(u)).T for values in run.values()])
    return runner.initial, y


@cache
def files(model: Model) -> dict[str, bytes]:
    """Return every file of the reference, by its path in the FMU."""
    u = stimulus(model)
    inputs = [scalar.name for scalar in model.variables["input"]]
    initial, y = outputs(model, np.repeat(u[:-1], EVERY, axis=0))
    names = compared_outputs(model)
    every_name = [scalar.name for scalar in model.variables["output"]]
    columns = [every_name.index(name) for name in names]
    rows = np.vstack([initial, y])[::EVERY, columns]

    stop = DEFAULT_SAMPLES * model.sample_period
    settings = {
        "StartTime": 0.0,
        "StopTime": stop,
        "StepSize": model.sample_period,
        "RelTol": TOLERANCE,
    }
    found = {
        "_ref.csv": _csv(model, names, rows, ".9g"),
        "_ref.opt": "".join(f"{name},{value!r}\n" for name, value in settings.items()).encode(),
        ".exp": _experiments(model, bool(inputs)),
    }
    if inputs:
        found["_in.csv"] = _csv(model, inputs, u, ".6g")
    return {
        **{f"{FOLDER}/{model.name}{ending}": content for ending, content in found.items()},
        f"{FOLDER}/fmi-ls-manifest.xml": _manifest(model, list(found)),
    }


def _csv(model: Model, names: list[str], rows: np.ndarray, digits: str) -> bytes:
    # Times as an importer counts them, k T to the last bit.
    lines = [",".join(["time", *names])]
    for k, row in enumerate(rows):
        time = repr(k * EVERY * model.sample_period)
        lines.append(",".join([time, *(format(value, digits) for value in row)]))
    return ("\n".join(lines) + "\n").encode()


_RELATED = {
    "_in.csv": ("text/csv", "testcase", "Inputs of the default experiment"),
    "_ref.csv": ("text/csv", "result", "Output of the default experiment"),
    "_ref.opt": ("text/plain", "configuration", "Times, step size and tolerance of the comparison"),
    ".exp": ("application/x-ma-hs-experiments", "experiment/smoke-test", "Default experiment"),
}


def _manifest(model: Model, endings: list[str]) -> bytes:
    root = etree.Element("fmiReferences", nsmap={"fmi-ls": _NAMESPACE})
    root.set(f"{{{_NAMESPACE}}}fmi-ls-name", FOLDER.partition("/")[2])
    root.set(f"{{{_NAMESPACE}}}fmi-ls-version", "1.0.0-alpha.1")
    root.set(f"{{{_NAMESPACE}}}fmi-ls-description", _DESCRIPTION)
    for ending in sorted(endings):
        kind, role, sentence = _RELATED[ending]
        source = model.name + ending
        etree.SubElement(root, "Related", type=kind, source=source, role=role, description=sentence)
    return to_xml(root)


def _experiments(model: Model, stimulated: bool) -> bytes:
    root = etree.Element("Experiments", name=f"{model.name} smoke test")
    experiment = etree.SubElement(
        root,
        "Experiment",
        name="default",
        description="Default experiment from the start values; inputs are held between samples",
        startTime="0.0",
        stopTime=repr(DEFAULT_SAMPLES * model.sample_period),
        tolerance=repr(TOLERANCE),
        stepSize=repr(model.sample_period),
    )
    if stimulated:
        etree.SubElement(experiment, "Stimuli", source=f"{model.name}_in.csv")
    etree.SubElement(experiment, "References", source=f"{model.name}_ref.csv")
    return to_xml(root)
