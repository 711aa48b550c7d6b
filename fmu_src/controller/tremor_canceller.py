"""Tremor canceller: what the estimator knows in, piezo voltages out (A04 8.2.2).

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

from fmu_src.estimation.micron import model as micron
from fmu_src.kit import Model, Outputs, Parameters, State
from fmu_src.kit.records import Derived, boolean, integer, real
from fmu_src.manipulator import parallel_3dof
from fmu_src.math import phasors, rotations
from fmu_src.piezo import inverse_modulated_stops as inverse_stops
from fmu_src.piezo import inverse_rate_dependent as inverse_plays
from fmu_src.piezo import modulated_stops as stops
from fmu_src.piezo import prandtl_ishlinskii as plays
from fmu_src.piezo import rate_dependent
from fmu_src.piezo.inverse_prandtl_ishlinskii import Range
from fmu_src.tremor import inertial, var_forecaster, wflc_flc

SAMPLE_PERIOD = 1e-3
STACK_DELAY = 0.3e-3
"""Of a stack behind the stroke asked for, where the operator does not hold it [s]: measured, 0.1 ms
at 3 um and 0.6 ms at 0.35 um."""
ESTIMATOR_STARTS = {scalar.name: scalar.start for scalar in micron.Params.scalars()}
TONES, FORECASTER, INERTIAL, EXTERNAL = 1, 2, 3, 4
"""Choices of the filter."""
PLAIN, RATE_DEPENDENT, STOPS = 1, 2, 3
"""Choices of the operator."""


class Params(Parameters):
    """Tremor filter, mechanism, stacks, and how it starts."""

    filter: Any = wflc_flc.WflcFlcParams.starting(
        horizon=SAMPLE_PERIOD, wash_out=ESTIMATOR_STARTS["washout"]
    )
    tremor_filter = integer(
        "what finds the tremor: 1 WFLC and FLC, 2 forecaster, 3 forecaster on forces, 4 external",
        start=INERTIAL,
        min=TONES,
        max=EXTERNAL,
    )
    forecaster: Any = var_forecaster.Learning
    sensing: Any = inertial.Sensing
    mechanism: Any = parallel_3dof.Geometry
    operator = integer(
        "what is inverted: 1 Prandtl-Ishlinskii, 2 the rate-dependent one, 3 modulated stops",
        start=STOPS,
        min=PLAIN,
        max=STOPS,
    )
    stack_1: Any = rate_dependent.RateDependence
    stack_2: Any = rate_dependent.RateDependence
    stack_3: Any = rate_dependent.RateDependence
    stops_1: Any = stops.Stops
    stops_2: Any = stops.Stops
    stops_3: Any = stops.Stops
    stack_delay = real(
        "s", "lag of the stacks that operators 1 and 2 lack", start=STACK_DELAY, min=0.0, max=0.01
    )
    amplifier: Any = Range
    initial_volts = real(
        "V", "voltages of the stacks before the first sample", shape=3, min=-200.0, max=200.0
    )
    rise_time = real("s", "from there to rest", start=0.5, min=0.01, max=60.0)
    fade_time = real("s", "correction from none to full and back", start=0.5, min=0.01, max=60.0)


class Memory(State):
    """What the stacks remember, by the operators that may be chosen."""

    plays_1 = real("V", "H of stack 1", shape=plays.PLAYS)
    plays_2 = real("V", "H of stack 2", shape=plays.PLAYS)
    plays_3 = real("V", "H of stack 3", shape=plays.PLAYS)
    stops_1: Any = stops.Memory
    stops_2: Any = stops.Memory
    stops_3: Any = stops.Memory
    strokes = real("m", "strokes of the sample before", shape=3)


class Operators(Derived):
    """Operators, the rest position, and where the stacks are before the first sample."""

    rest = real("m", "d_rest, tip at half stroke less tip at zero stroke, frame 0", shape=3)
    limits_1: Any = rate_dependent.Limits
    limits_2: Any = rate_dependent.Limits
    limits_3: Any = rate_dependent.Limits
    constants_1: Any = stops.Constants
    constants_2: Any = stops.Constants
    constants_3: Any = stops.Constants
    initial_strokes = real("m", "lambda_0, strokes before the first sample", shape=3)


class Precomputed(Operators):
    """The same, the forecaster's band-pass, and what is known of the accelerometers."""

    band: Any = var_forecaster.Weights
    front: Any = inertial.Front


