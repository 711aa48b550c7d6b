"""A made-up loop and board to look at with the monitor, and what its page asks while one does."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from harness.common.types import FloatArray, PortType
from harness.parts.ports import Column

__all__ = [
    "BOARD",
    "LOOP",
    "ROLES",
    "STEP",
    "TONE",
    "board_rows",
    "columns",
    "get",
    "loop_rows",
    "motion",
    "refresh",
]

STEP = 1e-3  # s
TONE = 9.5  # Hz
ROLES = {
    "tip_uncompensated": ["instrument.free_tip_*"],
    "tip": ["instrument.tip_*"],
    "intent": ["hand.intent_*"],
    "actuator_voltage": ["controller.volts_*"],
    "actuator_stroke": ["piezo_*.stroke"],
}
LOOP: list[tuple[str, PortType, str]] = [
    ("sensors.sample", "Integer", ""),
    ("sensors.age", "Real", "s"),
    ("sensors.valid", "Boolean", ""),
    ("sensors.lost", "Integer", ""),
    ("sensors.crc", "Integer", ""),
    ("sensors.timeouts", "Integer", ""),
    ("sensors.overruns", "Integer", ""),
    ("sensors.command.latency", "Real", "s"),
    ("sensors.command.mode", "Integer", ""),
    ("sensors.volts_sent_1", "Real", "V"),
    ("sensors.volts_sent_2", "Real", "V"),
    ("sensors.volts_sent_3", "Real", "V"),
    ("estimator.valid", "Boolean", ""),
]
BOARD: list[tuple[str, PortType, str]] = [
    (f"{name}_{axis}", "Real", "m")
    for name in ("instrument.free_tip", "instrument.tip", "hand.intent")
    for axis in "xyz"
]


def columns(table: Sequence[tuple[str, PortType, str]]) -> list[Column]:
    """Return columns of a ring from names, types, units."""
    return [Column(n, t, u, f"what {n} says") for n, t, u in table]


def motion(count: int, seed: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return tip without and with compensation, and intent, (count, 3) [m]; 30 % is left."""
    rng = np.random.default_rng(seed)
    t = np.arange(count)[:, np.newaxis] * STEP
    intent = 1e-4 * np.sin(2 * np.pi * np.array([0.3, 0.2, 0.1]) * t)
    swell = 1.0 + 0.4 * np.sin(2 * np.pi * 0.35 * t)
    tremor = np.array([4e-5, 3e-5, 2e-5]) * swell * np.sin(2 * np.pi * TONE * t + [0.0, 1.0, 2.0])
    rest = 2e-6 * rng.standard_normal((count, 3))
    return intent + tremor, intent + 0.3 * tremor + rest, intent


def board_rows(count: int) -> FloatArray:
    """Return rows of the board's ring, (count, 9)."""
    return np.column_stack(motion(count))


def loop_rows(count: int, begin: int = 0) -> FloatArray:
    """Return rows of a loop whose tick `begin + k` takes sample k; 40 samples are lost halfway."""
    rng = np.random.default_rng(2)
    k = np.arange(count)
    lost = (k >= count // 2) & (k < count // 2 + 40)
    sample = np.where(lost, count // 2 - 1, k)
    age = STEP * (1 + k - sample) + 1e-4 * rng.random(count)
    drive = 50.0 + 20.0 * np.sin(2 * np.pi * TONE * STEP * k[:, np.newaxis] + [0.0, 2.0, 4.0])
    latency = np.where(lost, 0.0, 1e-4 * rng.lognormal(0.8, 0.3, count))
    table = np.column_stack(
        [
            sample,
            age,
            ~lost,
            np.cumsum(lost),
            np.where(k > count // 3, 1, 0),
            k > count // 2 + 5,
            np.zeros(count),
            latency,
            np.where(lost, 1, 2),
            drive,
            np.ones(count),
        ]
    )
    early = np.tile(table[:1], (begin, 1))
    early[:, 0] = -1.0
    return np.concatenate([early, table])


def get(url: str, data: bytes | None = None) -> bytes:
    """Return the response of the monitor."""
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=20) as answer:
        content: bytes = answer.read()
    return content


@cache
def _callback_of(url: str) -> dict[str, Any]:
    """Return the callback that refreshes the page, as it is told to the browser."""
    found = [d for d in json.loads(get(f"{url}_dash-dependencies")) if d.get("running")]
    (callback,) = found
    return dict(callback)


def refresh(url: str, drawn: Any = None) -> Any:
    """Ask as the page does, and return the result by output."""
    callback = _callback_of(url)
    names = callback["output"].strip(".").split("...")
    body = {
        "output": callback["output"],
        "outputs": [dict(zip(("id", "property"), name.split("."), strict=True)) for name in names],
        "inputs": [{"id": "beat", "property": "n_intervals", "value": 1}],
        "state": [{"id": "drawn", "property": "data", "value": drawn}],
        "changedPropIds": ["beat.n_intervals"],
    }
    return json.loads(get(f"{url}_dash-update-component", json.dumps(body).encode()))["response"]
