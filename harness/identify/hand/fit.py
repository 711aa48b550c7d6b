"""Parameters of the generated hand from a recording of a real one.

    S(f)   = rms_i^2 G(f; f_i) + rms_c^2 G(f; f_p) + rms_t^2 K(f)
    G(f; c) = 1 / (pi v c) (1 + (f / c)^2)^-4                      a shaping filter, one-sided
    K(f)   = mean of (G(f - f_c; b) + G(f + f_c; b)) / 2 over the carrier f_c
    l      = sum over bands of log S + P / S                       minimised
    lambda = 3 s^2 int h^4 / (kappa (int h^2)^2)                   Campbell's theorem

| symbol | meaning |
| --- | --- |
| P | periodogram averaged over a band, a sixth of an octave [m2/Hz] |
| rms_i, rms_c, rms_t | intent, corrections, tremor, for each axis [m] |
| f_i, f_p, b | their corners, common to the axes [Hz] |
| f_c | carrier (f_1 + f_2) / 2 + (f_2 - f_1) / 2 tanh g with standard normal g [Hz] |
| v | variance of the filter over pole times noise density, 5 / 32 |
| lambda | rate of the corrections [Hz] |
| kappa | excess kurtosis of the motion in their band, mean over the axes |
| s, h | share of corrections in that band's variance, its pulse behind the band-pass |

Whittle's likelihood with one vote for each band, not for each line: no hand is exactly like the
model, and most lines lie where nothing moves. Half a minute cannot tell drift from slow intent,
so drift is not fitted and counts as intent. The rate of corrections rests on the fourth moment of
a short record: read it as an order of magnitude. A tremor narrower than a band (1 Hz at the
carrier) is found as half a band wide.
"""

from collections.abc import Mapping

import numpy as np
from scipy import optimize, signal, stats

from fmu_src.errors import SteadytipError
from plants.hand import MODEL, ORDER, UNIT_VARIANCE

BAND = (0.1, 15.0)
"""Frequencies that are fitted [Hz]."""
BANDS_PER_OCTAVE = 6
CORRECTION_BAND = (1.5, 5.0)
"""Band in which neither slow intent nor tremor hides the corrections [Hz]."""
SHORTEST = 10.0
"""Shortest recording that shows intent [s]."""
CARRIERS = 201
"""Number of quantiles that represent the distribution of the carrier."""
LOWER_EDGES = (BAND[0], CORRECTION_BAND[0], CORRECTION_BAND[1])
"""Lower edges of intent, corrections and tremor, for a first guess [Hz]."""
REACH = 7.0
"""Largest distance of a variance from that guess, in its natural logarithm."""
BOUNDS = {
    "intent_corner": (0.2, 1.0),
    "correction_corner": (1.0, 3.0),
    "tremor_bandwidth": (0.05, 5.0),
}
"""Ranges of the corners [Hz]."""


def identify_hand(position: np.ndarray, rate: float) -> dict[str, float | list[float]]:
    """Fit the generator of `plants.hand` to a recorded tip motion.

    Args:
        position: tip in W, raw, shape (samples, 3) [m].
        rate: samples in a second [Hz], at least twice the highest frequency of the fit.

    Returns:
        Values for parameters of Hand by name: `intent_rms`, `correction_rms`, `tremor_rms` (three
        each) [m], `intent_corner`, `correction_corner`, `correction_rate`, `tremor_bandwidth` [Hz].

    Raises:
        SteadytipError: another shape, values that are not finite, too short, too slow, or an axis
            that does not move.
    """
    position = np.asarray(position, dtype=float)
    _check(position, rate)
    declared = {scalar.name: scalar.start for scalar in MODEL.parameters.scalars()}
    carriers = _carriers(declared["tremor_frequency[1]"], declared["tremor_frequency[2]"])
    frequencies, power = banded_periodogram(position, rate)

    def shapes(corners: Mapping[str, float]) -> np.ndarray:
        sides = frequencies[:, None, None] - np.stack([carriers, -carriers])
        line = filter_density(sides, corners["tremor_bandwidth"]).sum(axis=1) / 2
        return np.stack(
            [
                filter_density(frequencies, corners["intent_corner"]),
                filter_density(frequencies, corners["correction_corner"]),
                line.mean(axis=1),
            ]
        )

    # Logarithms of corners and variances; these start from the power in and above their bands.
    widths = np.gradient(frequencies)[:, None]
    variance = [(power * widths)[frequencies > low].sum(axis=0) for low in LOWER_EDGES]
    start = np.log([*(np.sqrt(low * high) for low, high in BOUNDS.values()), *np.ravel(variance)])
    limits = [tuple(np.log(pair)) for pair in BOUNDS.values()]
    limits += [(v - REACH, v + REACH) for v in start[len(BOUNDS) :]]

    def misfit(z: np.ndarray) -> float:
        corners, variances = _unpack(z)
        model = shapes(corners).T @ variances
        return float((np.log(model) + power / model).sum())

    best = optimize.minimize(misfit, start, method="L-BFGS-B", bounds=limits)
    corners, variances = _unpack(best.x)
    rms = np.sqrt(variances)
    return {
        "intent_rms": rms[0].tolist(),
        "correction_rms": rms[1].tolist(),
        "tremor_rms": rms[2].tolist(),
        **corners,
        "correction_rate": correction_rate(
            position, rate, corners["correction_corner"], variances[1]
        ),
    }


