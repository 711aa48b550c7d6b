"""Run a model in Python, without an FMU: for studies, identification and tests."""

import difflib
from collections.abc import Mapping
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.kit.noise import uniforms
from fmu_src.kit.records import Field, Record


class Runner:
    """One instance of a model: parameters fixed at the start, state carried along.

    Args:
        model: what to run.
        parameters: values other than the declared starts, by field (`wflc.gain_frequency`, `w`) or
            by element (`w[2]`).

    Raises:
        SteadytipError: an unknown name, or an array of another shape.
    """

    def __init__(self, model: Model, parameters: Mapping[str, Any] | None = None) -> None:
        self.model = model
        self.p = model.parameters.starts()
        for name, value in (parameters or {}).items():
            _assign(self.p, model.parameters, name, value)
        self.d = np.array(model.derive_function(self.p)).ravel()
        self.x = model.state.starts()
        self.samples = 0
        self.initial = np.empty(0)
        """Stacked outputs that initialisation shows, after the first `run`."""

    def run(self, samples: int, inputs: Mapping[str, Any] | None = None) -> dict[str, np.ndarray]:
        """Run some samples and return every output.

        Args:
            samples: how many.
            inputs: by field; either one value of the field's shape, held all along, or one for each
                sample, shape (samples, *field shape). Inputs not named keep their start values.

        Returns:
            For each output field an array of shape (samples, *field shape).

        Raises:
            SteadytipError: an unknown name, or an array of another shape.
        """
        table = np.tile(self.model.inputs.starts(), (samples, 1))
        for name, value in (inputs or {}).items():
            _assign(table, self.model.inputs, name, value)
        streams = [
            uniforms(int(self.p[seed]), self.samples, samples, count)
            for seed, count in self.model.noise_streams
        ]

        draws = np.hstack([np.empty((samples, 0)), *streams])
        if not self.samples and samples:
            self._initialise(table[0], draws[0])
        results = self._evaluated(table, draws)
        self.samples += samples
        return {
            name: _unstack(results[:, place], field)
            for name, field, place in _places(self.model.outputs)
        }

    def _initialise(self, u: np.ndarray, r: np.ndarray) -> None:
        """Compute outputs before the first step, and put them into the states that hold them."""
        start: Any = self.model.start_function
        self.initial = np.array(start(self.p, self.d, u, self.x, r)[1]).ravel()
        for output, state in self.model.initial_latches:
            self.x[state] = self.initial[output]

    def _evaluated(self, table: np.ndarray, draws: np.ndarray) -> np.ndarray:
        """Stacked outputs of every sample, from stacked inputs and draws; moves the state on."""
        function: Any = self.model.step_function
        buffer, evaluate = function.buffer()
        u, r = np.empty(table.shape[1]), np.empty(draws.shape[1])
        following, y = np.empty(len(self.x)), np.empty(self.model.outputs.size())
        arguments, outcomes = (self.p, self.d, u, self.x, r), (following, y)
        for place, array in enumerate(arguments):
            buffer.set_arg(place, array.data)
        for place, array in enumerate(outcomes):
            buffer.set_res(place, array.data)
        results = np.empty((len(table), len(y)))
        for k in range(len(table)):
            u[:], r[:] = table[k], draws[k]
            evaluate()
            self.x[:] = following
            results[k] = y
        return results


def _places(record: type[Record], prefix: str = "", at: int = 0) -> list[tuple[str, Field, slice]]:
    """Path, field and slice of the stacked vector, of every field, nested ones by dotted path."""
    found = []
    for name, field in record.fields.items():
        if isinstance(field, Field):
            found.append((prefix + name, field, slice(at, at + field.size)))
            at += field.size
        else:
            found += _places(field, f"{prefix}{name}.", at)
            at += field.size()
    return found


def _unstack(columns: np.ndarray, field: Field) -> np.ndarray:
    # Matrices are stacked by columns.
    cut = columns.reshape(len(columns), *reversed(field.shape))
    return cut.transpose(0, *reversed(range(1, cut.ndim)))


def _assign(target: np.ndarray, record: type[Record], name: str, value: Any) -> None:
    """Write a value into the last axis of `target`, at the place of the named field or element."""
    elements = {scalar.name: at for at, scalar in enumerate(record.scalars())}
    if name in elements:
        target[..., elements[name]] = value
        return
    places = {path: (field, place) for path, field, place in _places(record)}
    if name not in places:
        near = difflib.get_close_matches(name, [*places, *elements], 1)
        hint = f"; the nearest is '{near[0]}'" if near else ""
        raise SteadytipError(f"{record.__qualname__} has no variable '{name}'{hint}")
    field, place = places[name]
    array = np.asarray(value, dtype=float)
    shape = (*target.shape[:-1], *field.shape)
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise SteadytipError(
            f"{record.__qualname__}.{name}: got the shape {array.shape}, needed is {field.shape},"
            f" or {shape} for a value at each sample"
        ) from None
    lead = target.ndim - 1
    stacked = array.transpose(*range(lead), *reversed(range(lead, array.ndim)))
    target[..., place] = stacked.reshape(*target.shape[:-1], field.size)
