"""Tremor canceller: from the estimator's outputs to piezo voltages (A04 8.2.2).

    tremor    y_W = filter(tip displacement or forces), a horizon ahead     A04 5.2.1
    demand    d_0 = d_rest - engagement R(q_WB)^T y_W                       frame 0 parallel to B
    strokes   lambda = inverse kinematics(d_0), the nearest that is in reach   A04 6.3
              lambda <- lambda_0 + rise (lambda - lambda_0)
    voltages  v_i = inverse hysteresis_i(lambda_i), within the amplifier's  A04 7.2.4

`tremor_filter` chooses what tells tremor from intent: 1, WFLC and FLC behind an elliptic prefilter
(A04 5.2.1), good on a tone; 2, the forecaster, which learns the spectrum of a hand's motion; 3, the
forecaster on the compensated channels of the accelerometers themselves, for motion that is known
from those alone; 4, a filter outside, whose tremor comes in. 1 and 2 take the displacement of the
tip, 3 the forces.

`operator` chooses what is inverted: 1, the modified Prandtl-Ishlinskii operator (A04 7.2); 2, the
rate-dependent one (A04 7.3); 3, modulated stops with creep and lag, the most exact. The first two
have the parameters `stack_1` to `stack_3`, where the first leaves the dependence on the rate out;
the third has `stops_1` to `stops_3`.

Stacks push only, so the tip rests where all strokes are half their range, and has as far to go
either way. `rise` brings it there within `rise_time` from the first sample, from the strokes
lambda_0 that belong to `initial_volts`, which the stacks have reached from 0 V and been at for
long. `engagement` fades the correction in within `fade_time` once the stacks have risen and the
motion is valid; when it is not, or on `hold`, it fades the correction, which the filter's model
carries on meanwhile, out to rest. Both follow s(p) = 3 p^2 - 2 p^3 of a progress p that runs from
0 to 1, so that nothing jumps.

Limits: the tip goes to the nearest place in reach, then each voltage is limited by itself;
`saturated` tells of either. The memory of the hysteresis follows the voltage really sent. Faster
than the rate at which a rate-dependent operator ceases to have an inverse its slopes stay what they
are at it, and `singular` tells.

The horizon makes up for what lies between a tip and the correction of it: the command computed
from one sample is held until the next one, where its effect is seen. How far a stack lags behind is
in the operator 3; for the others `stack_delay` is added. The horizon and the wash-out, that of the
estimator whose displacement comes in and 0 for a true position, are those of `filter`, and hold for
the forecaster, too.

Recorded by matrices, as the forecaster is; what acts on its tremor is recorded by elements and
called from there.

| symbol | field | meaning |
| --- | --- | --- |
| y_W | tremor | tremor of the tip in the world, at the time when the voltages act |
| q_WB | attitude | rotates body vectors into the world |
| d_rest | rest | tip at half stroke less tip at zero stroke |
| rise, engagement | rise, engagement | progress p of each, 0 to 1 |
| lambda_i, v_i | volts | stroke and voltage of stack i |
| lambda_0 | initial_strokes | strokes before the first sample |
"""

from functools import cache
from typing import Any

import casadi as ca

from fmu_src.controller.correction import acting
from fmu_src.controller.interface import (
    FORECASTER,
    INERTIAL,
    SAMPLE_PERIOD,
    STOPS,
    Command,
    Driving,
    In,
    Operators,
    Out,
    Params,
    Precomputed,
    X,
)
from fmu_src.controller.stacks import preparing
from fmu_src.controller.tremor_filters import chosen_tremor, forecast, if_chosen, sense, tones
from fmu_src.kit.model import Model
from fmu_src.math import phasors
from fmu_src.tremor import inertial, var_forecaster, wflc_flc


def delay(p: Params) -> Any:
    """Return how far ahead the tremor is wanted [s]."""
    lag = ca.if_else(p.operator == STOPS, 0.0, p.stack_delay)
    return p.filter.horizon + lag


