"""Figures of the CAN transports, printed, never judged: machines are shared. `make bench`.

Three frames a sample at 1 kHz for 5 s between two processes (`virtual`: two threads). Times are
from before `send` to after `recv`; a receiver blocks in `recv` and does nothing else.
"""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import can
import numpy as np
import pytest

pytestmark = [
    pytest.mark.bench,
    pytest.mark.skipif(sys.platform == "win32", reason="needs Unix sockets and ptys"),
]

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 5
IDENTIFIERS = (0x110, 0x111, 0x112)
LAST = 0x7FF


def listen(bus: can.BusABC, cpu=time.process_time) -> dict[str, float]:
    """Receive until the last frame; count, times on the way [us], CPU [%]."""
    print("ready", flush=True)
    ways = []
    begun = None
    while (message := bus.recv(10.0)) is not None and message.arbitration_id != LAST:
        now = time.monotonic_ns()
        if begun is None:
            begun, used = now, cpu()
        ways.append(now - int.from_bytes(message.data, "little"))
    share = 1e11 * (cpu() - used) / (time.monotonic_ns() - begun)
    p50, p99 = 1e-3 * np.percentile(ways, [50, 99])
    return {"count": len(ways), "p50": p50, "p99": p99, "cpu": share}


def listen_alone(**options) -> None:
    """What the receiver's process runs."""
    with can.Bus(**options) as bus:
        print(json.dumps(listen(bus)))


def talk(bus: can.BusABC) -> tuple[int, float]:
    """Send the samples on time; how many frames, and the median cost of a `send` [us]."""
    costs = []
    begun = time.monotonic_ns()
    for k in range(1000 * SECONDS):
        due = begun + 1_000_000 * k
        while (left := due - time.monotonic_ns()) > 0:
            if left > 200_000:
                time.sleep(1e-9 * (left - 150_000))
        for identifier in IDENTIFIERS:
            now = time.monotonic_ns()
            data = now.to_bytes(8, "little")
            bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
            costs.append(time.monotonic_ns() - now)
        bus.recv(0)
    time.sleep(0.1)
    bus.send(can.Message(arbitration_id=LAST, is_extended_id=False))
    return len(costs), 1e-3 * float(np.median(costs))


def report(name: str, sent: int, cost: float, heard: dict[str, float]) -> None:
    print(
        f"\n{name}: {sent - heard['count']} of {sent} lost, one way p50 {heard['p50']:.0f} us,"
        f" p99 {heard['p99']:.0f} us, receiver {heard['cpu']:.1f} % CPU, {cost:.1f} us a send"
    )


def test_virtual() -> None:
    heard = {}
    with (
        can.Bus(interface="virtual", channel="bench") as sender,
        can.Bus(interface="virtual", channel="bench") as receiver,
    ):
        thread = threading.Thread(target=lambda: heard.update(listen(receiver, time.thread_time)))
        thread.start()
        sent, cost = talk(sender)
        thread.join()
    report("virtual", sent, cost, heard)


@pytest.mark.parametrize("name", ["unixbus", "slcanbulk", "slcan"])
def test_between_two_processes(name, tmp_path) -> None:
    if name == "unixbus":
        mine = {"interface": "unixbus", "channel": str(tmp_path)}
        theirs = dict(mine)
    else:
        mine = {"interface": "slcanbulk", "channel": f"pty:{tmp_path / 'tty'}", "device": True}
        theirs = {"interface": name, "channel": str(tmp_path / "tty"), "bitrate": 1_000_000}
        if name == "slcan":
            theirs["sleep_after_open"] = 0
    code = f"from tests.bench.test_can_transports import listen_alone; listen_alone(**{theirs!r})"
    with (
        can.Bus(**mine) as sender,
        subprocess.Popen(
            [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True
        ) as receiver,
    ):
        assert receiver.stdout.readline() == "ready\n"
        sent, cost = talk(sender)
        report(name, sent, cost, json.loads(receiver.communicate(timeout=20)[0]))