class In(inertial.In):
    """What the estimator knows."""

    tip_displacement = real(
        "m", "estimated displacement of the tip, frame W", shape=3, axes="xyz", min=-1.0, max=1.0
    )
    external_tremor = real(
        "m", "tremor that another filter has found, frame W", shape=3, axes="xyz", min=-1.0, max=1.0
    )
    hold = boolean("whether the tip shall go to rest and stay there", start=False)


class Driving(State):
    """Memory of what acts, and progress of start and correction."""

    stacks: Any = Memory
    started = boolean("whether there has been a sample")
    rise = real(None, "progress of the start", min=0.0, max=1.0)
    engagement = real(None, "progress of the correction", min=0.0, max=1.0)


class X(State):
    """Memories of the filters, and of what acts."""

    filter: Any = wflc_flc.WflcFlcState
    driving: Any = Driving
    front: Any = inertial.Sensed
    forecaster: Any = var_forecaster.X


class Out(Outputs):
    """Drive, and what it is to cancel."""

    volts = real("V", "v, voltages of the stacks", shape=3)
    tremor = real("m", "y_W, tremor of the tip, frame W", shape=3, axes="xyz")
    frequency = real("Hz", "its frequency along each axis", shape=3, axes="xyz")
    engagement = real(None, "share of the correction that acts, 0 to 1")
    saturated = boolean("whether the tip or a voltage had to be limited")
    singular = boolean("whether a stack is to move faster than its operator can be inverted")


class Command(Outputs):
    """What acts: outputs but for the filter's."""

    volts = real("V", "v", shape=3)
    engagement = real(None, "share of the correction that acts")
    saturated = boolean("whether the tip or a voltage had to be limited")
    singular = boolean("whether a stack is to move too fast")


def prepare(p: Params, T: float) -> Operators:
    """Operators, the rest position, and where the stacks are before the first sample."""
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


def _stacks(p: Params) -> list[tuple[int, rate_dependent.RateDependence, stops.Stops]]:
    """Number of each stack, and its two operators."""
    return [(1, p.stack_1, p.stops_1), (2, p.stack_2, p.stops_2), (3, p.stack_3, p.stops_3)]


def _chosen(p: Params, stack: rate_dependent.RateDependence) -> rate_dependent.RateDependence:
    """Operator of plays, without its dependence on the rate where that is not chosen."""
    return stack.replace(rate_slopes=stack.rate_slopes * (p.operator == RATE_DEPENDENT))


def initial_memory(p: Params, strokes: Any) -> Memory:
    """What the stacks remember before the first sample.

    Args:
        p: parameters.
        strokes: lambda_0, (3,) [m].
    """
    values: dict[str, Any] = {"strokes": strokes}
    for number, played, stopped in _stacks(p):
        volts = p.initial_volts[number - 1]
        values[f"plays_{number}"] = plays.remember(played, volts, ca.SX.zeros(plays.PLAYS))
        values[f"stops_{number}"] = stops.resting(stopped, volts)
    return Memory(**values)


def smooth(progress: Any) -> ca.SX:
    """From 0 to 1 with slopes of 0 at both ends."""
    return progress**2 * (3 - 2 * progress)


def by_stops(T: float) -> ca.Function:
    """(p, operators, strokes, memory) -> (memory, volts, limited, singular), by modulated stops."""
    p, d = ca.MX.sym("p", Params.size()), ca.MX.sym("d", Operators.size())
    strokes, memory = ca.MX.sym("strokes", 3), ca.MX.sym("memory", Memory.size())
    parameters, derived, x = Params.unpack(p), Operators.unpack(d), Memory.unpack(memory)
    values: dict[str, Any] = {}
    volts, limited = [], []
    for number, _, stopped in _stacks(parameters):
        v, too_far, values[f"stops_{number}"] = inverse_stops.drive(
            stopped,
            getattr(derived, f"constants_{number}"),
            parameters.amplifier,
            strokes[number - 1],
            getattr(x, f"stops_{number}"),
        )
        volts.append(v)
        limited.append(too_far)
    following = x.replace(strokes=strokes, **values)
    results = [following.pack(), ca.vertcat(*volts), limited[0] + limited[1] + limited[2] > 0, 0]
    return ca.Function("by_stops", [p, d, strokes, memory], results)


