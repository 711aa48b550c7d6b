"""Parameters, and inputs from a recorded run, that each model's FMU is measured with.

Shipped scenarios are run, and with them, as listeners that nothing hears, the models that could
stand in them and do not. What a part took in such a run is what its FMU gets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from harness.common.types import FloatArray
from harness.parts.description import Description
from harness.parts.fmu import FmuPart
from harness.results.result import Result
from harness.running import perform
from harness.scenario import load as scenarios
from harness.system.assembly import System, assemble

__all__ = ["StepCase", "cases", "names"]

_SENSED = {
    "force_*": "estimator.force_*",
    "attitude_*": "estimator.attitude_*",
    "valid": "estimator.valid",
}
_TIP = {"tip_displacement_*": "estimator.tip_displacement_*"}
_POSITION = {"position_*": "estimator.tip_displacement_*", "valid": "estimator.valid"}
_POSITION_ALONE = {"position_*": "estimator.tip_displacement_*"}
_VOLTS = {"volts": "controller.volts_1"}
_STROKE = {"stroke": "piezo_1.stroke"}
_STROKES = {f"strokes_{i}": f"piezo_{i}.stroke" for i in (1, 2, 3)}
_TRACKED = {
    "optical_*": "tracker.optical_*",
    "rate_*": "imu.rate_*",
    "force_*": "imu.force_*",
    "inertial_valid": "imu.inertial_valid",
}
_LISTENERS: dict[str, list[tuple[dict[str, Any], dict[str, str]]]] = {
    "closed_loop": [
        ({"fmu": "TremorCanceller", "tremor_filter": 1}, _SENSED | _TIP),
        ({"fmu": "TremorCanceller", "tremor_filter": 2}, _SENSED | _TIP),
        *(({"fmu": name}, _POSITION_ALONE) for name in ("Wflc", "Flc")),
        *(
            ({"fmu": name}, _POSITION)
            for name in (
                "WflcFlc",
                "Bmflc",
                "BmflcKf",
                "IntentOscillators",
                "ArKalman",
                "VarForecaster",
                "Shelving",
                "CascadeNeural",
            )
        ),
        *(({"fmu": name}, _SENSED) for name in ("InertialForecaster", "InertialOscillators")),
        ({"fmu": "Parallel3Dof"}, {"displacement_*": "estimator.tip_displacement_*"}),
        ({"fmu": "Parallel3DofForward"}, _STROKES),
        *(({"fmu": f"{name}PrandtlIshlinskii"}, _VOLTS) for name in ("", "Rate", "Creep")),
        ({"fmu": "ModulatedStops"}, _VOLTS),
        *(({"fmu": f"Inverse{name}PrandtlIshlinskii"}, _STROKE) for name in ("", "Rate", "Creep")),
        ({"fmu": "InverseModulatedStops"}, _STROKE),
        ({"fmu": "DisplacementSensor"}, _STROKE),
        ({"fmu": "SignalFault"}, {"signal": "piezo_1.stroke"}),
    ],
    "pose_tracking": [
        *(({"fmu": name}, _TRACKED) for name in ("OpticalInertialUkf", "OpticalPoseUkf")),
    ],
    "em_tracking": [],
    "optical_tracking": [],
}
"""By scenario: settings of parts, and what drives their inputs."""
_LISTENER = "listener"


@dataclass(frozen=True)
class StepCase:
    """An FMU and what it gets.

    Attributes:
        name: of the model, with the parameters of a listener.
        description: of the FMU.
        starts: start values by variable name.
        connected: inputs, in the order of `Instance.stepper`.
        table: (n, len(driven)) their values, one row for each sample of the FMU.
        period: between samples [s].
        setting: where this is from.
    """

    name: str
    description: Description
    starts: Mapping[str, Any]
    connected: tuple[str, ...]
    table: FloatArray
    period: float
    setting: str


def cases(folder: Path, seconds: float) -> list[StepCase]:
    """Return every model as it stands in the first scenario that has it, and each listener.

    Args:
        folder: for the runs.
        seconds: their length [s].
    """
    found: dict[str, StepCase] = {}
    for name in _LISTENERS:
        for case in _recorded(name, folder, seconds):
            found.setdefault(case.name, case)
    return list(found.values())


def names() -> list[str]:
    """Return the names of all cases: every model of ours, and the parameters of listeners."""
    from fmu_src.pack.discovery import model_names

    listeners = [settings for parts in _LISTENERS.values() for settings, _ in parts]
    return sorted({*model_names(), *(_titled(dict(each)) for each in listeners)})


def _titled(starts: dict[str, Any]) -> str:
    model = starts.pop("fmu")
    words = ", ".join(f"{name} = {value:g}" for name, value in starts.items() if name != "seed")
    return f"{model} ({words})" if words else str(model)


def _recorded(name: str, folder: Path, seconds: float) -> Iterator[StepCase]:
    system = assemble(scenarios.load(_with_listeners(name, folder), {"seconds": seconds}))
    result = perform(system, folder / name, report=False)
    for part in system.parts.values():
        if isinstance(part, FmuPart):
            yield _case(name, part, system, result)


def _with_listeners(name: str, folder: Path) -> Path:
    """Write a scenario file that extends a shipped one."""
    import tomli_w

    parts: dict[str, Any] = {}
    wires: list[dict[str, str]] = []
    for number, (settings, sources) in enumerate(_LISTENERS[name], start=1):
        listener = f"{_LISTENER}_{number}"
        parts[listener] = settings
        wires += [{"from": source, "to": f"{listener}.{to}"} for to, source in sources.items()]
    table = {"extends": name, "warm_up": 0.0, "part": parts, "wire": wires}
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return path


def _case(scenario: str, part: FmuPart, system: System, result: Result) -> StepCase:
    links = system.wiring.into(part.name)
    connected = tuple(port.name for port in part.inputs if port.name in links)
    taken = [
        _late(result.signals(str(links[port].source)), links[port].delay) for port in connected
    ]
    table = np.column_stack(taken) if taken else np.empty((system.steps, 0))
    step = system.scenario.step_size
    period = part.description.step or step
    rows = np.arange(round(len(table) * step / period)) * period / step
    listener = part.name.partition("_")[0] == _LISTENER
    model = part.description.model.modelName
    return StepCase(
        name=_titled({"fmu": model, **(part.start_values if listener else {})}),
        description=part.description,
        starts=part.start_values,
        connected=connected,
        table=np.ascontiguousarray(table[(rows + 1e-6).astype(int)]),
        period=period,
        setting=f"{'signals of' if listener else 'as in'} {scenario}",
    )


def _late(signal: FloatArray, delay: int) -> FloatArray:
    """Delay a signal as a wire does; before the run it has its first value."""
    values = signal.astype(float)
    return np.concatenate([np.repeat(values[:1], delay), values[: len(values) - delay]])
