"""Training of the cascade neural filter by node-decoupled extended Kalman filtering (A04 5.3.2).

    A     = 1 / (R + sum_i psi_i^2 zeta_i.P_i zeta_i)     over the nodes that are trained
    w_i'  = w_i + A psi_i (t - m) P_i zeta_i
    P_i'  = P_i - A psi_i^2 (P_i zeta_i) (P_i zeta_i)^T + Q I

The weights are the state of a Kalman filter; its measurement is the output (Nechyba 1998).
Covariances between nodes are neglected: there is one matrix for the output and one for the new
hidden unit. `ndekf` computes the filter.

A network begins without hidden units, as a linear filter. Units are then added one at a time. A
pool of candidates, some of each activation with random weights, is trained side by side, each with
an output of its own. The candidate with the least error stays, its input weights are frozen, and
the output is trained again. The thesis trains candidates by quickprop and the output by the filter.
Here the filter trains both, as in Nechyba's work, because a pool costs little more than one
candidate.

Training data (A04 5.3.3) are an error, recorded while somebody tried to hold still, on a motion
that is made up, white noise behind a low-pass. Inputs are the raw sum up to now. The target is that
motion, or the error, as Riviere and Khosla do. Every epoch has a new motion. It takes the error at
another level, larger or smaller by up to e^spread, and backwards or mirrored, because a hand that
holds still knows no direction. Without this, a network would learn sixteen seconds by heart. One
epoch without any of it is the method of the thesis.

| symbol | name | meaning |
| --- | --- | --- |
| w_i, P_i | weights, covariance | of node i |
| zeta_i | | inputs of node i: inputs of the network, 1, hidden units |
| psi_i | | slope of the output with the node's net input; 1 for the output |
| R, Q | noise, drift | variance of the measurement, and of the weights from sample to sample |
| t, m | | target and output, over the scale |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from fmu_src.errors import SteadytipError
from fmu_src.tremor.cascade_neural import ACTIVATIONS, HIDDEN, INPUTS, SAMPLE_PERIOD, SPACINGS
from harness.common.types import FloatArray
from harness.identify.options import Progress
from harness.identify.tremor_nn.ndekf import train_output, train_pool

__all__ = ["Architecture", "Network", "Training", "pseudo_motion", "train", "train_filter"]

RATE = 1 / SAMPLE_PERIOD
"""Sample rate of everything here [Hz]."""
CUTOFF = 1.0
"""Corner of the motion that is made up [Hz] (A04 Fig. 5.7)."""
ORDER = 4
"""Order of its Butterworth low-pass; the thesis gives none. Others change reductions by a point."""
LEAD = 10.0
"""Beginning of a motion that is left out, so that the low-pass settles [s]."""
MOST_EPOCHS = 1000
"""More epochs teach nothing new."""
Target = Literal["motion", "error"]
Draw = Callable[[int], tuple[FloatArray, FloatArray]]
"""Inputs, (n, inputs), and targets, (n,), of an epoch."""


@dataclass(frozen=True)
class Architecture:
    """Size of a network.

    Attributes:
        inputs: number of them.
        hidden: most hidden units.
        spacing: samples from one input to the next.

    Raises:
        SteadytipError: one that the model does not take.
    """

    inputs: int = 50
    hidden: int = 6
    spacing: int = SPACINGS

    def __post_init__(self) -> None:
        for name, low, high in (
            ("inputs", 1, INPUTS), ("hidden", 0, HIDDEN), ("spacing", 1, SPACINGS),
        ):  # fmt: skip
            if not low <= (value := getattr(self, name)) <= high:
                raise SteadytipError(
                    f"--{name} {value}: must be in [{low}, {high}], which is what the model holds"
                )

    @property
    def lead(self) -> int:
        """Samples before the window is full."""
        return (self.inputs - 1) * self.spacing

    def windows(self, motion: FloatArray, every: int = 1) -> FloatArray:
        """Return the inputs at each sample from `lead` on, newest first, (n, inputs).

        Args:
            motion: (samples,).
            every: samples from one to the next.
        """
        windows = sliding_window_view(motion, self.lead + 1)[::every]
        return windows[:, :: -self.spacing]


@dataclass(frozen=True)
class Training:
    """Settings of a training.

    Noise, covariances, epochs and spread are tuned, on the five hands of `bench.cascade` in
    `harness.reproduce`; within factors of three they change reductions there by a point.

    Attributes:
        epochs: passes over the trials, each with another motion and level.
        spread: spread of the error's level, in its natural logarithm.
        turned: True to use the error backwards and mirrored as well, epochs in turn.
        every: samples from one that is learnt to the next; neighbours are alike.
        copies: candidates of each activation.
        noise: R.
        output_covariance: output covariance of the output's weights before the first sample.
        hidden_covariance: the same of a hidden unit's.
        drift: Q.
        seed: seed of the motions, the levels, the candidates and the order of the samples.

    Raises:
        SteadytipError: no epochs, or far too many; a seed below 0.
    """

    epochs: int = 48
    spread: float = 1.2
    turned: bool = True
    every: int = 20
    copies: int = 2
    noise: float = 0.5
    output_covariance: float = 5e-4
    hidden_covariance: float = 5e-3
    drift: float = 0.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.epochs <= MOST_EPOCHS:
            raise SteadytipError(f"--epochs {self.epochs}: must be in [1, {MOST_EPOCHS}]")
        if self.seed < 0:
            raise SteadytipError(f"--seed {self.seed}: must be 0 or more")


@dataclass(frozen=True)
class Node:
    """A hidden unit: its activation and weights.

    Attributes:
        kind: as the model counts activations.
        weights: weights of the inputs, of 1, and of the hidden units before it.
    """

    kind: int
    weights: FloatArray


@dataclass(frozen=True)
class Network:
    """A trained network.

    Attributes:
        architecture: its size.
        scale: scale of inputs and output [m].
        nodes: hidden units in their order.
        outputs: weights of the output for each number of hidden units from none on: of the inputs,
            of 1, of the hidden units.
        errors: rms that each of those leaves of the training's targets, over the scale.
    """

    architecture: Architecture
    scale: float
    nodes: tuple[Node, ...]
    outputs: tuple[FloatArray, ...] = field(repr=False)
    errors: tuple[float, ...]

    def cut(self, hidden: int) -> Network:
        """Return the network as it was with fewer hidden units."""
        return replace(
            self,
            nodes=self.nodes[:hidden],
            outputs=self.outputs[: hidden + 1],
            errors=self.errors[: hidden + 1],
        )

    def filtered(self, motion: FloatArray) -> FloatArray:
        """Remove the error from a motion, from the sample on at which the window is full.

        Args:
            motion: about the place that is held, (n,) [m], n above `architecture.lead`.

        Returns:
            (n - lead,) [m].
        """
        zeta = _with_one(self.architecture.windows(motion) / self.scale)
        for node in self.nodes:
            zeta = np.column_stack((zeta, _activated(node.kind, zeta @ node.weights)))
        out: FloatArray = self.scale * (zeta @ self.outputs[-1])
        return out

    def parameters(self, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> dict[str, object]:
        """Return parameters of the model `CascadeNeural`, by path of the field.

        Args:
            origin: place that is held, (3,) [m].
        """
        n = self.architecture.inputs

        def filled(values: FloatArray, size: int) -> FloatArray:
            return np.concatenate((values, np.zeros(size - len(values))))

        out = self.outputs[-1]
        found: dict[str, object] = {
            "spacing": self.architecture.spacing,
            "origin": np.asarray(origin, dtype=float),
            "input_scale": self.scale,
            "output_scale": self.scale,
            "output.weights": filled(out[:n], INPUTS),
            "output.hidden": filled(out[n + 1 :], HIDDEN),
            "output.bias": float(out[n]),
        }
        for i in range(HIDDEN):
            node = self.nodes[i] if i < len(self.nodes) else Node(0, np.zeros(n + 1))
            found |= {
                f"unit_{i + 1}.kind": node.kind,
                f"unit_{i + 1}.weights": filled(node.weights[:n], INPUTS),
                f"unit_{i + 1}.earlier": filled(node.weights[n + 1 :], HIDDEN),
                f"unit_{i + 1}.bias": float(node.weights[n]),
            }
        return found


def pseudo_motion(samples: int, rms: float, rng: np.random.Generator) -> FloatArray:
    """Make up a motion: white noise behind a low-pass (A04 5.3.3, Fig. 5.7).

    Args:
        samples: number of samples at RATE.
        rms: rms about the mean, which is 0 [m].
        rng: source of the noise.

    Returns:
        (samples,) [m].
    """
    lead = round(LEAD * RATE)
    low_pass = signal.butter(ORDER, CUTOFF, fs=RATE, output="sos")
    slow = signal.sosfilt(low_pass, rng.standard_normal(samples + lead))[lead:]
    slow -= slow.mean()
    return rms / np.std(slow) * slow


def train_filter(
    errors: Sequence[FloatArray],
    rms: float,
    architecture: Architecture,
    training: Training | None = None,
    target: Target = "motion",
    progress: Progress = lambda done, count: None,
    names: Sequence[str] | None = None,
) -> Network:
    """Train a filter on recorded errors.

    Args:
        errors: one for each trial, about the place that was held, (n,) [m] each at RATE.
        rms: rms of the motion that is made up [m]; the network's scale, too.
        architecture: size of the network.
        training: settings of the training.
        target: output that the network is trained for; the filter returns the motion either way.
        progress: takes the steps done.
        names: names of the trials, for messages.

    Raises:
        SteadytipError: a trial that is not twice as long as the window, or is at rest.
    """
    how = training or Training()
    for name, error in zip(
        names or [f"trial {k}" for k in range(1, len(errors) + 1)], errors, strict=True
    ):
        if len(error) < 2 * architecture.lead + 1:
            raise SteadytipError(
                f"{name}: {len(error)} samples at {RATE:g} Hz, and the window is "
                f"{architecture.lead + 1} long; twice that is needed: record longer, fit a larger "
                "part (--fit), or take fewer --inputs or a smaller --spacing"
            )
        if not np.std(error) > 0:
            raise SteadytipError(
                f"{name}: does not move at all; nothing can be learnt from it, leave the axis out "
                "(--axes)"
            )

    def draw(epoch: int) -> tuple[FloatArray, FloatArray]:
        inputs, targets = [], []
        for k, recorded in enumerate(errors):
            error = _turned(recorded, epoch) if how.turned else recorded
            rng = np.random.default_rng((how.seed, epoch, k))
            motion = pseudo_motion(len(error), rms, rng) / rms
            level = np.exp(rng.uniform(-how.spread, how.spread)) / rms
            inputs.append(architecture.windows(motion + level * error, how.every))
            wanted = motion if target == "motion" else level * error
            targets.append(wanted[architecture.lead :: how.every])
        return np.concatenate(inputs), np.concatenate(targets)

    network = train(draw, architecture, rms, how, progress)
    if target == "motion":
        return network
    # The motion is the newest input less the error.
    newest = np.eye(architecture.inputs + 1)[0]
    outputs = tuple(
        np.concatenate((newest - out[: len(newest)], -out[len(newest) :]))
        for out in network.outputs
    )
    return replace(network, outputs=outputs)


def train(
    draw: Draw,
    architecture: Architecture,
    scale: float,
    training: Training,
    progress: Progress = lambda done, count: None,
) -> Network:
    """Train a cascade network on any data.

    Args:
        draw: gives inputs and targets of an epoch, over the scale, each time the same.
        architecture: size of the network; hidden units are added up to it.
        scale: scale of inputs and output [m].
        training: settings of the training.
        progress: takes the steps done.
    """
    rng = np.random.default_rng(training.seed)
    drawn = [draw(epoch) for epoch in range(training.epochs)]
    zeta = _with_one(np.concatenate([inputs for inputs, _ in drawn]))
    wanted = np.concatenate([targets for _, targets in drawn])
    # In any order but that of the time, in which neighbours are alike.
    order = rng.permutation(len(wanted))
    progress(0, architecture.hidden + 1)
    out = _train_output(zeta, wanted, np.zeros(zeta.shape[1]), order, training)
    nodes: list[Node] = []
    outputs, errors = [out], [_rms(wanted - zeta @ out)]
    while len(nodes) < architecture.hidden:
        progress(len(nodes) + 1, architecture.hidden + 1)
        node = _best_candidate(zeta, wanted, out, order, training, rng)
        zeta = np.column_stack((zeta, _activated(node.kind, zeta @ node.weights)))
        order = rng.permutation(len(wanted))
        out = _train_output(zeta, wanted, np.append(out, 0.0), order, training)
        nodes.append(node)
        outputs.append(out)
        errors.append(_rms(wanted - zeta @ out))
    progress(architecture.hidden + 1, architecture.hidden + 1)
    return Network(architecture, scale, tuple(nodes), tuple(outputs), tuple(errors))


def _turned(error: FloatArray, epoch: int) -> FloatArray:
    """Return an error as it is, backwards, mirrored, or both, in turn by epoch."""
    way = error[::-1] if epoch % 2 else error
    return -way if epoch // 2 % 2 else way


def _with_one(inputs: FloatArray) -> FloatArray:
    return np.column_stack((inputs, np.ones(len(inputs))))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _activated(kind: int, z: FloatArray) -> FloatArray:
    value: FloatArray = list(ACTIVATIONS.values())[kind - 1].value(z, np)
    return value


def _train_output(
    zeta: FloatArray, wanted: FloatArray, start: FloatArray, order: np.ndarray, how: Training
) -> FloatArray:
    return train_output(
        zeta[order], wanted[order], start, how.noise, how.output_covariance, how.drift
    )


def _best_candidate(
    zeta: FloatArray,
    wanted: FloatArray,
    out: FloatArray,
    order: np.ndarray,
    how: Training,
    rng: np.random.Generator,
) -> Node:
    """Train a pool of candidates side by side; return the one with the least error.

    Args:
        zeta: inputs, 1 and hidden units of each sample, (n, k).
        wanted: targets, (n,).
        out: weights of the output so far, (k,).
        order: in which the samples come.
        how: settings of the training.
        rng: rng of the weights at the start.
    """
    size, pool = zeta.shape[1], how.copies * len(ACTIVATIONS)
    weights = np.zeros((2, pool, size + 1))
    weights[0, :, :-1] = rng.standard_normal((pool, size)) / np.sqrt(size)
    # The output begins with a little of the unit: without it, the weights have no gradient.
    weights[1] = np.append(out, 0.1)
    covariances = np.empty((2, size + 1))
    covariances[0], covariances[1] = how.hidden_covariance, how.output_covariance
    covariances[1, -1] = how.hidden_covariance * size
    w, v = train_pool(zeta[order], wanted[order], weights, covariances, how.noise, how.drift)
    z, linear = (zeta @ each[:, :-1].T for each in (w, v))
    left = []
    for k in range(pool):
        hidden = _activated(k // how.copies + 1, z[:, k])
        left.append(_rms(wanted - linear[:, k] - v[k, -1] * hidden))
    best = int(np.argmin(left))
    return Node(best // how.copies + 1, w[best, :-1])
