"""Motion to tremor: the filters that may be chosen, each evaluated only when it is."""

from functools import cache, partial
from typing import Any

import casadi as ca

from fmu_src.controller.interface import EXTERNAL, INERTIAL, TONES, In, Params
from fmu_src.kit.functions import by_elements, by_matrices
from fmu_src.math import rotations
from fmu_src.tremor import inertial, var_forecaster, wflc_flc


@cache
def tones(T: float) -> ca.Function:
    """Record (filter, position, valid, state) -> (state, out): WFLC and FLC, by elements."""
    records = (wflc_flc.WflcFlcParams, 3, 1, wflc_flc.WflcFlcState)
    return by_elements("tones", partial(wflc_flc.estimate, T=T), *records)


def if_chosen(function: ca.Function) -> ca.Function:
    """Record (chosen, *arguments, state) -> (state, 3 numbers); not chosen, it costs nothing.

    Args:
        function: (*arguments, state) -> (state, 3 numbers).
    """
    arguments = function.mx_in()
    rests = ca.Function("rest", arguments, [arguments[-1], ca.MX(3, 1)])
    return ca.Function.if_else(f"{function.name()}_if_chosen", function, rests)


@cache
def forecast(T: float) -> ca.Function:
    """Record (band, position, valid, state) -> (state, tremor)."""
    records = (var_forecaster.Weights, 3, 1, var_forecaster.X)
    return by_matrices("forecast", partial(var_forecaster.estimate, T=T), *records)


@cache
def sense(T: float) -> ca.Function:
    """Record (front, force, valid, state) -> (state, motion)."""
    records = (inertial.Front, inertial.CHANNELS, 1, inertial.Sensed)
    return by_matrices("sense", partial(inertial.sense, T=T), *records)


def _choose(choice: Any, u: In, tone: Any, forecasted: Any) -> Any:
    """Return y_W, (3,) [m], of the filter chosen."""
    choices = {
        TONES: tone,
        INERTIAL: rotations.matrix(u.attitude) @ forecasted,
        EXTERNAL: u.external_tremor,
    }
    tremor = forecasted
    for number, found in choices.items():
        tremor = ca.if_else(choice == number, found, tremor)
    return tremor


CHOOSE_TREMOR = by_elements("choose_tremor", _choose, 1, In, 3, 3, cse=False)


def chosen_tremor(p: Params, u: In, tone: Any, forecasted: Any) -> Any:
    """Return y_W, (3,) [m], from both filters' outputs, that of the first packed."""
    return CHOOSE_TREMOR(p.tremor_filter, u.pack(), wflc_flc.Out.unpack(tone).tremor, forecasted)
