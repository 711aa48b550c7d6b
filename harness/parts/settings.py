"""Settings of each kind of part: which keys its table in a scenario has.

    fmu = "Hand"                an FMU: a model that is built, or the path of a file
    fmu = "lowpass.py"          an FMU: built from a model in a file of the user's own
    recorded = "run.parquet"    outputs of a part as another run recorded them
    replay = "hand.csv"         a recorded motion
    can = "instrument"          the loop's end of a CAN bus, or the board's

A kind that another package adds checks its own settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fmu_src.model_files import is_model_file
from harness.common.errors import ProblemsError
from harness.common.files import is_path
from harness.common.validation_errors import explain
from harness.recordings.motion import MotionColumns

__all__ = [
    "CanSettings",
    "FmuSettings",
    "KindSettings",
    "OtherSettings",
    "RecordedSettings",
    "ReplaySettings",
    "check_settings",
    "names_model",
    "settings_of",
]

_Model = TypeVar("_Model", bound="KindSettings")


class KindSettings(BaseModel):
    """Settings of a part of any kind.

    Attributes:
        files: keys whose values may be paths.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    files: ClassVar[tuple[str, ...]] = ()

    @property
    def table(self) -> dict[str, Any]:
        """The settings as the scenario has them."""
        return self.model_dump(exclude_unset=True)


class FmuSettings(KindSettings):
    """Settings of an FMU part; every other key is a start value of the FMU.

    Attributes:
        fmu: path of the file, or a model that is built: its name, or the Python file that defines
            it, `lowpass.py` or `lowpass.py:LowPass`.
        flavour: of a model that is built.
        parameters: path of an `.ssv` file with start values.
        isolate: whether the FMU runs in a process of its own, so that a crash or a hang in it ends
            the part with a message and not the run's process.
    """

    model_config = ConfigDict(extra="allow")
    files = ("fmu", "parameters")

    fmu: str
    flavour: str = "native"
    parameters: str | None = None
    isolate: bool = False

    @property
    def is_model(self) -> bool:
        """True if the FMU is built from a model, one that comes along or a file of the user's."""
        return names_model(self.fmu)


def names_model(fmu: str) -> bool:
    """Return whether the value of `fmu` is a model to be built, and not an FMU's file."""
    return is_model_file(fmu) or not is_path(fmu)


class RecordedSettings(KindSettings):
    """Settings of a part whose outputs another run recorded.

    Attributes:
        recorded: path of the record.
        of: name that the part has there; its own if left out.
    """

    files = ("recorded",)

    recorded: str
    of: Annotated[str, Field(min_length=1)] | None = None


class ReplaySettings(KindSettings):
    """Settings of a part that plays a recorded motion.

    Attributes:
        replay: path of the recording.
        accept: names of findings about it to go on with; see `recordings.motion_quality`.
        repair: names of findings to repair that are not repaired unasked.
        columns: columns, units and rate, as far as the recording does not say.
    """

    files = ("replay",)

    replay: str
    accept: list[str] = []
    repair: list[str] = []
    columns: MotionColumns = MotionColumns()


class CanSettings(KindSettings):
    """Settings of a part on a CAN bus.

    Attributes:
        can: path of a DBC file, or name of a shipped one.
        interface: of python-can; as its own configuration has it, if left out.
        channel: of that interface, likewise.
        options: all else that the interface takes, `{ bitrate = 1000000 }`.
        node: who this end of the bus is, in the DBC file.
        replaces: parts that are at the other end as well; names, or patterns with `*`.
        reconnect: how long an unplugged bus is waited for [s].
    """

    files = ("can",)

    can: str
    interface: str | None = None
    channel: str | None = None
    options: dict[str, Any] = {}
    node: str = "Loop"
    replaces: list[str] = []
    reconnect: Annotated[float, Field(ge=0.0)] = 10.0


class OtherSettings(KindSettings):
    """Settings of a kind of part that another package adds."""

    model_config = ConfigDict(extra="allow")


_KINDS: Mapping[str, type[KindSettings]] = {
    "can": CanSettings,
    "fmu": FmuSettings,
    "recorded": RecordedSettings,
    "replay": ReplaySettings,
}


def settings_of(kind: str, name: str, table: Mapping[str, Any]) -> KindSettings:
    """Return the settings of a part.

    Args:
        kind: key of the kind.
        name: of the part, for messages.
        table: keys and values.

    Raises:
        ProblemsError: everything that is wrong with the keys.
    """
    return check_settings(_KINDS.get(kind, OtherSettings), name, table)


def check_settings(model: type[_Model], name: str, table: Mapping[str, Any]) -> _Model:
    """Return settings of a known kind.

    Raises:
        ProblemsError: everything that is wrong with the keys.
    """
    try:
        return model.model_validate(dict(table))
    except ValidationError as error:
        raise ProblemsError(f"part '{name}'", explain(error, model)) from None
