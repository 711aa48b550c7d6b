"""A model: one pure sampled function and the records it works on.

    (x[k+1], y[k]) = step(p, u[k], x[k], T)

`step` is recorded once as a CasADi function; C code, FMUs and Python runs all come from that
recording. Optional: `derive(p, T)` computes what follows from the parameters alone (it runs when
they change, not at every sample), and `draws` standard normal numbers arrive with every sample.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, get_args, get_type_hints

import casadi as ca

from fmu_src.errors import SteadytipError
from fmu_src.kit.noise import standard_normal
from fmu_src.kit.places import failure, namespace, place_of, reason
from fmu_src.kit.records import Derived, Inputs, Outputs, Parameters, Record, Scalar, State


class NoDerived(Derived):
    """For models whose parameters are used as they are."""


def symbols_in(function: ca.Function) -> list[Any]:
    """Arguments that a recorded function can be called with, to record what calls it."""
    symbols: list[Any] = function.mx_in() if function.is_a("MXFunction") else function.sx_in()
    return symbols


@dataclass(frozen=True)
class Model:
    """A sampled model under its FMU's name.

    Args:
        name: FMU and model identifier, a C identifier.
        step: `step(p, u, x, T)` returning `(State, Outputs)`; it takes `derived=` too where there
            is a `derive`, and `normal=`, a column of `draws` standard normal numbers.
        parameters: record class; its seed, where `draws` is not 0, is the field `seed`.
        inputs: record class.
        state: record class.
        outputs: record class.
        sample_period: T [s].
        derived: record class of what `derive` returns.
        derive: `derive(p, T)` returning `derived`.
        draws: standard normal numbers for each sample.
        matrix: whether to record whole matrices (CasADi's MX) instead of their elements: for
            models that solve equations, or skip work at most samples.
        answer: `answer(p, u, x, T)`, or with `derived=`, the outputs of a sample alone: for models
            whose step, taken whole, makes much of its derivative that no output needs.
        derivatives: whether the native FMU gives directional derivatives.
    """

    name: str
    step: Callable[..., tuple[State, Outputs]]
    parameters: type[Parameters]
    inputs: type[Inputs]
    state: type[State]
    outputs: type[Outputs]
    sample_period: float
    derived: type[Derived] = NoDerived
    derive: Callable[..., Derived] | None = None
    draws: int = 0
    matrix: bool = False
    answer: Callable[..., Outputs] | None = None
    derivatives: bool = True

    @classmethod
    def of_step(
        cls, name: str, step: Callable[..., Any], sample_period: float, **options: Any
    ) -> Self:
        """Return a model whose records are those in the signature of its step.

        Args:
            name: FMU and model identifier.
            step: `step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]`, with `derived: Derived`
                as well where there is a `derive`.
            sample_period: T [s].
            options: further arguments of `Model`.

        Raises:
            SteadytipError: the signature does not name all records.
        """
        hints = get_type_hints(step)
        missing = [part for part in ("p", "u", "x", "return") if part not in hints]
        if missing:
            raise SteadytipError(
                f"model '{name}': annotate {', '.join(missing)} of its step with the records, or"
                " name them with Model(...)"
            )
        parameters, inputs = hints["p"], hints["u"]
        derived = hints.get("derived", NoDerived)
        state, outputs = get_args(hints["return"])
        return cls(
            name, step, parameters, inputs, state, outputs, sample_period, derived, **options
        )

    @property
    def documentation(self) -> str:
        """Docstring of the module that defines the step: equations and notation.

        Of a step that was typed into an interpreter or a notebook, its own.
        """
        module = namespace(self.step)
        typed = module.get("__name__") == "__main__" and "__file__" not in module
        text = self.step.__doc__ if typed else module.get("__doc__")
        return inspect.cleandoc(text or "")

    @property
    def summary(self) -> str:
        """First line of the documentation."""
        return self.documentation.partition("\n")[0].rstrip(".")

    def operations(self, function: ca.Function) -> str:
        """Count the operations of a recorded function, and say whether of whole matrices."""
        kind = "matrix operations" if self.matrix else "operations"
        return f"{function.n_instructions()} {kind}"

    @property
    def starts_apart(self) -> bool:
        """True if initialisation shows anything else than a step."""
        return False

    @property
    def initial_latches(self) -> list[tuple[int, int]]:
        """Places of outputs and of the states that take their values when initialisation ends."""
        return []

    @property
    def noise_streams(self) -> list[tuple[int, int]]:
        """Noise draws of a sample: place of the seed among parameters, how many."""
        if not self.draws:
            return []
        names = [scalar.name for scalar in self.parameters.scalars()]
        return [(names.index("seed"), self.draws)]

    @property
    def _symbol(self) -> Any:
        return ca.MX if self.matrix else ca.SX

    @property
    def _records(self) -> tuple[Any, ...]:
        return self.parameters, self.derived, self.inputs, self.state

    def step_symbols(self) -> list[Any]:
        """Make symbols of p, d, u, x and r, the arguments of a step."""
        sizes = [record.size() for record in self._records]
        return [self._symbol.sym(*each) for each in zip("pduxr", [*sizes, self.draws], strict=True)]

    def _called(self, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call what the author wrote; an error in it names the author's file and line."""
        try:
            found = function(*arguments, **named)
        except Exception as error:
            raise SteadytipError(f"model '{self.name}': {failure(error, function)}") from error
        if function is self.step and not (isinstance(found, tuple) and len(found) == 2):
            raise SteadytipError(
                f"model '{self.name}': {place_of(function)}: the step must return"
                f" ({self.state.__name__}(...), {self.outputs.__name__}(...)), it returns"
                f" {type(found).__name__}"
            )
        return found

    def _packed(
        self, found: Any, record: type[Record], function: Callable[..., Any] | None = None
    ) -> Any:
        """Stack a record that the author's function returned, if it is the declared one."""
        place = f"model '{self.name}': {place_of(function or self.step)}"
        if not isinstance(found, Record) or found.fields.keys() != record.fields.keys():
            raise SteadytipError(
                f"{place}: gives {type(found).__name__} in the place of {record.__qualname__}(...)"
            )
        try:
            return found.pack()
        except Exception as error:
            why = str(error) if isinstance(error, SteadytipError) else reason(error)
            raise SteadytipError(f"{place}: {record.__qualname__}(...): {why}") from error

    @cached_property
    def step_function(self) -> ca.Function:
        """`(p, d, u, x, r) -> (x', y)`, columns; r are uniform draws in (0, 1)."""
        p, d, u, x, r = self.step_symbols()
        extra: dict[str, Any] = {}
        if self.derive is not None:
            extra["derived"] = self.derived.unpack(d)
        if self.draws:
            extra["normal"] = standard_normal(r)
        following, out = self._called(
            self.step,
            self.parameters.unpack(p),
            self.inputs.unpack(u),
            self.state.unpack(x),
            self.sample_period,
            **extra,
        )
        columns = [self._packed(following, self.state), self._packed(out, self.outputs)]
        names = [*"pdux", "r"]
        return ca.Function("step", [p, d, u, x, r], columns, names, ["x_next", "y"], {"cse": True})

    @property
    def start_function(self) -> ca.Function:
        """Function of initialisation, with the arguments and results of a step."""
        return self.step_function

    @cached_property
    def directional_derivative(self) -> ca.Function:
        """`(p, d, u, x, r, du) -> dy`: how outputs of a sample answer a change of its inputs."""
        arguments = symbols_in(self.step_function)
        du = self._symbol.sym("du", self.inputs.size())
        if self.answer is None:
            y = self.step_function.call(arguments, True, False)[1]
        else:
            p, d, u, x = (r.unpack(a) for r, a in zip(self._records, arguments, strict=False))
            out = self._called(self.answer, p, u, x, self.sample_period, derived=d)
            y = self._packed(out, self.outputs, self.answer)
        dy = ca.densify(ca.jtimes(y, arguments[2], du))
        names = [*"pdux", "r", "du"]
        return ca.Function("slope", [*arguments, du], [dy], names, ["dy"], {"cse": True})

    @cached_property
    def derive_function(self) -> ca.Function:
        """`p -> d`, columns."""
        p = self._symbol.sym("p", self.parameters.size())
        derived = (
            self._called(self.derive, self.parameters.unpack(p), self.sample_period)
            if self.derive
            else NoDerived()
        )
        packed = self._packed(derived, self.derived, self.derive or self.step)
        if self.matrix and not isinstance(packed, ca.MX):
            packed = ca.MX(ca.evalf(packed))  # numbers, or nothing at all
        return ca.Function("derive", [p], [packed], ["p"], ["d"], {"cse": True})

    @cached_property
    def variables(self) -> dict[str, list[Scalar]]:
        """Scalars by FMI causality, in the order of the value references."""
        return {
            "parameter": list(self.parameters.scalars()),
            "calculatedParameter": list(self.derived.scalars()),
            "input": list(self.inputs.scalars()),
            "output": list(self.outputs.scalars()),
            "local": list(self.state.scalars("state.")),
        }
