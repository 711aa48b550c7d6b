"""Laws that the FMU of every model keeps, to hold a model of one's own against.

    from steadytip.testing import check_model

    def test_it_keeps_the_laws() -> None:
        check_model(MODEL)

`LAWS` names them. Each builds on the same: instances of the FMU in stepping mode, and inputs that
walk smoothly inside the declared ranges.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.records import Scalar
from fmu_src.pack.build import build
from harness.common.types import FloatArray

__all__ = ["LAWS", "FmuUnderTest", "check_model", "inputs_of", "instances", "laws_of"]

_KINDS = ("Real", "Integer", "Boolean")
_WIDEST = 1e3
"""How far inputs without limits go."""


class FmuUnderTest:
    """An FMU in stepping mode, all variables as one vector in the order of value references.

    Args:
        path: of the FMU.
        folder: where it is unpacked.
        name: of the instance.
        values: start values, by variable.
    """

    def __init__(self, path: Path, folder: Path, name: str = "instance", **values: float) -> None:
        from fmpy.fmi2 import FMU2Slave

        self.description = _description(path, path.stat().st_mtime_ns)
        self.variables = self.description.modelVariables
        self._named = {variable.name: variable for variable in self.variables}
        self._of_kind = {
            kind: [i for i, v in enumerate(self.variables) if v.type == kind] for kind in _KINDS
        }
        self.messages: list[str] = []
        self.fmu = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu.instantiate(callbacks=self._callbacks())
        self._initialise(values)
        self.time = 0.0
        self.period = float(self.description.defaultExperiment.stepSize)

    def _initialise(self, values: Mapping[str, float]) -> None:
        self.fmu.setupExperiment(startTime=0.0)
        for variable in self.variables:
            if variable.name in values:
                self.set(variable, values[variable.name])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def _callbacks(self) -> Any:
        import ctypes

        from fmpy import fmi2
        from fmpy.logging import addLoggerProxy

        callbacks = fmi2.fmi2CallbackFunctions()

        def log(_env: Any, _instance: Any, _status: Any, _category: Any, message: bytes) -> None:
            self.messages.append(message.decode())

        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        addLoggerProxy(ctypes.byref(callbacks))  # puts the printf arguments in
        return callbacks

    def set(self, variable: Any, value: float) -> None:
        """Set one variable of the description."""
        setter = getattr(self.fmu, "set" + variable.type)
        setter([variable.valueReference], [value if variable.type == "Real" else int(value)])

    def apply(self, inputs: Mapping[str, float]) -> None:
        """Set variables by name."""
        chosen = [(self._named[name], value) for name, value in inputs.items()]
        for kind in _KINDS:
            of_kind = [(v.valueReference, value) for v, value in chosen if v.type == kind]
            if of_kind:
                references, values = zip(*of_kind, strict=True)
                cast = float if kind == "Real" else int
                getattr(self.fmu, "set" + kind)(list(references), list(map(cast, values)))

    def step(self, h: float | None = None) -> None:
        """Make a communication step; one sample by default."""
        h = h or self.period
        self.fmu.doStep(self.time, h)
        self.time += h

    def values(self) -> FloatArray:
        """Return all variables, shape (variables,)."""
        result = np.empty(len(self.variables))
        for kind, places in self._of_kind.items():
            references = [self.variables[i].valueReference for i in places]
            result[places] = getattr(self.fmu, "get" + kind)(references) if places else []
        return result

    def outputs(self) -> FloatArray:
        """Return all outputs, shape (outputs,)."""
        chosen = [v.causality == "output" for v in self.variables]
        return self.values()[chosen]

    def run(self, inputs: Inputs, first: int, last: int) -> FloatArray:
        """Make samples with their inputs; all variables after each, shape (samples, variables)."""
        rows = []
        for k in range(first, last):
            self.apply(inputs(k))
            self.step()
            rows.append(self.values())
        return np.array(rows)

    def reset(self) -> None:
        """Bring the FMU to stepping mode as if it were new."""
        self.fmu.reset()
        self._initialise({})
        self.time = 0.0

    def refusal(self, call: Callable[[], None], what: str) -> str:
        """Return what the FMU says of a call that it has to refuse.

        Raises:
            AssertionError: it is not refused, or without a word.
        """
        from fmpy.fmi1 import FMICallException

        told = len(self.messages)
        try:
            call()
        except FMICallException:
            _hold(len(self.messages) > told, f"{what} is refused without a message")
            return self.messages[-1]
        raise AssertionError(f"{what} is not refused")

    def close(self) -> None:
        """Terminate and free."""
        self.fmu.terminate()
        self.fmu.freeInstance()


Inputs = Callable[[int], Mapping[str, float]]
Start = Callable[..., FmuUnderTest]


@cache
def _description(path: Path, changed: int) -> Any:
    """Read once: there is an instance for each case, and reading takes longer than most of them."""
    import fmpy

    return fmpy.read_model_description(path, validate=False)


def inputs_of(model: Model) -> Callable[[int], dict[str, float]]:
    """Return inputs for sample k: a smooth, bounded walk inside the declared ranges."""
    scalars = list(model.inputs.scalars())

    def at(k: int) -> dict[str, float]:
        found = {}
        for i, scalar in enumerate(scalars):
            field = scalar.field
            if field.kind == "Boolean":
                found[scalar.name] = float(k % 200 < 150)
                continue
            low, high = field.min, field.max
            reach = min(scalar.start - low, high - scalar.start, 1e-4 + 0.1 * abs(scalar.start))
            reach = reach if np.isfinite(reach) and reach > 0 else 1e-4
            wave = np.sin(0.06 * k + i) + 0.3 * np.sin(0.002 * k * (i + 1))
            found[scalar.name] = scalar.start + reach * wave / 1.3
        return found

    return at


def _hold(condition: bool, otherwise: str) -> None:
    if not condition:
        raise AssertionError(otherwise)


def _settable(model: Model) -> list[tuple[int, Scalar]]:
    """Return reference and declaration of the first real of each settable group."""
    found, reference = [], 0
    for causality, scalars in model.variables.items():
        reals = [(reference + i, s) for i, s in enumerate(scalars) if s.field.kind == "Real"]
        if causality in ("parameter", "input") and reals:
            found.append(reals[0])
        reference += len(scalars)
    return found


# Runs


def _cut_run(start: Start, inputs: Inputs, hand_over: Callable[[Any, Any, Any], Any]) -> None:
    uncut = start()
    first = uncut.run(inputs, 0, 60)
    state = uncut.fmu.getFMUState()
    second = uncut.run(inputs, 60, 120)
    other = start()
    other.run(inputs, 200, 230)
    other.fmu.setFMUState(hand_over(uncut.fmu, other.fmu, state))
    other.time = uncut.time - 60 * uncut.period
    np.testing.assert_array_equal(other.values(), first[-1])
    np.testing.assert_array_equal(other.run(inputs, 60, 120), second)


def _restored_in_memory(model: Model, start: Start, inputs: Inputs) -> None:
    """Save after 60 samples, restore into another instance that has been elsewhere, go on."""
    _cut_run(start, inputs, lambda _one, _other, state: state)


def _restored_from_bytes(model: Model, start: Start, inputs: Inputs) -> None:
    """Do the same, the state as bytes in between."""
    _cut_run(
        start,
        inputs,
        lambda one, other, state: other.deSerializeFMUstate(one.serializeFMUstate(state)),
    )


def _instances_apart(model: Model, start: Start, inputs: Inputs) -> None:
    """Run an instance alone, and beside another."""
    alone = start().run(inputs, 0, 40)
    one, two = start(), start()
    rows = []
    for k in range(40):
        two.apply(inputs(k + 500))
        two.step()
        rows.append(one.run(inputs, k, k + 1)[0])
    np.testing.assert_array_equal(np.array(rows), alone)


def _reset_is_fresh(model: Model, start: Start, inputs: Inputs) -> None:
    """Compare a reset instance with a fresh one."""
    fresh = start().run(inputs, 0, 40)
    used = start()
    used.run(inputs, 300, 340)
    used.reset()
    np.testing.assert_array_equal(used.run(inputs, 0, 40), fresh)


def _long_step(model: Model, start: Start, inputs: Inputs) -> None:
    """Compare one long step with short ones, inputs held."""
    short, long = start(), start()
    for instance, steps in ((short, 12), (long, 1)):
        instance.apply(inputs(5))
        for _ in range(steps):
            instance.step(12 * instance.period / steps)
    np.testing.assert_array_equal(short.values(), long.values())


def _short_steps(model: Model, start: Start, inputs: Inputs) -> None:
    """Step by thirds of a sample, which binary cannot divide: ten samples run in 30 steps."""
    whole, thirds = start(), start()
    for instance, h in ((whole, whole.period), (thirds, thirds.period / 3)):
        instance.apply(inputs(5))
        for _ in range(round(10 * instance.period / h)):
            instance.step(h)
    np.testing.assert_array_equal(whole.values(), thirds.values())


# Values


def _finite_only(model: Model, start: Start, inputs: Inputs) -> None:
    """Set values that are not finite."""
    for value in (math.nan, math.inf, -math.inf):
        instance = start()
        for reference, scalar in _settable(model):
            if scalar.field in [s.field for s in model.variables["parameter"]]:
                instance.fmu.reset()
            what = f"{scalar.name} = {value}"
            said = instance.refusal(partial(instance.fmu.setReal, [reference], [value]), what)
            _hold(scalar.name in said and str(abs(value)) in said, f"{what}: '{said}'")


def _range_only(model: Model, start: Start, inputs: Inputs) -> None:
    """Set values out of range."""
    instance = start()
    for reference, scalar in _settable(model):
        if not math.isfinite(scalar.field.max):
            continue
        instance.fmu.reset()
        beyond = scalar.field.max + 1 + abs(scalar.field.max)
        what = f"{scalar.name} = {beyond:.9g}"
        said = instance.refusal(partial(instance.fmu.setReal, [reference], [beyond]), what)
        told = f"{what} must be" in said and f"{scalar.field.max:.9g}" in said
        _hold(told, f"{what}: '{said}' does not name value and bound")


def _all_or_none(model: Model, start: Start, inputs: Inputs) -> None:
    """Set a good value with a bad one, of models with two real inputs or more."""
    reals = [
        (i, s)
        for i, s in enumerate([s for group in model.variables.values() for s in group])
        if s in model.variables["input"] and s.field.kind == "Real"
    ]
    if len(reals) < 2:
        return
    instance = start()
    before = instance.values()
    (first, scalar), (second, _) = reals[:2]
    values = [scalar.start + 1e-6, math.nan]
    instance.refusal(lambda: instance.fmu.setReal([first, second], values), "nan")
    np.testing.assert_array_equal(instance.values(), before)


def _finite_at_the_corners(model: Model, start: Start, inputs: Inputs) -> None:
    """Visit random corners of the input box for 150 samples, then rest."""
    rng = np.random.default_rng(5)
    instance = start()
    for k in range(300):
        row = {}
        for scalar in model.variables["input"]:
            low = max(scalar.field.min, -_WIDEST)
            high = min(scalar.field.max, _WIDEST)
            row[scalar.name] = rng.choice([low, high]) if k < 150 else scalar.start
            if scalar.field.kind == "Boolean":
                row[scalar.name] = float(rng.integers(2))
        instance.apply(row)
        instance.step()
        for variable, value in zip(instance.variables, instance.values(), strict=True):
            _hold(bool(np.isfinite(value)), f"{variable.name} = {value} after sample {k}: {row}")


def _starts_as_described(model: Model, start: Start, inputs: Inputs) -> None:
    """Compare start values of the binary with those of the description."""
    instance = start()
    for variable, value in zip(instance.variables, instance.values(), strict=True):
        if variable.causality in ("parameter", "input"):
            words = {"true": 1.0, "false": 0.0}
            declared = words[variable.start] if variable.start in words else float(variable.start)
            _hold(value == declared, f"{variable.name} starts at {value}, declared is {declared}")


def _first_outputs(model: Model, start: Start, inputs: Inputs) -> None:
    """Compare outputs before the first step with those after it."""
    instance = start(**inputs(3))
    before = instance.outputs()
    instance.step()
    np.testing.assert_array_equal(instance.outputs(), before)


def _names(model: Model, start: Start, inputs: Inputs) -> None:
    """Check that names are unique, those of ports identifiers, and variables described."""
    scalars = [s for group in model.variables.values() for s in group]
    names = [scalar.name for scalar in scalars]
    twice = sorted({name for name in names if names.count(name) > 1})
    _hold(not twice, f"several variables have the names {', '.join(twice)}")
    for scalar in model.variables["input"] + model.variables["output"]:
        _hold(scalar.name.isidentifier(), f"'{scalar.name}' is no identifier")
    for scalar in scalars:
        _hold(bool(scalar.field.description.strip()), f"{scalar.name} is not described")


Law = Callable[[Model, Start, Inputs], None]

LAWS: dict[str, Law] = {
    "a run that is cut and restored goes on bit for bit": _restored_in_memory,
    "and so does one that is restored from bytes": _restored_from_bytes,
    "two instances do not see each other": _instances_apart,
    "one long step equals short ones with held inputs": _long_step,
    "a reset instance equals a fresh one": _reset_is_fresh,
    "steps shorter than a sample run each instant once": _short_steps,
    "values that are not finite are refused by name": _finite_only,
    "values out of range are refused with their bound": _range_only,
    "a refusal sets none of the values": _all_or_none,
    "extreme inputs inside the ranges give finite values": _finite_at_the_corners,
    "start values are those of the description": _starts_as_described,
    "outputs before the first step are those of the first sample": _first_outputs,
    "names are legal, unique and described": _names,
}
"""Every law by its name."""
_OF_PYTHON = (_restored_in_memory, _restored_from_bytes, _instances_apart, _long_step)
"""Those that are asked of the python flavour: PythonFMU's shell does not keep all of the others."""