def derive(p: Params, T: float) -> Precomputed:
    """Compute the operators, and the forecaster's band-pass."""
    operators = Operators.unpack(preparing(T)(p.pack()))

    def undo(frequencies: Any) -> phasors.Pair:
        """Undo what an acceleration or a washed-out displacement has been through."""
        accelerated = inertial.undo(p.sensing.lag, frequencies)
        washed = phasors.wash_out_undone(p.filter.wash_out, frequencies)
        from_forces = p.tremor_filter == INERTIAL
        real_part, imaginary = (
            ca.if_else(from_forces, a, w) for a, w in zip(accelerated, washed, strict=True)
        )
        return real_part, imaginary

    values = {name: getattr(operators, name) for name in Operators.fields}
    return Precomputed(
        band=var_forecaster.weights(p.forecaster, delay(p), undo, T),
        front=inertial.derive(p.sensing, T),
        **values,
    )


def put_out(command: Any, tremor: Any, tone: Any) -> Out:
    """Return the outputs from the command, packed, the tremor, and the tones, packed."""
    acts = Command.unpack(command)
    return Out(
        volts=acts.volts,
        tremor=tremor,
        frequency=wflc_flc.Out.unpack(tone).frequency,
        engagement=acts.engagement,
        saturated=acts.saturated,
        singular=acts.singular,
    )


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    ahead = p.filter.replace(horizon=delay(p)).pack()
    filtered, tone = tones(T)(ahead, u.tip_displacement, u.valid, x.filter.pack())
    from_forces = p.tremor_filter == INERTIAL
    front, motion = if_chosen(sense(T))(
        from_forces, derived.front.pack(), u.force, u.valid, x.front.pack()
    )
    position = ca.if_else(from_forces, motion, u.tip_displacement)
    forecasts = ca.logic_or(from_forces, p.tremor_filter == FORECASTER)
    learnt, forecasted = if_chosen(forecast(T))(
        forecasts, derived.band.pack(), position, u.valid, x.forecaster.pack()
    )
    tremor = chosen_tremor(p, u, tone, forecasted)
    operators = operators_of(derived)
    driven, command = acting(T)(p.pack(), operators, u.pack(), tremor, x.driving.pack())
    following = X(
        filter=wflc_flc.WflcFlcState.unpack(filtered),
        driving=Driving.unpack(driven),
        front=inertial.Sensed.unpack(front),
        forecaster=var_forecaster.X.unpack(learnt),
    )
    return following, put_out(command, tremor, tone)


@cache
def last_output(function: ca.Function, *moving: int) -> ca.Function:
    """Record the last output of a function alone, a function of all its arguments.

    Args:
        function: by elements.
        moving: arguments that derivatives are wanted by; the others count as constant.
    """
    arguments = function.sx_in()
    differentiable = [index in moving for index in range(len(arguments))]
    output = function.call(arguments, True, False)[-1]
    options: dict[str, Any] = {"cse": True, "is_diff_in": differentiable}
    return ca.Function(f"{function.name()}_answer", arguments, [output], options)


def output_function(p: Params, u: In, x: X, T: float, derived: Precomputed) -> Out:
    """Return the outputs of a sample alone."""
    ahead = p.filter.replace(horizon=delay(p)).pack()
    find = last_output(tones(T), 1, 2)
    tone = find(ahead, u.tip_displacement, u.valid, x.filter.pack())
    motion = inertial.motion(x.front, inertial.since(u.force, u.valid, x.front))
    position = ca.if_else(p.tremor_filter == INERTIAL, motion, u.tip_displacement)
    found = var_forecaster.estimate_outputs(derived.band, position, u.valid, x.forecaster, T)
    tremor = chosen_tremor(p, u, tone, found.tremor)
    drives = last_output(acting(T), 2, 3)
    command = drives(p.pack(), operators_of(derived), u.pack(), tremor, x.driving.pack())
    return put_out(command, tremor, tone)


def operators_of(derived: Precomputed) -> Any:
    """Return the operators, packed; in `Precomputed` they come first."""
    return derived.pack()[: Operators.size()]


MODEL = Model.of_step(
    "TremorCanceller", step, SAMPLE_PERIOD, derive=derive, matrix=True, answer=output_function
)
