"""The loop's own node with the board."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from harness.can.channel import Address
from harness.can.controller_node import ControllerNode
from harness.can.database import load
from harness.can.firmware.process import CHANNELS, FirmwareBoard
from harness.scenario.schema import Hil
from tests.harness.can.firmware.board import DBCS, SAMPLES


def looped(
    recording: Path, dbc: str, ticks: int, faults: Sequence[str] = ()
) -> tuple[ControllerNode, dict[int, tuple[float, ...]], FirmwareBoard]:
    """The loop's own node with the board, on the bulk slcan interface: node, samples by number."""
    taken: dict[int, tuple[float, ...]] = {}
    with FirmwareBoard(recording, dbc, loop=True, faults=faults, seed=5) as board:
        address = Address("slcanbulk", str(board.link))
        node = ControllerNode(load(dbc), "Loop", address, Hil(), 1e-3)
        node.open()
        node.wait_for_board()
        for k in range(ticks):
            sample = node.wait(k).sample
            if sample is not None:
                taken[sample.number] = sample.values
            node.transmit([0.1, 0.15, 0.2])
        node.close()
    return node, taken, board


def named(node: ControllerNode, values: Sequence[float]) -> list[float]:
    """The channels of a sample in the board's order."""
    parts = [m for m in node.database.messages if m.role == "sample"]
    names = [signal.name for m in parts for signal in m.signals]
    return [values[names.index(f"volts_{name}")] for name in CHANNELS]


@pytest.mark.parametrize("dbc", DBCS)
def test_loop_and_board_understand_each_other(recording, volts, dbc) -> None:
    node, taken, board = looped(recording, dbc, 400)
    assert len(taken) > 100  # a loop that is held up takes the newest sample only
    for number, values in taken.items():
        np.testing.assert_allclose(named(node, values), volts[number % SAMPLES], atol=1e-9)
    ours, theirs = node.reception.counts, board.log
    for fault in ("lost", "repeated", "crc", "range", "length", "unknown", "heartbeat"):
        assert ours[fault] == 0, fault
    for fault in ("lost", "repeated", "crc", "range", "length", "unknown"):
        assert theirs[fault][-1] == 0, fault
    assert [theirs[f"volts_{i}"].max() for i in (1, 2, 3)] == pytest.approx([0.1, 0.15, 0.2])


@pytest.mark.parametrize(
    ("fault", "counted"),
    [
        ("drop/0x110:0.05", ["lost", "incomplete"]),
        ("silence@0.2-0.204", ["sequence"]),
        ("silence@0.2-0.22", ["timeouts"]),
        ("duplicate:0.05", ["repeated"]),
        ("stick:0.05", ["repeated"]),
        ("corrupt/0x111:0.05", ["crc", "incomplete"]),
        ("wrong-length/0x112:0.05", ["length", "incomplete"]),
        ("unavailable@0.2-0.3", ["range"]),
        ("unknown:0.05", ["unknown"]),
        ("babble@0.2-0.3", ["unknown"]),
        ("delay/0x110:0.1", ["sequence"]),
        ("drop/0x701@0.05-", ["heartbeat"]),
        ("bus-off@0.2-0.25", ["bus_off"]),
        ("unplug@0.2-0.25", ["unplugged"]),
    ],
)
def test_loop_detects_what_the_board_does_wrong(recording, volts, fault, counted) -> None:
    """Expected: counted as in the table of faults; a sample that is taken was recorded as one."""
    node, taken, _ = looped(recording, "instrument", 500, [fault])
    for name in counted:
        assert node.reception.counts[name] > 0, name
    borne = int(fault.startswith("unavailable"))  # channels that are held
    for number, values in taken.items():
        wrong = np.abs(volts - named(node, values)) > 1e-9
        assert wrong.sum(axis=1).min() <= borne, number
