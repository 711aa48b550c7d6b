"""Optical tracker: markers on a rigid body as stereo cameras see them, and the pose fitted to them.

    m_i  = p + R r_i + n_i,  n_i = s_l (I - d d^T) z_i + s_d d d^T z_i          marker i, W
    c    = mean r_i,  J = sum (|e_i|^2 I - e_i e_i^T),  e_i = r_i - c           visible markers, B
    t    = J^-1 sum e_i x R^T n_i                                               attitude error, B
    q_m  = q (x) exp(t / 2),  p_m = p + mean n_i - R (t x c)                    pose

| symbol | field | meaning |
| --- | --- | --- |
| p, q, R | body, attitude | origin of B in W [m], attitude q_WB and its matrix |
| r_i | markers | place of marker i in B [m] |
| n_i | | error of marker i [m], W |
| d | camera | unit vector from the camera to the origin of B |
| s_l, s_d | noise_across, noise_along | rms of the noise of a marker [m] |
| z_i | | standard normal draws |

The pose is the least-squares fit of the known layout to the visible markers, to first order in n:
errors are a thousandth of the layout, so the second order is below a micrometre. It exists for
three or more visible markers. With one or two, only these arrive.

All of it is given in the tracker's frame, whose axes are turned by `registration` from W and whose
origin is `origin`: the same as W unless they are set. Layout in B as it is known to the tracker: an
error of mounting is a change of `markers` alone.

Markers are hidden together (`occluded`, and at random) or one by one (`hidden_i`, and at random);
what counts is the instant of exposure. A packet arrives after the latency, with its age by the
tracker's clock, which may be wrong by `clock_error`. Between packets the outputs are held.

Sources. Noise: passive markers of the Polaris kind, as chosen here 0.05 mm across and 0.15 mm along
the line of sight; rate 60 Hz and latency as usual for them (C23 3.1.2: 16 ms; E13: 20 to 60 Hz).
C23 3.1.1: four passive spheres a body.
"""

from typing import Any

import casadi as ca

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, integer, quaternion, real, vector
from fmu_src.math import rotations
from plants import sampling

MARKERS = len(design.MARKERS)
FEWEST = 3
"""Markers that a pose takes."""
_POSE = 7
_PACKET = _POSE + 4 * MARKERS + 1


class Params(Parameters):
    """Layout, accuracy, timing and failures."""

    seed = integer("seed of noise and failures", start=1, min=0, max=2**31 - 1)
    rate = real("Hz", "exposures in a second", start=60.0, min=1.0, max=1000.0)
    latency = real("s", "from exposure to arrival", start=0.016, min=0.0, max=0.12)
    latency_jitter = sampling.LATENCY_JITTER
    clock_error = sampling.CLOCK_ERROR
    markers = real(
        "m", "places r_i in B, one a row", shape=(MARKERS, 3), start=design.MARKERS, within=1.0
    )
    noise_across = real(
        "m", "noise s_l of a marker across the line of sight", start=5e-5, min=0.0, max=0.01
    )
    noise_along = real(
        "m", "noise s_d of a marker along the line of sight", start=1.5e-4, min=0.0, max=0.01
    )
    camera = real("m", "place of the camera in W", shape=3, start=(-1.0, -0.6, 1.0), within=20.0)
    registration = sampling.REGISTRATION
    origin = sampling.ORIGIN
    occlusion_rate = real("Hz", "random occlusions in a second", start=0.0, min=0.0, max=50.0)
    occlusion_time = real("s", "mean length of one", start=0.3, min=1e-3, max=100.0)
    dropout_rate = real("Hz", "random losses of a marker in a second", start=0.0, min=0.0, max=50.0)
    dropout_time = real("s", "mean length of one", start=0.2, min=1e-3, max=100.0)


class In(Inputs):
    """True pose, and what is hidden on demand."""

    body = sampling.BODY
    attitude = sampling.ATTITUDE
    occluded = boolean("whether something stands in the line of sight")
    hidden_1 = boolean("whether marker 1 is hidden")
    hidden_2 = boolean("whether marker 2 is hidden")
    hidden_3 = boolean("whether marker 3 is hidden")
    hidden_4 = boolean("whether marker 4 is hidden")


class Precomputed(Derived):
    """Standard normal draws above which failures begin and end."""

    occlusion_begins = real(None, "of an occlusion")
    occlusion_ends = real(None, "of an occlusion")
    dropout_begins = real(None, "of the loss of a marker")
    dropout_ends = real(None, "of the loss of a marker")


class X(State):
    """Clock, failures, packets under way, and the last one."""

    phase = real(None, "exposures that are due", start=1.0)
    occlusion = boolean("whether a random occlusion holds")
    dropouts = real(None, "1 for each marker that is lost at random", shape=MARKERS)
    line: Any = sampling.queue(_PACKET)
    held = real(None, "last packet", shape=_PACKET, listed=False, start=(1, *[0] * (_PACKET - 1)))
    age = real("s", "its stated age")


class Out(Outputs):
    """Pose and markers of the last packet."""

    optical_position = vector("m", "origin of B in the tracker's frame")
    optical_attitude = quaternion("attitude of B in the tracker's frame")
    optical_new = boolean("a pose arrives at this instant")
    optical_age = real("s", "its age on arrival, by the tracker's clock", min=0.0)
    optical_markers_new = boolean("markers arrive at this instant")
    optical_marker1 = vector("m", "marker 1 in the tracker's frame")
    optical_marker2 = vector("m", "marker 2 in the tracker's frame")
    optical_marker3 = vector("m", "marker 3 in the tracker's frame")
    optical_marker4 = vector("m", "marker 4 in the tracker's frame")
    optical_visible1 = boolean("whether marker 1 is in the last packet")
    optical_visible2 = boolean("whether marker 2 is in the last packet")
    optical_visible3 = boolean("whether marker 3 is in the last packet")
    optical_visible4 = boolean("whether marker 4 is in the last packet")


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    return Precomputed(
        occlusion_begins=sampling.chance(p.occlusion_rate, T),
        occlusion_ends=sampling.chance(1 / p.occlusion_time, T),
        dropout_begins=sampling.chance(p.dropout_rate, T),
        dropout_ends=sampling.chance(1 / p.dropout_time, T),
    )


