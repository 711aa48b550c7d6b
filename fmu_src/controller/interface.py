"""Records of the tremor canceller: parameters, state, ports, and its choices."""

from typing import Any

from fmu_src.estimation.micron import model as micron
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.records import Derived, boolean, integer, real, vector
from fmu_src.manipulator import parallel_3dof
from fmu_src.piezo import modulated_stops as stops
from fmu_src.piezo import prandtl_ishlinskii as plays
from fmu_src.piezo import rate_dependent
from fmu_src.piezo.inverse_prandtl_ishlinskii import Range
from fmu_src.tremor import inertial, var_forecaster, wflc_flc

SAMPLE_PERIOD = 1e-3
STACK_DELAY = 0.3e-3
"""Lag of a stack behind the stroke asked for, where the operator does not hold it [s]: measured,
0.1 ms at 3 um and 0.6 ms at 0.35 um."""
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
        "V", "voltages of the stacks before the first sample", shape=3, within=200.0
    )
    rise_time = real("s", "from there to rest", start=0.5, min=0.01, max=60.0)
    fade_time = real("s", "correction from none to full and back", start=0.5, min=0.01, max=60.0)


class Memory(State):
    """Memories of the stacks, one for each operator that may be chosen."""

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
    """Operators, the forecaster's band-pass, and constants of the accelerometers."""

    band: Any = var_forecaster.Weights
    front: Any = inertial.Front


class In(inertial.In):
    """Outputs of the estimator, and commands from outside."""

    tip_displacement = vector("m", "estimated displacement of the tip, frame W", within=1.0)
    external_tremor = vector("m", "tremor found by another filter, frame W", within=1.0)
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
    tremor = vector("m", "y_W, tremor of the tip, frame W")
    frequency = vector("Hz", "its frequency along each axis")
    engagement = real(None, "share of the correction that acts, 0 to 1")
    saturated = boolean("whether the tip or a voltage had to be limited")
    singular = boolean("whether a stack is to move faster than its operator can be inverted")


class Command(Outputs):
    """Outputs of the drive, without those of the filter."""

    volts = real("V", "v", shape=3)
    engagement = real(None, "share of the correction that acts")
    saturated = boolean("whether the tip or a voltage had to be limited")
    singular = boolean("whether a stack is to move too fast")
