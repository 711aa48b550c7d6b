"""Strokes to voltages: the inverse of each stack's hysteresis, by the operator that is chosen.

Each stack has a memory of its own for every operator that may be chosen. The memories of the
operators that are not chosen rest.
"""

from functools import cache, partial
from typing import Any

import casadi as ca

from fmu_src.controller.interface import RATE_DEPENDENT, STOPS, Memory, Operators, Params
from fmu_src.kit.functions import by_elements, by_matrices
from fmu_src.manipulator import parallel_3dof
from fmu_src.piezo import inverse_modulated_stops as inverse_stops
from fmu_src.piezo import inverse_rate_dependent as inverse_plays
from fmu_src.piezo import modulated_stops as stops
from fmu_src.piezo import prandtl_ishlinskii as plays
from fmu_src.piezo import rate_dependent


def prepare(p: Params, T: float) -> Operators:
    """Compute the operators, the rest position, and the strokes before the first sample."""
    half = p.mechanism.longest_stroke / 2
    lift = parallel_3dof.height(p.mechanism, half) - parallel_3dof.height(p.mechanism, 0.0)
    values: dict[str, Any] = {"rest": ca.vertcat(0.0, 0.0, lift)}
    begun, strokes = initial_memory(p, ca.SX.zeros(3)), []
    for number, played, stopped in _stacks(p):
        values[f"limits_{number}"] = limits = rate_dependent.derive(played, T)
        values[f"constants_{number}"] = constants = stops.derive(stopped, T)
        still, _ = rate_dependent.at_rate(_chosen(p, played), limits, 0.0)
        given = plays.respond(still, getattr(begun, f"plays_{number}"))
        volts = stops.In(volts=p.initial_volts[number - 1])
        _, out = stops.step(stopped, volts, getattr(begun, f"stops_{number}"), T, constants)
        strokes.append(ca.if_else(p.operator == STOPS, out.stroke, given))
    return Operators(initial_strokes=ca.vertcat(*strokes), **values)


@cache
def preparing(T: float) -> ca.Function:
    """Record parameters -> operators: `prepare`, by elements."""
    return by_elements("prepare", partial(prepare, T=T), Params)


def _stacks(p: Params) -> list[tuple[int, rate_dependent.RateDependence, stops.Stops]]:
    """List the number of each stack and its two operators."""
    return [(1, p.stack_1, p.stops_1), (2, p.stack_2, p.stops_2), (3, p.stack_3, p.stops_3)]


def _chosen(p: Params, stack: rate_dependent.RateDependence) -> rate_dependent.RateDependence:
    """Return the operator of plays, without dependence on the rate where that is not chosen."""
    return stack.replace(rate_slopes=stack.rate_slopes * (p.operator == RATE_DEPENDENT))


def initial_memory(p: Params, strokes: Any) -> Memory:
    """Return the memory of the stacks before the first sample.

    Args:
        p: p.
        strokes: lambda_0, (3,) [m].
    """
    values: dict[str, Any] = {"strokes": strokes}
    for number, played, stopped in _stacks(p):
        volts = p.initial_volts[number - 1]
        values[f"plays_{number}"] = plays.remember(played, volts, ca.SX.zeros(plays.PLAYS))
        values[f"stops_{number}"] = stops.resting(stopped, volts)
    return Memory(**values)


@cache
def beginning() -> ca.Function:
    """Record (started, p, strokes, memory) -> memory of the stacks, or the initial one."""
    record = partial(by_elements, cse=False)
    keeping = record("keep_memory", lambda p, strokes, memory: memory, Params, 3, Memory)
    begun = record("begin_memory", lambda p, s, _: initial_memory(p, s), Params, 3, Memory)
    return ca.Function.if_else("begin", keeping, begun)


def by_stops(p: Params, derived: Operators, strokes: Any, x: Memory) -> tuple[Any, ...]:
    """Return the memory, voltages, and whether they are limited or singular, by stops."""
    values: dict[str, Any] = {}
    volts, limited = [], []
    for number, _, stopped in _stacks(p):
        v, too_far, values[f"stops_{number}"] = inverse_stops.drive(
            stopped,
            getattr(derived, f"constants_{number}"),
            p.amplifier,
            strokes[number - 1],
            getattr(x, f"stops_{number}"),
        )
        volts.append(v)
        limited.append(too_far)
    following = x.replace(strokes=strokes, **values)
    return following, ca.vertcat(*volts), limited[0] + limited[1] + limited[2] > 0, 0


def by_plays(p: Params, derived: Operators, strokes: Any, x: Memory, T: float) -> tuple[Any, ...]:
    """Return the memory, voltages, and whether they are limited or singular, by plays."""
    values: dict[str, Any] = {}
    volts, limited, singular = [], [], []
    for number, played, _ in _stacks(p):
        place = number - 1
        v, too_far, values[f"plays_{number}"], too_fast = inverse_plays.drive(
            _chosen(p, played),
            getattr(derived, f"limits_{number}"),
            p.amplifier,
            strokes[place],
            (strokes[place] - x.strokes[place]) / T,
            getattr(x, f"plays_{number}"),
        )
        volts.append(v)
        limited.append(too_far)
        singular.append(too_fast)
    following = x.replace(strokes=strokes, **values)
    any_limited, any_singular = (ca.mmax(ca.vertcat(*flags)) for flags in (limited, singular))
    fast = ca.logic_and(p.operator == RATE_DEPENDENT, any_singular)
    return following, ca.vertcat(*volts), any_limited, fast


@cache
def driving(T: float) -> ca.Function:
    """Record (by stops, p, operators, strokes, memory) -> (memory, volts, limited, singular).

    It gives the voltages for strokes by the operator that is chosen.
    """
    arguments = (Params, Operators, 3, Memory)
    return ca.Function.if_else(
        "drive",
        by_matrices("by_stops", by_stops, *arguments),
        by_elements("by_plays", partial(by_plays, T=T), *arguments),
    )