def by_plays(T: float) -> ca.Function:
    """(p, operators, strokes, memory) -> (memory, volts, limited, singular), by the other two."""
    p, d = ca.SX.sym("p", Params.size()), ca.SX.sym("d", Operators.size())
    strokes, memory = ca.SX.sym("strokes", 3), ca.SX.sym("memory", Memory.size())
    parameters, derived, x = Params.unpack(p), Operators.unpack(d), Memory.unpack(memory)
    values: dict[str, Any] = {}
    volts, limited, singular = [], [], []
    for number, played, _ in _stacks(parameters):
        place = number - 1
        v, too_far, values[f"plays_{number}"], too_fast = inverse_plays.drive(
            _chosen(parameters, played),
            getattr(derived, f"limits_{number}"),
            parameters.amplifier,
            strokes[place],
            (strokes[place] - x.strokes[place]) / T,
            getattr(x, f"plays_{number}"),
        )
        volts.append(v)
        limited.append(too_far)
        singular.append(too_fast)
    following = x.replace(strokes=strokes, **values)
    any_limited, any_singular = (ca.mmax(ca.vertcat(*flags)) for flags in (limited, singular))
    fast = ca.logic_and(parameters.operator == RATE_DEPENDENT, any_singular)
    results = [following.pack(), ca.vertcat(*volts), any_limited, fast]
    return ca.Function("by_plays", [p, d, strokes, memory], results, {"cse": True})


@cache
def driving(T: float) -> ca.Function:
    """(by stops, p, operators, strokes, memory) -> (memory, volts, limited, singular).

    Voltages that give strokes, by the operator that is chosen; the memories of the others rest.
    """
    return ca.Function.if_else("drive", by_stops(T), by_plays(T))


def aim(
    p: Params, derived: Operators, u: In, tremor: Any, x: Driving, T: float
) -> tuple[Any, Any, Any, Any]:
    """Strokes against a tremor.

    Args:
        p: parameters.
        derived: what follows from them.
        u: attitude, and whether to correct at all.
        tremor: y_W, (3,) [m].
        x: memory and progress.
        T: sample period [s].

    Returns:
        Strokes, (3,) [m], whether they are all that is wanted, and progress of start and
        correction.
    """
    rise = ca.fmin(x.rise + T / p.rise_time, 1.0)
    wanted = ca.logic_and(ca.logic_and(u.valid, ca.logic_not(u.hold)), rise >= 1)
    towards = ca.if_else(wanted, 1.0, -1.0)
    engagement = ca.fmin(ca.fmax(x.engagement + towards * T / p.fade_time, 0.0), 1.0)
    correction = -rotations.matrix(u.attitude).T @ tremor
    demand = derived.rest + smooth(engagement) * correction

    strokes, reachable = parallel_3dof.limited(
        p.mechanism, parallel_3dof.inverse(p.mechanism, demand)
    )
    initial = derived.initial_strokes
    strokes = initial + smooth(rise) * (strokes - initial)
    return strokes, reachable, rise, engagement


@cache
def aiming(T: float) -> ca.Function:
    """(p, operators, u, tremor, driving) -> (strokes, reachable, rise, engagement): `aim`."""
    records = (Params, Operators, In, Driving)
    p, d, u, x = (ca.SX.sym(record.__name__, record.size()) for record in records)
    tremor = ca.SX.sym("tremor", 3)
    unpacked = (Params.unpack(p), Operators.unpack(d), In.unpack(u))
    results = aim(*unpacked, tremor, Driving.unpack(x), T)
    return ca.Function("aim", [p, d, u, tremor, x], list(results), {"cse": True})