def fitted(layout: Any, seen: Any, errors: Any) -> tuple[Any, Any, Any]:
    """Compute errors of the pose fitted to the visible markers, to first order in theirs.

    Args:
        layout: places in B, (MARKERS, 3) [m].
        seen: 1 for each visible marker, (MARKERS,).
        errors: of the markers, in B, (MARKERS, 3) [m].

    Returns:
        Rotation vector in B, (3,) [rad]; displacement in B, (3,) [m]; whether there is a pose: the
        visible markers span a plane.
    """
    count = ca.fmax(ca.sum1(seen), 1)
    centre = (seen.T @ layout / count).T
    inertia, moment = ca.SX.zeros(3, 3), ca.SX.zeros(3)
    for i in range(MARKERS):
        arm = layout[i, :].T - centre
        inertia += seen[i] * (ca.sumsqr(arm) * ca.SX.eye(3) - arm @ arm.T)
        moment += seen[i] * ca.cross(arm, errors[i, :].T)
    # Markers on one line, or fewer than three, leave a rotation free.
    size = ca.trace(inertia) / 3
    plane = ca.det(inertia) > 1e-6 * size**3
    good = ca.logic_and(ca.sum1(seen) >= FEWEST, ca.logic_and(plane, size > 1e-12))
    safe = ca.if_else(good, inertia, ca.SX.eye(3))
    turn = ca.if_else(good, ca.inv_minor(safe) @ moment, 0)
    return turn, (seen.T @ errors / count).T - ca.cross(turn, centre), good


def step(p: Params, u: In, x: X, T: float, derived: Precomputed, normal: Any) -> tuple[X, Out]:
    """Compute one sample."""
    exposed, phase = sampling.exposed(x.phase, p.rate, T)
    hidden = ca.vertcat(u.hidden_1, u.hidden_2, u.hidden_3, u.hidden_4)
    blind = ca.logic_or(u.occluded, x.occlusion)
    seen = ca.if_else(blind, 0, (1 - hidden) * (1 - x.dropouts))

    q = sampling.unit_quaternion(u.attitude)
    R = rotations.matrix(q)
    sight = u.body - p.camera
    sight = sight / ca.sqrt(ca.sumsqr(sight) + 1e-6)
    draws = ca.reshape(normal[: 3 * MARKERS], 3, MARKERS)
    along = sight @ (sight.T @ draws)
    errors = p.noise_across * (draws - along) + p.noise_along * along
    turn, shift, good = fitted(p.markers, seen, (R.T @ errors).T)

    F = rotations.matrix(rotations.from_rotation_vector(p.registration)).T
    to_frame = rotations.from_rotation_vector(-p.registration)
    position = F @ (u.body + R @ shift - p.origin)
    attitude = rotations.multiply(
        rotations.multiply(to_frame, q), rotations.from_rotation_vector(turn)
    )
    markers = F @ (ca.repmat(u.body - p.origin, 1, MARKERS) + R @ p.markers.T + errors)
    packet = ca.vertcat(rotations.canonical(attitude), position, good, seen, ca.vec(markers))
    latency = ca.fmax(p.latency + p.latency_jitter * normal[3 * MARKERS], 0)
    line, arrived, packet, age = sampling.passed(
        x.line, ca.logic_and(exposed, ca.sum1(seen) > 0), packet, latency, T
    )

    # A packet without a pose leaves the last pose standing, and a hidden marker its last place.
    pose = ca.logic_and(arrived, packet[_POSE])
    seen_now = packet[_POSE + 1 : _POSE + 1 + MARKERS]
    first = _POSE + 1 + MARKERS
    old = x.held[first:]
    held_markers = [
        ca.if_else(
            ca.logic_and(arrived, seen_now[i]),
            packet[first + 3 * i : first + 3 * i + 3],
            old[3 * i : 3 * i + 3],
        )
        for i in range(MARKERS)
    ]
    visible = ca.if_else(arrived, seen_now, x.held[_POSE + 1 : first])
    held = ca.vertcat(
        ca.if_else(pose, packet[:_POSE], x.held[:_POSE]), pose, visible, *held_markers
    )
    stated = ca.if_else(arrived, ca.fmax(age - p.clock_error, 0), x.age)

    draw = normal[3 * MARKERS + 1 :]
    following = X(
        phase=phase,
        occlusion=sampling.switched(
            x.occlusion, draw[0], derived.occlusion_begins, derived.occlusion_ends
        ),
        dropouts=sampling.switched(
            x.dropouts, draw[1:], derived.dropout_begins, derived.dropout_ends
        ),
        line=line,
        held=held,
        age=stated,
    )
    return following, Out(
        optical_position=held[4:7],
        optical_attitude=held[:4],
        optical_new=pose,
        optical_age=stated,
        optical_markers_new=arrived,
        **{f"optical_marker{i + 1}": held_markers[i] for i in range(MARKERS)},
        **{f"optical_visible{i + 1}": visible[i] for i in range(MARKERS)},
    )


MODEL = Model.of_step(
    "OpticalTracker", step, sample_period=1e-3, draws=3 * MARKERS + 2 + MARKERS, derive=derive
)
