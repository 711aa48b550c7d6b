"""What trackers have in common: exposures at a rate of their own, late arrival, random failures.

A tracker exposes at a rate that need not divide that of the model; an exposure falls on the first
sample at or after its instant. What it saw is a packet that arrives after a latency, in order, one
a sample at most. No plant, and no model of its own.
"""

from typing import Any

import casadi as ca

from fmu_src.kit import State
from fmu_src.kit.noise import standard_normal
from fmu_src.kit.records import integer, real

SLOTS = 8
"""Packets that may be under way at once; one that finds no slot is lost."""
_EARLY = 1e-9
"""Rounding of sums of sample periods, in periods."""
_MOST = 0.5
"""Largest chance of an event in a sample."""


def exposed(phase: Any, rate: Any, T: float) -> tuple[Any, Any]:
    """Whether a tracker exposes at this sample, and its phase at the next one.

    Args:
        phase: exposures that are due, counted in periods; 1 at the first sample.
        rate: exposures in a second, at most one a sample [Hz].
        T: sample period [s].
    """
    now = phase >= 1 - _EARLY
    return now, phase - now + rate * T


def chance(rate: Any, T: float) -> Any:
    """Standard normal draw above which an event of some rate [Hz] happens in a sample."""
    return -standard_normal(ca.fmin(ca.fmax(rate * T, 1e-12), _MOST))


def switched(on: Any, draw: Any, begin: Any, end: Any) -> Any:
    """A failure that begins and ends at random: whether it holds at the next sample.

    Args:
        on: whether it holds now.
        draw: a standard normal draw.
        begin: draw above which it begins, see `chance`.
        end: draw above which it ends.
    """
    return ca.if_else(on, draw <= end, draw > begin)


def queue(size: int) -> type[State]:
    """Record of the packets that are under way, each of `size` numbers, one a column."""

    class Queue(State):
        """Packets under way, the oldest first."""

        packets = real(None, "packets under way", shape=(size, SLOTS), listed=False)
        left = real("s", "time until each arrives", shape=SLOTS, listed=False)
        age = real("s", "age of each", shape=SLOTS, listed=False)
        count = integer("packets under way", min=0, max=SLOTS)

    return Queue


def passed(line: Any, sent: Any, packet: Any, latency: Any, T: float) -> tuple[Any, Any, Any, Any]:
    """One sample of a queue.

    Args:
        line: its record.
        sent: whether a packet is sent now.
        packet: what it holds, (size,).
        latency: time until it arrives [s].
        T: sample period [s].

    Returns:
        The record at the next sample, whether a packet arrives now, that packet, and its age [s].
    """
    sent = ca.logic_and(sent, line.count < SLOTS)
    packets, left, age = [], [], []
    for i in range(SLOTS):
        here = ca.logic_and(sent, line.count == i)
        packets.append(ca.if_else(here, packet, line.packets[:, i]))
        left.append(ca.if_else(here, latency, line.left[i]))
        age.append(ca.if_else(here, 0, line.age[i]))
    count = line.count + sent
    arrived = ca.logic_and(count > 0, left[0] <= _EARLY * T)

    def moved(items: list[Any]) -> list[Any]:
        return [
            ca.if_else(arrived, later, item)
            for item, later in zip(items, [*items[1:], items[-1]], strict=True)
        ]

    following = type(line)(
        packets=ca.horzcat(*moved(packets)),
        left=ca.vertcat(*moved(left)) - T,
        age=ca.vertcat(*moved(age)) + T,
        count=count - arrived,
    )
    # Times of empty slots would run on for ever.
    waiting = ca.DM(range(SLOTS)) < following.count
    following = following.replace(left=waiting * following.left, age=waiting * following.age)
    return following, arrived, packets[0], age[0]
