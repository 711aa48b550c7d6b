"""Randomness as an input: a counter-based generator that can be replayed anywhere.

| symbol | meaning |
| --- | --- |
| k | sample number of the model, from 0 |
| K | draws that the model declares for each sample |
| r | raw 64-bit word of Philox4x64-10 (NumPy's `numpy.random.Philox(key=seed)`) |
| U | uniform in (0, 1): (floor(r / 2^11) + 1/2) / 2^53 |
| z | standard normal, z = Phi^-1(U) |

Draw j of sample k is word k K + j of the stream: nothing but the sample number has to be kept, so a
restored state goes on with the same noise. The words come from the runtime (C shell, Python slave);
what happens to them is recorded with the model.
"""

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

WORD_SHIFT = 11
UNIFORM_SCALE = 2.0**-53


def uniforms(seed: int, first_sample: int, samples: int, draws: int) -> np.ndarray:
    """Uniform draws of some consecutive samples, shape (samples, draws), from NumPy's Philox."""
    stream = np.random.Philox(key=seed)
    first_word = first_sample * draws
    stream.advance(first_word // 4)  # Philox makes four words for each count
    words = stream.random_raw(samples * draws + first_word % 4)[first_word % 4 :]
    return (((words >> WORD_SHIFT) + 0.5) * UNIFORM_SCALE).reshape(samples, draws)


def _horner(x: Any, coefficients: np.ndarray) -> Any:
    total = float(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + float(coefficient)
    return total


@cache
def _quantile() -> ca.Function:
    """Quantile of one value. Only one of its three branches is evaluated, and none is inlined."""
    u = ca.SX.sym("u")
    q = u - 0.5
    centre = 0.180625 - q * q
    # A draw next to 1 is rounded to it.
    radius = ca.sqrt(-ca.log(ca.fmax(ca.fmin(u, 1 - u), UNIFORM_SCALE / 2)))
    near = q * _horner(centre, _NEAR[:, 0]) / _horner(centre, _NEAR[:, 1])
    middle = _horner(radius - 1.6, _MIDDLE[:, 0]) / _horner(radius - 1.6, _MIDDLE[:, 1])
    far = _horner(radius - 5.0, _FAR[:, 0]) / _horner(radius - 5.0, _FAR[:, 1])
    values = {"near": near, "middle": ca.sign(q) * middle, "far": ca.sign(q) * far}
    branches = [ca.Function(name, [u], [value]) for name, value in values.items()]
    v = ca.MX.sym("v")
    beyond = (ca.fabs(v - 0.5) > 0.425) + (ca.fmin(v, 1 - v) < np.exp(-25.0))
    chosen = ca.Function.conditional("quantile", branches[:2], branches[2])
    return ca.Function("standard_normal", [v], [chosen(beyond, v)], {"never_inline": True})


def standard_normal(uniform: Any) -> ca.SX:
    """Quantile of the standard normal distribution, element by element.

    Rational approximations of Wichura (1988), Applied Statistics 37, 477-484, algorithm AS 241,
    routine PPND16: relative error about 1e-16.

    Args:
        uniform: values in (0, 1), a scalar or a column.
    """
    uniform = ca.SX(uniform)
    quantiles: Any = ca.vertcat(*(_quantile()(u) for u in ca.vertsplit(uniform)))
    return ca.SX(ca.evalf(quantiles)) if uniform.is_constant() else quantiles


# Coefficients of PPND16, numerator beside denominator, constant term first.
_NEAR = np.array(
    [
        (3.3871328727963666080e0, 1.0),
        (1.3314166789178437745e2, 4.2313330701600911252e1),
        (1.9715909503065514427e3, 6.8718700749205790830e2),
        (1.3731693765509461125e4, 5.3941960214247511077e3),
        (4.5921953931549871457e4, 2.1213794301586595867e4),
        (6.7265770927008700853e4, 3.9307895800092710610e4),
        (3.3430575583588128105e4, 2.8729085735721942674e4),
        (2.5090809287301226727e3, 5.2264952788528545610e3),
    ]
)
_MIDDLE = np.array(
    [
        (1.42343711074968357734e0, 1.0),
        (4.63033784615654529590e0, 2.05319162663775882187e0),
        (5.76949722146069140550e0, 1.67638483018380384940e0),
        (3.64784832476320460504e0, 6.89767334985100004550e-1),
        (1.27045825245236838258e0, 1.48103976427480074590e-1),
        (2.41780725177450611770e-1, 1.51986665636164571966e-2),
        (2.27238449892691845833e-2, 5.47593808499534494600e-4),
        (7.74545014278341407640e-4, 1.05075007164441684324e-9),
    ]
)
_FAR = np.array(
    [
        (6.65790464350110377720e0, 1.0),
        (5.46378491116411436990e0, 5.99832206555887937690e-1),
        (1.78482653991729133580e0, 1.36929880922735805310e-1),
        (2.96560571828504891230e-1, 1.48753612908506148525e-2),
        (2.65321895265761230930e-2, 7.86869131145613259100e-4),
        (1.24266094738807843860e-3, 1.84631831751005468180e-5),
        (2.71155556874348757815e-5, 1.42151175831644588870e-7),
        (2.01033439929228813265e-7, 2.04426310338993978564e-15),
    ]
)
