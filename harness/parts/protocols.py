"""What can sit in a loop: a part has ports, starts, advances and closes.

The loop cannot tell kinds apart. A part's table in a scenario holds exactly one of the keys of
`kinds()`, and that key chooses the class.
Packages elsewhere add a kind by an entry point of the group `steadytip.parts` whose name is the key
and whose object is a class with the constructor of `Kind`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from harness.common.types import FloatArray
from harness.parts.ports import Port

Settings = Mapping[str, Any]


@dataclass(frozen=True)
class RunContext:
    """What a part has to know of the run that it takes part in.

    Attributes:
        step: period of the loop [s].
        steps: number of ticks.
        workspace: folder for files of this run only, removed at its end.
        first: tick that the run goes on from; 0 at its beginning. See `Reusable`.
    """

    step: float
    steps: int
    workspace: Path
    first: int = 0


class Part(Protocol):
    """One member of the loop. Its constructor reads and checks; `start` acts.

    A part may have `warnings`: sentences on what it goes on with, but should not have to.
    """

    name: str
    inputs: Sequence[Port]
    outputs: Sequence[Port]
    seconds: float
    """How long it can go on [s]; infinite for most."""

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Get ready for t = 0 and write the initial outputs to `y`.

        Args:
            run: the run that begins.
            connected: names of the inputs that wires drive, in the order of `inputs`.
            initialised: for each of them whether `u` holds its value already (an undelayed wire).
            u: (len(driven),) the loop writes the inputs here before each `advance`.
            y: (len(outputs),) the part writes its outputs here, in the order of `outputs`.

        Raises:
            FaultError: what went wrong, without the part's name.
        """

    def advance(self, t: float, h: float) -> None:
        """Take the inputs from `u`, go from `t` to `t + h` [s], leave the outputs in `y`.

        Raises:
            FaultError: what went wrong, without the part's name.
        """

    def close(self) -> None:
        """Free everything. Called once, also after a failure."""

    def metadata(self) -> dict[str, Any]:
        """Return what the report and the results say about this part, JSON types only."""


@runtime_checkable
class OnBus(Protocol):
    """A part at one end of a bus: its outputs come in, the inputs of its siblings go out.

    Attributes:
        siblings: further parts by name that stand beside it in the loop.
        takes_by_name: whether an input of a sibling that no wire drives is driven by the output of
            the same name, if there is one.
    """

    siblings: Mapping[str, Part]
    takes_by_name: bool


@runtime_checkable
class Killable(Protocol):
    """A part that perhaps can be ended from outside while a call into it does not come back."""

    def kill(self) -> bool:
        """End what the part does, from another thread; that call then raises FaultError.

        Returns:
            Whether it could be ended.
        """


@runtime_checkable
class Restorable(Protocol):
    """A part that perhaps can be put back into a state that it was in before."""

    def prepare_to_return(self) -> bool:
        """Get ready for `save`; called before `start`.

        Returns:
            Whether the part says that it can save its state.
        """

    def save(self) -> Any:
        """Return a copy of the state; `free` gives it back.

        Raises:
            FaultError: it cannot be had after all.
        """

    def restore(self, saved: Any) -> None:
        """Go back to a state that `save` gave.

        Raises:
            FaultError: the state is not taken.
        """

    def free(self, saved: Any) -> None:
        """Give a saved state back."""


@runtime_checkable
class Reusable(Protocol):
    """A part that perhaps can be started more than once.

    Attributes:
        kept: whether `close` leaves everything as it is for another `start`. That one begins
            anew, bit for bit as a new part would; or, with `Run.first` above 0, it goes on from
            the state that the part is in. One that is not `Restorable` has no state but the time.
    """

    kept: bool

    def can_pause(self) -> bool:
        """Return whether a run can go on from its state by another `start`."""

    def release(self) -> None:
        """Free what `close` has left."""


@runtime_checkable
class Adjustable(Protocol):
    """A part some of whose parameters, and inputs that nothing drives, can be set in a run."""

    def trouble_with(self, name: str, value: Any) -> str:
        """Return why a value cannot be set in a run; empty if it can."""

    def adjust(self, values: Mapping[str, Any]) -> None:
        """Set values, between two steps.

        Raises:
            FaultError: one is refused.
        """


@dataclass(frozen=True)
class TypedAccess:
    """One call of a tick that passes values of one type: `fmi2SetReal` and its kin.

    Attributes:
        function: its address.
        references: address of the value references.
        count: of values.
        values: address of the values as doubles, whatever the type.
        integers: address of C ints that Integer and Boolean pass through; 0 for Real.
    """

    function: int
    references: int
    count: int
    values: int
    integers: int


@dataclass(frozen=True)
class FmuCalls:
    """What a tick calls in an FMU: the setters, `fmi2DoStep`, the getters.

    Attributes:
        component: the FMU's own pointer.
        set: from the `u` of `Part.start`.
        do_step: address of the function.
        never_returns: its last argument.
        get: to the `y` of `Part.start`.
        blame: told the index of a call and its status above Warning, it raises the FaultError.
    """

    component: int
    set: tuple[TypedAccess, ...]
    do_step: int
    never_returns: int
    get: tuple[TypedAccess, ...]
    blame: Callable[[int, int], None]


@dataclass(frozen=True)
class OutputTable:
    """Outputs that are known beforehand.

    Attributes:
        values: (ticks, outputs) one row for each tick; the last one stays.
    """

    values: FloatArray


@runtime_checkable
class NativelySteppable(Protocol):
    """A part that perhaps goes without Python, so that many ticks are one native call."""

    def native_step(self) -> FmuCalls | OutputTable | None:
        """Once it is started: what `advance` does, to the same bits; None if that cannot be said.

        A class that changes what `advance` does has to change this, too.
        """


class Kind(Protocol):
    """Class of the parts of one kind.

    The kind's own key and `parameters` may hold a path; it arrives resolved against the scenario
    file that it stands in.
    """

    def prepare(
        self, settings: Mapping[str, Settings], progress: Callable[[str], None]
    ) -> Mapping[str, Settings]:
        """Get what the parts of this kind need before they are made, all at once.

        Args:
            settings: of each part of this kind, by name.
            progress: told in a few words what is being done.

        Returns:
            Settings to make them from.
        """

    def __call__(self, name: str, settings: Settings, seed: int) -> Part:
        """Make a part from its settings in the scenario.

        Args:
            name: of the part.
            settings: its table in the scenario, nested tables and all.
            seed: of this part's own randomness.

        Raises:
            ProblemsError: everything that is wrong with the settings.
        """