@cache
def beginning() -> ca.Function:
    """(started, p, strokes, memory) -> memory of the stacks, or the initial one."""
    p, strokes = ca.SX.sym("p", Params.size()), ca.SX.sym("strokes", 3)
    memory = ca.SX.sym("memory", Memory.size())
    arguments = [p, strokes, memory]
    begun = initial_memory(Params.unpack(p), strokes).pack()
    keeping = ca.Function("keep_memory", arguments, [memory])
    return ca.Function.if_else("begin", keeping, ca.Function("begin_memory", arguments, [begun]))


@cache
def acting(T: float) -> ca.Function:
    """(p, operators, u, tremor, driving) -> (driving, command): voltages against a tremor."""
    records = (Params, Operators, In, Driving)
    p, d, u, state = (ca.MX.sym(record.__name__, record.size()) for record in records)
    tremor = ca.MX.sym("tremor", 3)
    parameters, derived, x = Params.unpack(p), Operators.unpack(d), Driving.unpack(state)
    strokes, reachable, rise, engagement = aiming(T)(p, d, u, tremor, state)
    memory = beginning()(x.started, p, derived.initial_strokes, x.stacks.pack())
    following, volts, limited, singular = driving(T)(
        parameters.operator == STOPS, p, d, strokes, memory
    )
    driven = Driving(
        stacks=Memory.unpack(following), started=ca.MX(1.0), rise=rise, engagement=engagement
    )
    command = Command(
        volts=volts,
        engagement=smooth(engagement),
        saturated=ca.logic_or(ca.logic_not(reachable), limited),
        singular=singular,
    )
    return ca.Function("act", [p, d, u, tremor, state], [driven.pack(), command.pack()])


@cache
def preparing(T: float) -> ca.Function:
    """Parameters -> operators: `prepare`, by elements."""
    p = ca.SX.sym("p", Params.size())
    return ca.Function("prepare", [p], [prepare(Params.unpack(p), T).pack()], {"cse": True})


@cache
def tones(T: float) -> ca.Function:
    """(filter, position, valid, state) -> (state, out): WFLC and FLC, by elements."""
    records = (wflc_flc.WflcFlcParams, wflc_flc.WflcFlcState)
    p, x = (ca.SX.sym(record.__name__, record.size()) for record in records)
    position, valid = ca.SX.sym("position", 3), ca.SX.sym("valid")
    unpacked = (wflc_flc.WflcFlcParams.unpack(p), position, valid)
    following, out = wflc_flc.estimate(*unpacked, wflc_flc.WflcFlcState.unpack(x), T)
    arguments, columns = [p, position, valid, x], [following.pack(), out.pack()]
    return ca.Function("tones", arguments, columns, {"cse": True})


def if_chosen(function: ca.Function) -> ca.Function:
    """(chosen, *arguments, state) -> (state, 3 numbers): if not chosen, it rests and is free.

    Args:
        function: (*arguments, state) -> (state, 3 numbers).
    """
    arguments = function.mx_in()
    rests = ca.Function("rest", arguments, [arguments[-1], ca.MX(3, 1)])
    return ca.Function.if_else(f"{function.name()}_if_chosen", function, rests)


@cache
def forecast(T: float) -> ca.Function:
    """(band, position, valid, state) -> (state, tremor)."""
    band = ca.MX.sym("band", var_forecaster.Weights.size())
    x = ca.MX.sym("x", var_forecaster.X.size())
    position, valid = ca.MX.sym("position", 3), ca.MX.sym("valid")
    unpacked = (var_forecaster.Weights.unpack(band), position, valid)
    following, out = var_forecaster.estimate(*unpacked, var_forecaster.X.unpack(x), T)
    columns = [following.pack(), out.pack()]
    return ca.Function("forecast", [band, position, valid, x], columns)


