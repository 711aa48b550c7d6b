"""What a record says about its run: typed, and versioned.

Records of earlier versions have no `version`; their keys `step`, `settle` and `undriven`, and their
roles, are read under the new names. A record of a later version is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError

from harness.common.errors import SteadytipError
from harness.common.validation_errors import explain
from harness.scenario.old_names import OLD_ROLES

__all__ = ["VERSION", "RunMetadata"]

VERSION = 1


def _was(new: str, old: str) -> AliasChoices:
    return AliasChoices(new, old)


class RunMetadata(BaseModel):
    """What is needed to repeat a run, and to read its results.

    Attributes:
        version: of this layout; 0 of records that have none.
        scenario: its name.
        scenario_file: how it was asked for: a path, or the name of a shipped one.
        title: one line for people.
        variant: of the scenario; None without one.
        step_size: period of the ticks [s].
        steps: ticks that were planned.
        warm_up: time at the start that figures of merit leave out [s].
        seed: of all randomness.
        texts: (name, text) of the scenario's files.
        overrides: values by dotted key, put in place of the scenario's.
        motions: file name of the recording by the part that it moves.
        innovation_sizes: degrees of freedom by estimator, where the scenario states them.
        roles: columns that play each role.
        order: parts in run order.
        delays: ticks by output, of wires that have a delay.
        unconnected: `part.port` of the inputs that keep their start value.
        events: what happened in the middle: time [s], part, values.
        notes: what the user should know.
        findings: what was found in recordings: part, name, severity, where, text, cure.
        parts: what each part says about itself.
        versions: of the software.
        machine: system and processor.
        fused: whether parts ran as one FMU.
        ticks: that were recorded; None while the run goes on.
        wall: wall-clock time that they took [s].
        error: why the run ended early; None if it did not.
        hil: about the wall clock and the bus; None of a run without.
    """

    model_config = ConfigDict(frozen=True, populate_by_name=True)

    version: int = 0
    scenario: str = ""
    scenario_file: str = ""
    title: str = ""
    variant: str | None = None
    step_size: float = Field(validation_alias=_was("step_size", "step"))
    steps: int = 0
    warm_up: float = Field(default=0.0, validation_alias=_was("warm_up", "settle"))
    seed: int = 0
    texts: list[tuple[str, str]] = []
    overrides: dict[str, Any] = {}
    motions: dict[str, str] = {}
    innovation_sizes: dict[str, int] = {}
    roles: dict[str, list[str]] = {}
    order: list[str] = []
    delays: dict[str, int] = {}
    unconnected: list[str] = Field(default=[], validation_alias=_was("unconnected", "undriven"))
    events: list[dict[str, Any]] = []
    notes: list[str] = []
    findings: list[dict[str, Any]] = []
    parts: dict[str, dict[str, Any]] = {}
    versions: dict[str, str] = {}
    machine: str = ""
    fused: bool = False
    ticks: int | None = None
    wall: float | None = None
    error: str | None = None
    hil: dict[str, Any] | None = None

    @classmethod
    def read(cls, values: Mapping[str, Any], where: str) -> RunMetadata:
        """Check the metadata of a record.

        Args:
            values: as its file holds them.
            where: name of the file, for messages.

        Raises:
            SteadytipError: they are of a later version, or not those of a run.
        """
        version = values.get("version", 0)
        if isinstance(version, int) and version > VERSION:
            raise SteadytipError(
                f"{where} was written by a later version (layout {version}, this one reads up to "
                f"{VERSION}): update steadytip"
            )
        try:
            found = cls.model_validate(dict(values))
        except ValidationError as error:
            problems = "; ".join(explain(error, cls))
            raise SteadytipError(f"{where} is not the record of a run: {problems}") from None
        roles = {OLD_ROLES.get(role, role): names for role, names in found.roles.items()}
        return found.model_copy(update={"roles": roles})

    def json_text(self) -> str:
        """Return the metadata as a record holds them."""
        return self.model_dump_json()