def laws_of(flavour: str) -> dict[str, Law]:
    """Return the laws that a flavour keeps, by their names."""
    return {name: law for name, law in LAWS.items() if flavour == "native" or law in _OF_PYTHON}


@contextmanager
def instances(path: Path, folder: Path) -> Iterator[Start]:
    """Give a function that starts instances of an FMU; they are freed at the end.

    Args:
        path: of the FMU.
        folder: where it is unpacked.
    """
    started: list[FmuUnderTest] = []

    def one(**values: float) -> FmuUnderTest:
        started.append(FmuUnderTest(path, folder, f"i{len(started)}", **values))
        return started[-1]

    try:
        yield one
    finally:
        for instance in started:
            instance.fmu.freeInstance()


def check_model(model: Model, flavour: str = "native") -> None:
    """Build a model's FMU and hold it against every law, and against `steadytip.validate`.

    Args:
        model: of your own, or one that comes along.
        flavour: `native` or `python`; the latter against fewer laws, and not validated.

    Raises:
        AssertionError: laws that it breaks, each with what was found.
        SteadytipError: it cannot be built.
    """
    import fmpy

    from harness.validation.validate import validate

    (path,) = build(model, flavour).values()
    broken = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        fmpy.extract(str(path), folder)
        for name, law in laws_of(flavour).items():
            try:
                with instances(path, Path(folder)) as start:
                    law(model, start, inputs_of(model))
            except Exception as error:  # what a law finds, or an FMU that fails under it
                broken.append(f"{name}: {str(error).strip() or type(error).__name__}")
    if flavour == "native":
        broken += [
            f"validate {outcome.id}, {outcome.title}: {'; '.join(outcome.problems)}"
            for outcome in validate(path).outcomes
            if outcome.verdict == "error"
        ]
    if broken:
        raise AssertionError(
            "\n".join([f"model '{model.name}' breaks {len(broken)} laws:", *broken])
        )
