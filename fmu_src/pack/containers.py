"""Build the FMU of a container, only when what is in it has changed."""

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

from fmu_src.kit.container import Container, Member, MemberLink, contain
from fmu_src.kit.model import Model
from fmu_src.model_files import is_model_file
from fmu_src.pack import compiler
from fmu_src.pack.build import build_file
from fmu_src.pack.discovery import load_model


@dataclass(frozen=True)
class ContainerPlan:
    """What a container is to hold, before any model is loaded.

    Attributes:
        name: of the container, a C identifier.
        members: in run order: name of the member and its model: a name, or a file of the user's own
            that defines it.
        links: between members; see `fmu_src.kit.container.MemberLink`.
        sample_period: the tick [s].
        starts: of each member, parameters that start elsewhere than the model's, by scalar names.
    """

    name: str
    members: Sequence[tuple[str, str]]
    links: Sequence[MemberLink]
    sample_period: float
    starts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Digest of everything in the plan, hexadecimal."""
        found = hashlib.sha256(json.dumps(asdict(self)).encode())
        for model in self._own.values():
            from fmu_src.pack.own_models import recorded_digest

            found.update(recorded_digest(model).encode())
        return found.hexdigest()

    @cached_property
    def _own(self) -> dict[str, Model]:
        """Models in files of the user's own, by how the members name them; read once."""
        files = [model for _, model in self.members if is_model_file(model)]
        if not files:
            return {}
        from fmu_src.pack.own_models import load_own_model

        return {file: load_own_model(file) for file in files}

    def contain(self) -> Container:
        """Return the container.

        Raises:
            SteadytipError: see `fmu_src.kit.container.contain`; or no such model.
        """
        members = [
            Member(name, self._own.get(model) or load_model(model), self.starts.get(name, {}))
            for name, model in self.members
        ]
        return contain(self.name, members, self.links, self.sample_period)


def build_container(
    plan: ContainerPlan,
    path: Path,
    targets: Collection[str] | None = None,
    progress: Callable[[str], None] = lambda name: None,
) -> Path:
    """Build the container's native FMU unless it is there.

    Args:
        plan: what it is to hold.
        path: of the FMU.
        targets: platforms, by folder name, or `all`; this one by default.
        progress: called with the container's name before it is built.

    Returns:
        The path.

    Raises:
        SteadytipError: see `Plan.contain`, or a compiler that refuses.
    """
    models = [model for _, model in plan.members if not is_model_file(model)]
    return build_file(
        path,
        models,
        plan.contain,
        "native",
        compiler.select_targets(targets),
        progress,
        plan.digest,
    )
