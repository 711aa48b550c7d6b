"""The one Python slave behind every FMU of the python flavour.

It evaluates the recorded functions of the model (`step.casadi`, `derive.casadi`) with the variables
of `model.json`, and behaves as `shell.c` does: same clock, limits, draws and value references. When
it is packed, the class takes the model's name and the noise is written into the script, so that an
FMU's script needs nothing but Python, NumPy, CasADi and PythonFMU.
"""

import json
import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmu_src.kit.noise import uniforms


class Slave(Fmi2Slave):
    """A sampled model as an FMI 2.0 co-simulation slave."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        folder = Path(self.resources)
        table = json.loads((folder / "model.json").read_text(encoding="utf-8"))
        self._variables = table["variables"]
        self._period = table["sample_period"]
        self._draws = table["draws"]
        self._seed_at = table["seed_at"]
        step = ca.Function.load(str(folder / "step.casadi"))
        derive = ca.Function.load(str(folder / "derive.casadi"))

        # One array of all values; p, d, u, y, x are views of it, in the order of value references.
        self._values = np.array([variable["start"] for variable in self._variables])
        ends = np.cumsum([table["sizes"][letter] for letter in "pduyx"])
        parts = np.split(self._values, ends[:-1])
        self._first = dict(zip("duyx", ends[:-1].tolist(), strict=True))
        p, d, u, self._y, self._x = parts
        self._y_next, self._x_next = np.empty_like(self._y), np.empty_like(self._x)
        self._uniform = np.empty(self._draws)
        self._evaluate = _bound(
            step, (p, d, u, self._x, self._uniform), (self._x_next, self._y_next)
        )
        self._derive = _bound(derive, (p,), (d,))
        self._low = np.array([variable["min"] for variable in self._variables], dtype=float)
        self._high = np.array([variable["max"] for variable in self._variables], dtype=float)

        self._start = self._time = 0.0
        self._samples = 0
        self._mode = "instantiated"
        self._stale = True

    # The clock and the modes

    def setup_experiment(
        self, start_time: float, stop_time: float | None, tolerance: float | None
    ) -> None:
        """Place the first sample."""
        self._start = self._time = start_time

    def enter_initialization_mode(self) -> None:
        """Compute the outputs of the first sample."""
        self._mode = "initialization"

    def exit_initialization_mode(self) -> None:
        """Freeze the fixed parameters."""
        self._initialise()
        self._mode = "stepping"

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Run the samples in [current_time, current_time + step_size)."""
        slack = 1e-9 * step_size + 16 * np.finfo(float).eps * (abs(current_time) + step_size)
        if not (math.isfinite(step_size) and step_size > 0):
            return self._refuse(f"step size {step_size} must be finite and greater than 0 s")
        if not math.isfinite(current_time) or abs(current_time - self._time) > slack:
            return self._refuse(
                f"time {current_time} must be the end of the last step, {self._time} s"
            )
        until = current_time + step_size
        due = math.ceil((until - self._start) / self._period - 1e-3)
        self._initialise()
        while self._samples < due:
            if not self._sample():
                return False
            self._y[:], self._x[:] = self._y_next, self._x_next
            self._samples += 1
        self._time = until
        return True

    def _sample(self) -> bool:
        if self._draws:
            seed = int(self._values[self._seed_at])
            self._uniform[:] = uniforms(seed, self._samples, 1, self._draws)[0]
        self._evaluate()
        for letter, values in (("y", self._y_next), ("x", self._x_next)):
            first = self._first[letter]
            bad = self._outside(np.arange(first, first + len(values)), values)
            if bad is not None:
                return self._refuse(bad)
        return True

    def _initialise(self) -> None:
        if self._stale:
            self._derive()
            self._stale = False
            for variable, value in zip(self._variables, self._values, strict=True):
                if variable["warning"] and not value:
                    self.log(
                        f"{variable['name']} is false: {variable['warning']}", Fmi2Status.warning
                    )
            if self._sample():
                self._y[:] = self._y_next

    # Values

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return the values of some real variables."""
        if self._mode == "initialization":
            self._initialise()
        return [float(v) for v in self._values[self._checked(vrs, "Real")]]

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the values of some integer variables."""
        return [int(v) for v in self._values[self._checked(vrs, "Integer")]]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return the values of some boolean variables."""
        if self._mode == "initialization":
            self._initialise()
        return [bool(v) for v in self._values[self._checked(vrs, "Boolean")]]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set all of some real variables, or none."""
        self._assign(self._checked(vrs, "Real"), values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set all of some integer variables, or none."""
        self._assign(self._checked(vrs, "Integer"), values)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set all of some boolean variables, or none."""
        self._assign(self._checked(vrs, "Boolean"), values)

    def _checked(self, references: list[int], kind: str) -> np.ndarray:
        places = np.asarray(references, dtype=int)
        for place in places:
            if not 0 <= place < len(self._variables) or self._variables[place]["type"] != kind:
                raise TypeError(f"no {kind} variable has the value reference {place}")
        return places

    def _assign(self, places: np.ndarray, values: Any) -> None:
        array = np.asarray(values, dtype=float)
        for place in places:
            variable = self._variables[place]
            if variable["causality"] not in ("parameter", "input"):
                raise ValueError(f"{variable['name']} is computed and cannot be set")
            fixed = variable["causality"] == "parameter" and not variable["tunable"]
            if fixed and self._mode == "stepping":
                raise ValueError(f"{variable['name']} is fixed: set it before the first step")
        bad = self._outside(places, array)
        if bad is not None:
            raise ValueError(bad)
        self._values[places] = array
        self._stale |= self._mode != "stepping" or bool(np.any(places < self._first["d"]))

    def _outside(self, places: np.ndarray, values: np.ndarray) -> str | None:
        # Comparisons with nan are false.
        good = (values >= self._low[places]) & (values <= self._high[places]) & np.isfinite(values)
        if good.all():
            return None
        at = int(np.argmin(good))
        name = self._variables[places[at]]["name"]
        low, high = self._low[places[at]], self._high[places[at]]
        return f"{name} = {values[at]!r} must be finite and in [{low}, {high}]"

    def _refuse(self, why: str) -> bool:
        self.log(why, Fmi2Status.error)
        return False

    # States: everything that a step reads

    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "values": [value.hex() for value in self._values.tolist()],
            "times": [self._start.hex(), self._time.hex()],
            "samples": self._samples,
            "mode": self._mode,
            "stale": self._stale,
        }

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        self._values[:] = [float.fromhex(text) for text in state["values"]]
        self._start, self._time = (float.fromhex(text) for text in state["times"])
        self._samples, self._mode, self._stale = state["samples"], state["mode"], state["stale"]


def _bound(function: Any, arguments: tuple[Any, ...], results: tuple[Any, ...]) -> Any:
    """Return a call without arguments that reads and writes fixed arrays, without allocation."""
    buffer, evaluate = function.buffer()
    for place, array in enumerate(arguments):
        buffer.set_arg(place, array.data)
    for place, array in enumerate(results):
        buffer.set_res(place, array.data)

    def call() -> None:
        # CasADi's callable points into the buffer without keeping it alive.
        evaluate()
        _ = buffer

    return call
