"""Attitude from an electromagnetic tracker and an inertial unit, by an extended filter (RK III).

    q'  = q (x) exp((w_m - b) T / 2)                               gyro, every sample (RK 2, 3)
    f_m = R^T g + b_a + v_f                                        gravity (RK 4)
    0   = atan2(e_y, e_x) + v_h,  e = R m                          heading by the magnetometer
    q_m = exp(d / 2) (x) r* (x) q_then (x) h (x) exp(v_e / 2)      tracker (RK III.B, 5)

| symbol | meaning |
| --- | --- |
| q, R | attitude q_WB and its matrix |
| b, b_a | bias of the gyro [rad/s] and of the accelerometer [m/s2], B |
| h | hand-eye rotation, from B to the coil frame C: RK's R_coil^imu |
| r | registration, from W to the tracker's frame F: RK's R_fg^nav |
| d | distortion of the tracker's attitude by metal, a rotation vector in F [rad] |
| g | gravity, (0, 0, g) in W |
| w_m, f_m, m | rate, specific force, field, as the unit gives them |
| q_m, q_then | attitude of C in F; attitude of B when it was measured, by the turns since |
| v_f, v_h, v_e | noise |
| t_g | lag of the inertial unit behind the tracker's clock [s], from which q is carried on |

RK's seven states are q and b. The filter in error-state form has three numbers for each of q, b,
b_a, d, h and r; one whose `_sigma` is zero is known and stays, so that with all but the first two
zero the states are RK's.

Switching. RK take gravity and magnetometer while the acceleration is below a threshold and the
field is undisturbed, else the tracker; both thresholds are hard, and the filter overshoots by 1.2
deg where the motion starts or stops. `hard_switching` does so. Otherwise the tracker is always
taken, but its distortion is a state: a first-order Gauss-Markov process that changes with the
angle turned through and with time, so what metal nearby adds is neither noise to be averaged away
nor believed. Gravity counts the less the more the specific force in W departs from its slow mean:
that shows horizontal acceleration as well as vertical, which the length of f alone does not.

Forces and fields are averaged in the turning body over `interval` before they correct: acceleration
of a hand and what disturbs the heading are no noise of a millisecond. Their densities are those of
slow disturbances.

A magnet on the instrument now and then gives the field's strength and dip by chance while the
instrument turns. So a field that showed iron counts again only after it has been right for a while:
`DOUBT` times as long as it was wrong, at most `hold`. Iron for a moment costs next to nothing then.
Hard switching goes by the moment alone, as RK's.

The jitter of the tracker grows with its distance from the field generator as s (1 + (x / x_0)^4).

Where all that the tracker says is beyond the gate for long, but its vertical is that of the
specific force, the filter has gone astray, and starts anew from the tracker.

The filter starts from the first attitude of the tracker, whatever it is; without one for `wait`,
from gravity and field. Heading then is as sure as the field is undisturbed.
"""

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.em_ekf.gravity import correct_by_gravity
from fmu_src.estimation.em_ekf.interface import Acceleration, Gathered, In, Out, Params, X
from fmu_src.estimation.em_ekf.north import correct_by_field
from fmu_src.estimation.em_ekf.prediction import collect, predict
from fmu_src.estimation.em_ekf.state import SPACE, Nominal, now
from fmu_src.estimation.em_ekf.tracker import correct_by_tracker
from fmu_src.filters.error_state import LEAST_VARIANCE
from fmu_src.kit.model import Model
from fmu_src.math import rotations


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Return state and outputs one sample later."""
    d = collect(p, u, x, T)
    nominal, P, carried = predict(p, x, d)
    gravity = correct_by_gravity(p, x, d, nominal, P)
    north = correct_by_field(p, x, d, gravity)
    coils = correct_by_tracker(p, u, x, T, d, gravity, north)
    P = coils.P

    # What is gathered begins anew where it was used.
    g, emptied = d.g, ca.logic_or(carried, d.first)
    used = ca.logic_or(ca.logic_or(d.aided, d.first), d.due)
    g = Gathered(
        turn=ca.if_else(emptied, ca.DM([1, 0, 0, 0]), g.turn),
        angle=ca.if_else(emptied, 0, g.angle),
        variance=ca.if_else(emptied, 0, g.variance),
        time=ca.if_else(emptied, 0, g.time),
        waited=ca.if_else(used, 0, g.waited),
        sums=ca.if_else(used, 0, g.sums),
        count=ca.if_else(used, 0, g.count),
    )
    state = Nominal.unpack(coils.nominal)
    rate = d.sample.sensed[:3] - state.rate_bias
    (attitude,) = sources.recorded("now", now, state.attitude, g.turn, rate * p.tracker.lag)
    variances = ca.fmax(ca.diag(P), 0) + LEAST_VARIANCE
    sigma = {name: ca.sqrt(variances[place]) for name, place in SPACE.places.items()}
    attitude_sigma = ca.sqrt(variances[SPACE.places["attitude"]] + g.variance)
    well_known = ca.mmax(attitude_sigma) < p.attitude_limit
    aided_by_coils = 1 - d.by_tracker
    nis = gravity.nis + north.nis + aided_by_coils * coils.nis
    return (
        X(
            nominal=state,
            P=P,
            started=d.started,
            age=ca.fmin(x.age + T, 1e6),
            gathered=g,
            acceleration=Acceleration.unpack(gravity.acceleration),
            unit=d.sample.unit,
            tracked=d.came.tracked.replace(doubted=coils.doubted),
            disturbed=north.disturbed,
            doubt=north.doubt,
        ),
        Out(
            attitude=attitude,
            body_rate=rate,
            rate_bias=state.rate_bias,
            distortion=state.distortion,
            mounting=rotations.canonical(state.mounting),
            registration=rotations.canonical(state.registration),
            valid=ca.logic_and(d.started, well_known),
            inertial_lost=d.sample.lost,
            em_lost=d.came.tracked.quiet > p.tracker.patience,
            accelerated=gravity.accelerated,
            magnetic_disturbance=ca.logic_and(p.magnetic.used, north.disturbed),
            attitude_sigma=attitude_sigma,
            rate_bias_sigma=sigma["rate_bias"],
            distortion_sigma=sigma["distortion"],
            mounting_sigma=sigma["mounting"],
            registration_sigma=sigma["registration"],
            innovation_squared=ca.fmax(nis, 0),
            innovation_size=3 * gravity.by + north.by + 3 * coils.by * aided_by_coils,
        ),
    )


MODEL = Model.of_step("EmInertialEkf", step, sample_period=1e-3, matrix=True)
