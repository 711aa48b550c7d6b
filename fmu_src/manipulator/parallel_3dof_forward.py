"""Forward kinematics of the three-legged parallel manipulator (A04 6.4).

    L_i(e_x, e_y, z_c) = L_0 + k lambda_i,   i = 1, 2, 3
    d = P(e_x, e_y, z_c) - P(0, 0, z_0)
    J = d(d) / d(lambda) = k dP/d(e_x, e_y, z_c) [dL/d(e_x, e_y, z_c)]^-1

The first three equations are solved by Newton's method, for the tilt and the height with which
`parallel_3dof` writes the legs' lengths L_i and the tip P. A04 (6.52 to 6.54) has the angles of the
legs as unknowns instead; the platform found is the same. J is exact at that platform.

The mechanism is that of `parallel_3dof`, with the same parameters; `longest_stroke` changes nothing
here, any stroke in the range of the input is answered. Where no platform fits on legs so unequal
(differences of more than its radius, or less if the legs lean), the answer is finite and has no
meaning.

| symbol | field | meaning |
| --- | --- | --- |
| lambda_i | strokes | strokes of the stacks |
| d | displacement | tip less tip at zero stroke, in frame 0 |
| J | jacobian | displacement of the tip along x, y, z (rows) by stroke of each stack |
| e_x, e_y, z_c | | tilt and height of the platform, z_0 that of zero stroke |
| L_0, k | leg_length, lever_gain | legs at zero stroke, their extension by stroke |
"""

from typing import Any

import casadi as ca

from fmu_src.kit import Outputs, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, real, vector
from fmu_src.manipulator import parallel_3dof
from fmu_src.manipulator.parallel_3dof import Geometry


class In(Inputs):
    """Strokes of the stacks."""

    strokes = real("m", "lambda, strokes of the stacks", shape=3, min=-20e-6, max=1e-4)


class Out(Outputs):
    """Place of the tip."""

    displacement = vector("m", "d, tip less tip at zero stroke, in frame 0")
    jacobian = real(None, "J, displacement of the tip by stroke, row axis", shape=(3, 3))


class Resting(State):
    """Kinematics has no memory."""


def jacobian(p: Geometry, settled: Any) -> ca.SX:
    """Return J, displacement of the tip by stroke, rows axes of frame 0, columns stacks, (3, 3).

    Args:
        p: dimensions.
        settled: e_x, e_y, z_c as from `parallel_3dof.settle`, (3,).
    """
    unknown = ca.SX.sym("unknown", 3)
    dimensions = ca.SX.sym("dimensions", p.size())
    lengths, tip = parallel_3dof.pose(Geometry.unpack(dimensions), unknown[:2], unknown[2])
    by_length = ca.solve(ca.jacobian(lengths, unknown).T, ca.jacobian(tip, unknown).T).T
    return p.lever_gain * ca.Function("j", [unknown, dimensions], [by_length])(settled, p.pack())


def step(p: Geometry, u: In, x: Resting, T: float) -> tuple[Resting, Out]:
    """Compute one sample."""
    settled = parallel_3dof.settle(p, u.strokes)
    return x, Out(
        displacement=parallel_3dof.tip_displacement(p, settled), jacobian=jacobian(p, settled)
    )


MODEL = Model.of_step("Parallel3DofForward", step, sample_period=1e-3)
