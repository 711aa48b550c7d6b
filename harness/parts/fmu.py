"""FMUs as parts of the loop: settings from the scenario, checked against the FMU's description."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import range_text
from fmu_src.model_files import is_model_file
from harness.common.errors import FaultError, ProblemsError, nearest
from harness.common.types import FloatArray
from harness.parts.description import Description, Variable, describe
from harness.parts.fmi import Instance
from harness.parts.isolated import IsolatedInstance
from harness.parts.ports import Port
from harness.parts.protocols import FmuCalls, RunContext, Settings
from harness.parts.settings import FmuSettings, check_settings, names_model
from harness.parts.ssv import read_ssv

_Value = float | int | bool | str
_TOML_TYPES: dict[str, tuple[type, ...]] = {
    "Real": (float, int),
    "Integer": (int,),
    "Boolean": (bool,),
    "String": (str,),
}


class FmuPart:
    """An FMI 2.0 co-simulation FMU, of ours or of anybody's."""

    def __init__(self, name: str, settings: Settings, seed: int) -> None:
        """Read the FMU's description and check the settings against it.

        Raises:
            ProblemsError: everything that is wrong with the settings.
            SteadytipError: the FMU cannot be read or does not run on this machine.
        """
        self.name = name
        keys = check_settings(FmuSettings, name, settings)
        self.description: Description = describe(Path(keys.fmu))
        self.description.binary()
        self.inputs: Sequence[Port] = self.description.inputs
        self.outputs: Sequence[Port] = self.description.outputs
        self.seconds = math.inf
        self.warnings: Sequence[str] = ()
        self._isolate = keys.isolate
        self._instance: Instance | IsolatedInstance | None = None
        self._returns = False
        self.kept = False
        self.start_values: dict[str, _Value] = {}
        self._take(keys, seed)

    def take(self, settings: Settings, seed: int) -> None:
        """Take start values from other settings of the same FMU, for the next `start`.

        Raises:
            ProblemsError: everything that is wrong with the settings.
        """
        self._take(check_settings(FmuSettings, self.name, settings), seed)

    def _take(self, keys: FmuSettings, seed: int) -> None:
        problems: list[str] = []
        values = self._start_values(keys, problems)
        if problems:
            raise ProblemsError(f"part '{self.name}' ({self.description.path.name})", problems)
        self.start_values = values
        self._take_seed(seed)

    @classmethod
    def prepare(
        cls, settings: Mapping[str, Settings], progress: Callable[[str], None]
    ) -> dict[str, Settings]:
        """Build the models that are named instead of given as files.

        Raises:
            SteadytipError: no such model, or it does not build.
        """
        wanted: dict[str, list[str]] = {}
        for table in settings.values():
            if _is_model(table):
                names = wanted.setdefault(str(table.get("flavour", "native")), [])
                names += [table["fmu"]] * (table["fmu"] not in names)
        built = {flavour: _build(names, flavour, progress) for flavour, names in wanted.items()}
        return {
            name: {**table, "fmu": str(built[table.get("flavour", "native")][table["fmu"]])}
            if _is_model(table)
            else table
            for name, table in settings.items()
        }

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Load, instantiate and initialise the FMU; see `Part.start`."""
        if run.first == 0:
            self._begin(run).begin(
                stop=run.steps * run.step,
                start_values=self.start_values,
                initialised=[
                    name for name, there in zip(connected, initialised, strict=True) if there
                ],
                preset_values=u[np.asarray(initialised, dtype=bool)] if len(connected) else u,
            )
        assert self._instance is not None
        self.warnings = self._instance.warnings
        # The loop calls the instance's own function: one Python frame less per part and tick.
        if isinstance(self._instance, Instance):
            names = [port.name for port in self.outputs]
            self.advance = self._instance.stepper(connected, u, y, self._returns, names)  # type: ignore
        else:
            self.advance = self._instance.stepper(connected, u, y, self._returns)  # type: ignore

    def advance(self, t: float, h: float) -> None:
        """See `Part.advance`; replaced by the instance's own function in `start`."""
        raise FaultError(f"was asked for t = {t:g} s, h = {h:g} s before it was started")

    def show(self, names: Collection[str]) -> None:
        """Leave out the outputs that nobody needs: reading them takes its time in each tick.

        Args:
            names: of those that stay.
        """
        self.outputs = tuple(port for port in self.outputs if port.name in names)

    def _begin(self, run: RunContext) -> Instance | IsolatedInstance:
        """Return an instance as new: an earlier run's, if that has left it in order."""
        if isinstance(self._instance, Instance) and not self.worn:
            self._instance.reset()
            return self._instance
        self.release()
        make = IsolatedInstance if self._isolate else Instance
        self._instance = make(self.description, self.name, run.workspace)
        return self._instance

    @property
    def worn(self) -> bool:
        """True if an error has left the FMU in a state that nobody should go on from."""
        return isinstance(self._instance, Instance) and self._instance.worn

    def can_pause(self) -> bool:
        """See `Reusable`: not in a process of its own."""
        return not self._isolate

    def trouble_with(self, name: str, value: Any) -> str:
        """See `Adjustable`: only what the FMU declares as tunable, and inputs."""
        variables = self.description.variables
        if name not in variables:
            free = [v.name for v in variables.values() if v.tunable]
            return f"the FMU has no variable '{name}'; {nearest(name, free)}"
        if not variables[name].tunable:
            return f"'{name}' cannot change in a run: the FMU declares it neither tunable nor input"
        return _trouble(variables[name], value)

    def adjust(self, values: Mapping[str, Any]) -> None:
        """See `Adjustable`."""
        assert isinstance(self._instance, Instance)
        self._instance.adjust(values)

    def native_step(self) -> FmuCalls | None:
        """See `Marching`: an FMU in this process does, an isolated one does not."""
        return self._instance.calls if isinstance(self._instance, Instance) else None

    def prepare_to_return(self) -> bool:
        """See `Restorable`: the FMU says whether it can, and not out of process."""
        model = self.description.model.coSimulation
        self._returns = bool(model.canGetAndSetFMUstate) and not self._isolate
        return self._returns

    def save(self) -> Any:
        """See `Restorable`."""
        assert isinstance(self._instance, Instance)
        return self._instance.save()

    def restore(self, saved: Any) -> None:
        """See `Restorable`."""
        assert isinstance(self._instance, Instance)
        self._instance.restore(saved)

    def free(self, saved: Any) -> None:
        """See `Restorable`."""
        assert isinstance(self._instance, Instance)
        self._instance.free(saved)

    def kill(self) -> bool:
        """See `Killable`: an isolated FMU can be ended, another one cannot."""
        if not isinstance(self._instance, IsolatedInstance):
            return False
        self._instance.kill()
        return True

    def close(self) -> None:
        """Terminate, free and unload the FMU as far as its state allows, unless it is kept."""
        if not self.kept:
            self.release()

    def release(self) -> None:
        """See `Reusable`."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None

    def metadata(self) -> dict[str, Any]:
        """File, identity and start values."""
        model = self.description.model
        return {
            "kind": "fmu",
            "file": self.description.path.name,
            "model": model.modelName,
            "version": model.version or "",
            "generation_tool": model.generationTool or "",
            "guid": model.guid,
            "sha256": self.description.sha256,
            "start_values": dict(self.start_values),
            "seed": self.start_values.get("seed"),
            "isolated": self._isolate,
        }

    def _start_values(self, keys: FmuSettings, problems: list[str]) -> dict[str, _Value]:
        variables = self.description.variables
        given: dict[str, Any] = {}
        if keys.parameters is not None:
            for name, entry in read_ssv(Path(keys.parameters)).items():
                known = variables.get(name)
                if known and entry.unit and known.unit and entry.unit != known.unit:
                    problems.append(
                        f"'{name}' in {Path(keys.parameters).name} is in {entry.unit}, "
                        f"the FMU's variable in {known.unit}: give it in {known.unit}"
                    )
                given[name] = entry.value
        given |= dict(_flat(keys.model_extra or {}))
        values: dict[str, _Value] = {}
        for name, value in given.items():
            for scalar, item in self._scalars(name, value, problems):
                trouble = _trouble(variables[scalar], item)
                if trouble:
                    problems.append(trouble)
                else:
                    values[scalar] = item
        return values

    def _scalars(self, name: str, value: Any, problems: list[str]) -> Iterator[tuple[str, _Value]]:
        """Spell a scalar as it is, a list as `name[1]`, ..., a list of rows as `name[1,1]`, ..."""
        variables = self.description.variables
        if not isinstance(value, list):
            if name in variables:
                yield name, value
                return
            array = _length(variables, name)
            settable = {v.name.split("[")[0] for v in variables.values() if v.settable}
            problems.append(
                f"'{name}' is an array: give all {array} values in a list"
                if array
                else f"the FMU has no variable '{name}'; "
                f"{nearest(name, settable | set(FmuSettings.model_fields))}"
            )
            return
        if any(isinstance(row, list) for row in value):
            yield from self._rows(name, value, problems)
            return
        length = _length(variables, name)
        if length != len(value):
            problems.append(
                f"'{name}' has {length} elements, the scenario gives {len(value)}"
                if length
                else f"the FMU has no array '{name}'; "
                f"{nearest(name, {n.split('[')[0] for n in variables if '[' in n})}"
            )
            return
        yield from ((f"{name}[{i}]", item) for i, item in enumerate(value, start=1))

    def _rows(
        self, name: str, rows: list[Any], problems: list[str]
    ) -> Iterator[tuple[str, _Value]]:
        """Elements of a matrix, given row by row."""
        variables = self.description.variables
        shape = _shape(variables, name)
        given = [len(row) if isinstance(row, list) else 0 for row in rows]
        if (len(rows), *set(given)) != shape:
            problems.append(
                f"'{name}' has {shape[0]} rows of {shape[1]}, the scenario gives rows of "
                f"{', '.join(map(str, given))}"
                if shape
                else f"the FMU has no matrix '{name}'; "
                f"{nearest(name, {n.split('[')[0] for n in variables if ',' in n})}"
            )
            return
        for i, row in enumerate(rows, start=1):
            yield from ((f"{name}[{i},{j}]", item) for j, item in enumerate(row, start=1))

    def _take_seed(self, seed: int) -> None:
        variable = self.description.variables.get("seed")
        if variable is None or variable.type != "Integer" or variable.causality != "parameter":
            return
        low = int(max(variable.low, 0))
        high = int(min(variable.high, 2**31 - 1))
        self.start_values.setdefault("seed", low + seed % (high - low + 1))


def _is_model(table: Settings) -> bool:
    name = table.get("fmu")
    return isinstance(name, str) and names_model(name)


def _build(names: list[str], flavour: str, progress: Callable[[str], None]) -> dict[str, Path]:
    from fmu_src import pack

    def say(name: str) -> None:
        progress(f"building {name}")

    found = pack.build([n for n in names if not is_model_file(n)], flavour, progress=say)
    own = [name for name in names if is_model_file(name)]
    if own:
        from fmu_src.pack.own_models import load_own_model

        for name in own:
            (found[name],) = pack.build(load_own_model(name), flavour, progress=say).values()
    return found


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested tables as dotted names, as FMUs write structured ones."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _shape(variables: Mapping[str, Variable], name: str) -> tuple[int, ...]:
    """Rows and columns of a matrix; () where there is none of that name."""
    rows = columns = 0
    while f"{name}[{rows + 1},1]" in variables:
        rows += 1
    while f"{name}[1,{columns + 1}]" in variables:
        columns += 1
    return (rows, columns) if rows else ()


def _length(variables: Mapping[str, Variable], name: str) -> int:
    count = 0
    while f"{name}[{count + 1}]" in variables:
        count += 1
    return count


def _trouble(variable: Variable, value: _Value) -> str:
    """Return what is wrong with a start value; empty if nothing is."""
    unit = f" {variable.unit}" if variable.unit else ""
    if not variable.settable:
        return f"'{variable.name}' cannot be set: its causality is {variable.causality}"
    wanted = _TOML_TYPES[variable.type]
    if not isinstance(value, wanted) or (isinstance(value, bool) and variable.type != "Boolean"):
        return f"'{variable.name}' = {value!r} should be of type {variable.type}"
    if isinstance(value, str | bool):
        return ""
    if not math.isfinite(value):
        return f"'{variable.name}' = {value} should be a finite number{unit and ' in'}{unit}"
    if not variable.low <= value <= variable.high:
        return (
            f"'{variable.name}' = {value:g}{unit} should be "
            f"{range_text(variable.low, variable.high)}{unit}"
        )
    return ""
