"""Fixed shelving filter: what lies about the tremor's frequency is cut, nothing is learnt.

    S   = 1 - K B^2                                  the tip behind the filter
    B   = (c t_0 / q) / (c^2 + c t_0 / q + t_0^2)    c = (1 - z^-1) / (1 + z^-1), bilinear
    y   = K' B^2 s                                   the tremor: position less shelved position
    t_m = tan(pi f_m T)
    W   = (1 + v) (1 + v + v^2),  v = -i f_w / f_m   wash-out undone
    phi = (2 pi f_m h + arg W) / 2                   lead of a section at f_m, up to LARGEST_LEAD
    t_0 = t_m (r + sqrt(1 + r^2)),  r = tan(phi) / (2 q)
    K'  = K |W| / cos(phi)^2

Instruments with a fixed filter shelve: slow motion passes whole, what is faster is scaled down, and
eye and hand keep working together; so do R. A. MacLachlan and others, *Micron: An Actively
Stabilized Handheld Tool for Microsurgery* (2012). What cancels the tremor is then a high-pass,
which leads at the tremor's frequency while it must not. Here the cut ends above the tremor, too:
two equal second-order sections, whose phase passes through nought at f_m. It is a baseline, and the
answer to what adaptation is worth.

The phase of a section is known and falls with the frequency, so a lead at f_m is had by placing t_0
above it: exact for a tone of f_m, up to LARGEST_LEAD, which is a horizon of 34 ms. A fixed filter
cannot look ahead at other frequencies, too: tones of 8 and 12 Hz come out at 0.7 of their size and
with 30 degrees of error either way, 40 with a horizon. The shift widens the cut above the tremor,
and less of intent passes: a horizon costs reduction in the band, and hardly any a-posteriori.

The gain is the trade-off. Of a hand's tremor a part is beyond a fixed filter's phase, so that K is
below one; with a gain of 1 a tone of f_m leaves nothing, and intent is disturbed more.

While the position is not valid, motion stands still and the output dies away; afterwards positions
count from where it stood, so that no step is seen.

K, f_m, q and the order were found by search on ten recordings of hand motion, position known, for
the mean over a horizon of 0 and 4 ms of both reductions that the tests name and for the worst
recording, with the intent of 1 mm at 1 Hz disturbed by 2 % at most. A shelf proper, a Butterworth
high-pass of first to fourth order in place of B^2, reaches 16 % a-posteriori at best, less than
half.

| symbol | field or constant | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| K | gain | share of a tone of f_m that is put out |
| f_m | CENTRE | frequency at which size and phase are exact |
| q | QUALITY | of a section: its centre over its width |
| f_w | wash_out | wash-out that the position has been through, undone at f_m |
| h | horizon | how far ahead the tremor is wanted |
| y | tremor | tremor at the time t + h |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import elliptic, phasors
from fmu_src.tremor.ports import CountedMotion, In, Out, Surroundings

CENTRE = 9.7
"""f_m [Hz]; tuned."""
QUALITY = 0.62
"""q; tuned."""
SECTIONS = 2
"""Tuned: of one, two and three the best on the recordings."""
LARGEST_LEAD = np.pi / 3
"""phi at most [rad]: above the tremor the gain reaches 3 there, and would grow on."""


class Params(Surroundings):
    """Gain, horizon, and what has been done to the position before."""

    gain = real(None, "K, share of a tone of f_m that is put out", start=0.73, min=0.0, max=1.0)


class Cut(Derived):
    """One section, B = b (1 - z^-2) / (1 + a_1 z^-1 + a_2 z^-2), and what follows them."""

    b = real(None, "b, numerator of a section")
    a = real(None, "a_1 and a_2, denominator of a section", shape=2)
    behind = real(None, "K', gain behind the sections")


class X(CountedMotion):
    """Memory of the sections."""

    motion = real("m", "position less origin, held while there is none to trust", shape=3)
    memory = real("m", "delayed sums of the sections", shape=(2 * SECTIONS, 3))


def derive(p: Params, T: float) -> Cut:
    """Compute place and gain of the sections."""
    whole = phasors.wash_out_undone(p.wash_out, CENTRE)
    wanted = (2 * np.pi * CENTRE * p.horizon + ca.atan2(whole[1], whole[0])) / SECTIONS
    lead = ca.fmin(wanted, LARGEST_LEAD)
    r = ca.tan(lead) / (2 * QUALITY)
    centre = np.tan(np.pi * CENTRE * T) * (r + ca.sqrt(1 + r**2))
    width = centre / QUALITY
    scale = 1 + width + centre**2
    return Cut(
        b=width / scale,
        a=ca.vertcat(2 * (centre**2 - 1), 1 - width + centre**2) / scale,
        behind=p.gain * ca.sqrt(whole[0] ** 2 + whole[1] ** 2) / ca.cos(lead) ** SECTIONS,
    )


def step(p: Params, u: In, x: X, T: float, derived: Cut) -> tuple[X, Out]:
    """Compute one sample."""
    motion, origin = phasors.count(u.position, u.valid, x.motion, x)
    section: Any = (derived.b, 0.0, -derived.b, derived.a[0], derived.a[1])
    memory, cut = elliptic.cascade(motion, x.memory, [section] * SECTIONS)
    following = X(tracked=u.valid, origin=origin, motion=motion, memory=memory)
    return following, Out(tremor=derived.behind * cut)


MODEL = Model.of_step("Shelving", step, sample_period=1e-3, derive=derive)
