"""Fuse parts of a system into a container: one native FMU instead of several.

What can be fused are FMUs that are built from models, native and in this process. The rest stays
beside the container: recordings, boards, anybody's FMUs. Records keep their columns.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.errors import SteadytipError
from harness.common.endpoint import Endpoint
from harness.common.errors import ProblemsError, nearest
from harness.parts.fmu import FmuPart
from harness.parts.protocols import Part
from harness.parts.settings import FmuSettings
from harness.scenario.schema import Scenario, Wire
from harness.system.assembly import System
from harness.system.wiring import connect

if TYPE_CHECKING:
    from fmu_src.pack.containers import ContainerPlan

__all__ = ["build", "fuse"]

_FOLDER = Path("build", "fmus", "container")
_NAME = "container"


def build(
    system: System,
    parts: Sequence[str] | None = None,
    name: str | None = None,
    out: Path | None = None,
    targets: Collection[str] | None = None,
    progress: Callable[[str], None] = lambda name: None,
) -> Path:
    """Build a container of some parts with the scenario's start values, as a file to use elsewhere.

    Args:
        system: parts and their wiring.
        parts: which; all that a loop is made of by default.
        name: of the FMU, a C identifier; by default the scenario's, and the parts' if not all.
        out: folder of the FMU; `build/fmus/container` by default.
        targets: platforms, by folder name, or `all`; this one by default.
        progress: called with the container's name before it is built.

    Returns:
        Path of the FMU.

    Raises:
        SteadytipError: a part that there is not, or that cannot be fused, and why; or see
            `fmu_src.pack.containers.build_container`.
    """
    from fmu_src.pack.containers import build_container

    scenario = system.scenario
    if system.events:
        raise SteadytipError(
            f"{scenario.name}: a container does not hold what happens in the middle of a run; leave"
            " 'change' and 'fault' out"
        )
    if parts is None:
        members = [name for name in system.wiring.order if name in scenario.parts]
    else:
        unknown = [part for part in parts if part not in scenario.parts]
        if unknown:
            raise SteadytipError(
                f"{scenario.name} has no part '{unknown[0]}'; {nearest(unknown[0], scenario.parts)}"
            )
        members = [name for name in system.wiring.order if name in parts]
    reasons = {part: why for part in members if (why := _reason(scenario, part))}
    if reasons:
        raise ProblemsError(
            f"container of {scenario.name}",
            [f"part '{part}' cannot be fused: {why}" for part, why in reasons.items()],
        )
    _check_between(system, members)
    chosen = name or "_".join([scenario.name.replace("-", "_"), *(members if parts else [])])
    starts = {part: _starts(system.parts[part]) for part in members}
    plan = _plan(system, members, chosen, starts)
    path = (out or _FOLDER) / f"{chosen}.fmu"
    return build_container(plan, path, targets, progress)


def fuse(
    system: System,
    progress: Callable[[str], None] = lambda name: None,
    container: Path | None = None,
) -> System:
    """Return the same system with all that can be fused in one part.

    Args:
        system: parts and their wiring.
        progress: called with the container's name before it is built.
        container: the FMU, if there is one of the same parts and wiring already.

    Raises:
        SteadytipError: nothing can be fused, or a part that cannot stands between two that can.
    """
    scenario = system.scenario
    members = [
        name
        for name in system.wiring.order
        if name in scenario.parts and not _reason(scenario, name)
    ]
    if not members:
        raise SteadytipError(
            f"nothing of {scenario.name} can be fused: "
            + "; ".join(f"'{name}': {_reason(scenario, name)}" for name in scenario.parts)
        )
    _check_between(system, members)
    path = container
    if path is None:
        from fmu_src.pack.containers import build_container

        plan = _plan(system, members, scenario.name.replace("-", "_"), {})
        path = _FOLDER / f"{plan.name}-{plan.digest[:8]}.fmu"
        build_container(plan, path, progress=progress)
    name = _NAME
    while name in system.parts:
        name += "_"
    starts = {
        f"{part}.{key}": value
        for part in members
        for key, value in _starts(system.parts[part]).items()
    }
    parts: dict[str, Part] = {name: FmuPart(name, {"fmu": str(path), **starts}, seed=0)}
    parts |= {other: part for other, part in system.parts.items() if other not in members}
    wires = [
        Wire(
            _inside(name, members, link.source),
            _inside(name, members, link.target),
            link.delay,
        )
        for link in system.wiring.links
        if not (link.source.part in members and link.target.part in members)
    ]
    limit = max(system.step_limits[part] for part in members)
    return replace(
        system,
        parts=parts,
        wiring=connect(scenario.name, parts, wires),
        step_limits={**system.step_limits, name: limit},
        names={
            _inside(name, members, endpoint): str(endpoint)
            for part in members
            for port in system.parts[part].outputs
            for endpoint in [Endpoint(part, port.name)]
        },
        unfused=system,
    )


def _inside(name: str, members: Collection[str], endpoint: Endpoint) -> str:
    """Return a port's name once some parts are in a container."""
    part, port = endpoint
    return f"{name}.{part}_{port}" if part in members else str(endpoint)


def _starts(part: Part) -> Mapping[str, float]:
    assert isinstance(part, FmuPart)
    return {key: value for key, value in part.start_values.items() if not isinstance(value, str)}


def _reason(scenario: Scenario, name: str) -> str:
    """Return why a part cannot be fused; empty if it can."""
    table = scenario.parts[name]
    settings = table.settings
    if not isinstance(settings, FmuSettings):
        return f"it is no FMU but '{table.kind}'"
    if not settings.is_model:
        return "its FMU is a file, and only models that are built here can be fused"
    if settings.flavour != "native":
        return "it is of the python flavour"
    if settings.isolate:
        return "it is isolated in a process of its own"
    return ""


def _check_between(system: System, members: Collection[str]) -> None:
    """Refuse a container that others would have to interrupt: it runs at once."""
    after: set[str] = set()
    for name in system.wiring.order:
        into = [link for link in system.wiring.links if link.target.part == name and not link.delay]
        if name not in members and any(
            link.source.part in members or link.source.part in after for link in into
        ):
            after.add(name)
        late = [link for link in into if name in members and link.source.part in after]
        if late:
            raise SteadytipError(
                f"container of {system.scenario.name}: '{late[0].source.part}' stands between its"
                f" parts ({late[0]}); fuse it too, leave '{name}' out, or delay that wire"
            )


def _plan(
    system: System,
    members: Sequence[str],
    name: str,
    starts: Mapping[str, Mapping[str, float]],
) -> ContainerPlan:
    from fmu_src.kit.container import MemberLink
    from fmu_src.pack.containers import ContainerPlan

    links = [
        MemberLink(link.source, link.target, link.delay)
        for link in system.wiring.links
        if link.source.part in members and link.target.part in members
    ]
    models = [(part, system.scenario.parts[part].settings.table["fmu"]) for part in members]
    return ContainerPlan(name, models, links, system.scenario.step_size, starts)