@cache
def sense(T: float) -> ca.Function:
    """(front, force, valid, state) -> (state, motion)."""
    front = ca.MX.sym("front", inertial.Front.size())
    x = ca.MX.sym("x", inertial.Sensed.size())
    force, valid = ca.MX.sym("force", inertial.CHANNELS), ca.MX.sym("valid")
    unpacked = (inertial.Front.unpack(front), force, valid)
    following, motion = inertial.sense(*unpacked, inertial.Sensed.unpack(x), T)
    return ca.Function("sense", [front, force, valid, x], [following.pack(), motion])


@cache
def last_output(function: ca.Function, *moving: int) -> ca.Function:
    """The last output of a function alone, a function of all its arguments.

    Args:
        function: by elements.
        moving: arguments that derivatives are wanted by; the others count as constant.
    """
    arguments = function.sx_in()
    differentiable = [index in moving for index in range(len(arguments))]
    output = function.call(arguments, True, False)[-1]
    options: dict[str, Any] = {"cse": True, "is_diff_in": differentiable}
    return ca.Function(f"{function.name()}_answer", arguments, [output], options)


def delay(p: Params) -> Any:
    """How far ahead the tremor is wanted [s]."""
    lag = ca.if_else(p.operator == STOPS, 0.0, p.stack_delay)
    return p.filter.horizon + lag


def derive(p: Params, T: float) -> Precomputed:
    """Operators, and the forecaster's band-pass."""
    operators = Operators.unpack(preparing(T)(p.pack()))

    def undo(frequencies: Any) -> phasors.Pair:
        """What an acceleration or a washed-out displacement has been through, undone."""
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
    """Outputs from what acts, packed, the tremor, and the tones, packed."""
    acts = Command.unpack(command)
    return Out(
        volts=acts.volts,
        tremor=tremor,
        frequency=wflc_flc.Out.unpack(tone).frequency,
        engagement=acts.engagement,
        saturated=acts.saturated,
        singular=acts.singular,
    )


@cache
def choosing() -> ca.Function:
    """(filter, u, tone's tremor, forecast) -> y_W, (3,) [m]: the tremor of the filter chosen."""
    choice, inputs = ca.SX.sym("choice"), ca.SX.sym("u", In.size())
    tone, forecasted = ca.SX.sym("tone", 3), ca.SX.sym("forecast", 3)
    u = In.unpack(inputs)
    choices = {
        TONES: tone,
        INERTIAL: rotations.matrix(u.attitude) @ forecasted,
        EXTERNAL: u.external_tremor,
    }
    tremor = forecasted
    for number, found in choices.items():
        tremor = ca.if_else(choice == number, found, tremor)
    return ca.Function("choose_tremor", [choice, inputs, tone, forecasted], [tremor])


def chosen_tremor(p: Params, u: In, tone: Any, forecasted: Any) -> Any:
    """y_W, (3,) [m], from both filters' outputs, that of the first packed."""
    return choosing()(p.tremor_filter, u.pack(), wflc_flc.Out.unpack(tone).tremor, forecasted)


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """One sample."""
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


def answer(p: Params, u: In, x: X, T: float, derived: Precomputed) -> Out:
    """Outputs of a sample alone."""
    ahead = p.filter.replace(horizon=delay(p)).pack()
    find = last_output(tones(T), 1, 2)
    tone = find(ahead, u.tip_displacement, u.valid, x.filter.pack())
    motion = inertial.motion(x.front, inertial.since(u.force, u.valid, x.front))
    position = ca.if_else(p.tremor_filter == INERTIAL, motion, u.tip_displacement)
    forecasted = var_forecaster.answer(derived.band, position, u.valid, x.forecaster, T).tremor
    tremor = chosen_tremor(p, u, tone, forecasted)
    drives = last_output(acting(T), 2, 3)
    command = drives(p.pack(), operators_of(derived), u.pack(), tremor, x.driving.pack())
    return put_out(command, tremor, tone)


def operators_of(derived: Precomputed) -> Any:
    """What follows from the parameters less the forecaster's band-pass, packed; it comes first."""
    return derived.pack()[: Operators.size()]


MODEL = Model(
    "TremorCanceller",
    step,
    Params,
    In,
    X,
    Out,
    sample_period=SAMPLE_PERIOD,
    derived=Precomputed,
    derive=derive,
    matrix=True,
    answer=answer,
)