def filter_density(frequency: np.ndarray, corner: float) -> np.ndarray:
    """Return G, the one-sided spectral density of a shaping filter of unit variance [1/Hz]."""
    return (1 + (frequency / corner) ** 2) ** -float(ORDER) / (np.pi * UNIT_VARIANCE * corner)


def banded_periodogram(position: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute a Hann-tapered periodogram, averaged over bands that are even in the logarithm.

    Args:
        position: shape (samples, axes) [m].
        rate: samples in a second [Hz].

    Returns:
        Mean frequency of each band, shape (bands,) [Hz]; density, (bands, axes) [m2/Hz].
    """
    frequencies, power = signal.periodogram(
        position, rate, window="hann", detrend="constant", axis=0
    )
    fitted = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    frequencies, power = frequencies[fitted], power[fitted]
    band = np.floor(np.log2(frequencies) * BANDS_PER_OCTAVE)
    first = np.flatnonzero(np.diff(band, prepend=np.nan) != 0)
    lines = np.diff(first, append=len(band))
    return (
        np.add.reduceat(frequencies, first) / lines,
        np.add.reduceat(power, first, axis=0) / lines[:, None],
    )


def correction_rate(
    position: np.ndarray, rate: float, correction_corner: float, variance: np.ndarray
) -> float:
    """Estimate the rate of the corrections by the kurtosis of the motion's band [Hz].

    Args:
        position: shape (samples, 3) [m].
        rate: samples in a second [Hz].
        correction_corner: pole of the pulses [Hz].
        variance: variance of the corrections in each axis, (3,) [m2].
    """
    sections = signal.butter(ORDER, CORRECTION_BAND, "bandpass", fs=rate, output="sos")
    seen = signal.sosfiltfilt(sections, position - position.mean(axis=0), axis=0)

    t = 2 * np.pi * correction_corner * np.arange(round(SHORTEST * rate)) / rate
    response = t ** (ORDER - 1) * np.exp(-t)
    response /= np.sqrt((response**2).sum() / rate)
    behind = signal.sosfiltfilt(sections, np.pad(response, len(response)))
    second, fourth = (behind**2).sum() / rate, (behind**4).sum() / rate

    share = np.minimum(variance * second / seen.var(axis=0), 1.0)
    excess = float(np.mean(stats.kurtosis(seen, axis=0)))
    low, high = _declared_range("correction_rate")
    if excess <= 0:
        return high
    estimate = 3 * np.mean(share**2) * fourth / (excess * second**2)
    return float(np.clip(estimate, low, high))


def _declared_range(name: str) -> tuple[float, float]:
    field = next(s.field for s in MODEL.parameters.scalars() if s.name == name)
    return field.min, field.max


def _carriers(low: float, high: float) -> np.ndarray:
    quantiles = (np.arange(CARRIERS) + 0.5) / CARRIERS
    return (low + high) / 2 + (high - low) / 2 * np.tanh(stats.norm.ppf(quantiles))


def _check(position: np.ndarray, rate: float) -> None:
    if position.ndim != 2 or position.shape[1] != 3:
        raise SteadytipError(
            f"recorded position: shape {position.shape}, needed is (samples, 3), in metres"
        )
    bad = np.argwhere(~np.isfinite(position))
    if len(bad):
        row, axis = bad[0]
        raise SteadytipError(
            f"recorded position: {position[row, axis]} in sample {row}, axis {'xyz'[axis]};"
            " cut the recording there, or interpolate"
        )
    if rate < 2 * BAND[1]:
        raise SteadytipError(
            f"recorded position: {rate:g} samples in a second do not show motion up to"
            f" {BAND[1]:g} Hz; record at {2 * BAND[1]:g} Hz or more"
        )
    if len(position) < SHORTEST * rate:
        raise SteadytipError(
            f"recorded position: {len(position) / rate:.3g} s long, needed are at least"
            f" {SHORTEST:g} s"
        )
    still = np.flatnonzero(np.ptp(position, axis=0) == 0)
    if len(still):
        raise SteadytipError(
            f"recorded position: axis {'xyz'[still[0]]} stays at {position[0, still[0]]:.6g} m;"
            " is its column the right one?"
        )


def _unpack(z: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
    corners = dict(zip(BOUNDS, np.exp(z[: len(BOUNDS)]).tolist(), strict=True))
    return corners, np.exp(z[len(BOUNDS) :]).reshape(3, 3)
