"""A small scenario that a sweep runs in milliseconds, of FMUs that are built from models."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import steadytip as st
from harness.sweep.outcome import SweepResult

SMALL = """
seconds = 1.5
step_size    = 1e-3
warm_up  = 0.2
seed    = 3
[part.sensor]
fmu   = "DisplacementSensor"
noise = 1e-6
[part.again]
fmu   = "DisplacementSensor"
noise = 0.0
[[wire]]
from = "sensor.measured"
to   = "again.stroke"
[signals]
actuator_voltage = "again.measured"
"""
NOISE = "part.sensor.noise"
WIRE = "sensor.measured"
CLOCK = "real_time_factor"

Small = Callable[..., Path]


@pytest.fixture
def small(tmp_path: Path) -> Small:
    def write(more: str = "", name: str = "small.toml") -> Path:
        path = tmp_path / name
        path.write_text(SMALL + more)
        return path

    return write


def alone(outcome: SweepResult, run: int, scenario: Path, folder: Path) -> dict[str, Any]:
    """Figures of a case that is run by itself, with what its command says."""
    import shlex
    import tomllib

    table = outcome.table.to_pylist()[run]
    words = shlex.split(table["command"])
    assert words[:3] == ["steadytip", "run", str(scenario)]
    values: dict[str, Any] = {}
    motion = None
    for option, value in zip(words[3::2], words[4::2], strict=True):
        if option == "--seed":
            values["seed"] = int(value)
        elif option == "--motion":
            motion = value
        else:
            assert option == "--set"
            key, _, text = value.partition("=")
            values[key] = tomllib.loads(f"value = {text}")["value"]
    result = st.run(scenario, overrides=values, motion=motion, out=folder / "alone", report=False)
    return {name: metric.value for name, metric in result.metrics.items() if name != CLOCK}


def figures(outcome: SweepResult, run: int) -> dict[str, Any]:
    row = outcome.table.to_pylist()[run]
    return {name: row[name] for name in outcome.figures}
