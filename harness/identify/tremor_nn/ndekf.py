"""Node-decoupled extended Kalman filtering of candidates, several samples at a time.

The filter (see `cascade`) updates both covariances of a candidate with every sample. The effect of
a sample on the next ones depends on few numbers, so that the covariances can be updated once for a
block of B samples. With Z = (zeta_1 ... zeta_B), and P of the block's beginning,

    F = P Z,    G = Z^T F
    q_k  = sqrt(A_k) psi_k G_k zeta_k     A_k, psi_k as ever; zeta_k as k-th unit vector
    G   <- G - q_k q_k^T
    P   <- P - (F T) (F T)^T              F times column k of T: P_k zeta_k, scaled as q_k is

which is the same filter, without any approximation. Net inputs and outputs of the block are updated
as w^T Z. The last input of the output is the hidden unit, which is known only at its sample; so the
unit vector of that place is a further column of Z. Drift adds to P at each sample and needs blocks
of one sample.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.tremor.cascade_neural import ACTIVATIONS
from harness.common.types import FloatArray

__all__ = ["train_output", "train_pool"]

BLOCK = 8
"""Samples of a block; 6 to 12 are fastest."""
ROWS = 32
"""Samples of a product; with more, threads cost more time than they save."""


def train_output(
    zeta: FloatArray,
    wanted: FloatArray,
    start: FloatArray,
    noise: float,
    covariance: float,
    drift: float = 0.0,
) -> FloatArray:
    """Train the weights of an output alone; the filter is then recursive least squares.

    Args:
        zeta: inputs of the output at each sample, (n, k).
        wanted: targets, (n,).
        start: weights before the first sample, (k,).
        noise: R.
        covariance: covariance of each weight before the first sample.
        drift: Q; without it the result does not depend on the order of the samples.

    Returns:
        (k,).
    """
    if not drift:
        gram, toward = noise / covariance * np.eye(len(start)), np.zeros(len(start))
        for first in range(0, len(wanted), ROWS):
            rows = zeta[first : first + ROWS]
            gram += rows.T @ rows
            toward += rows.T @ (wanted[first : first + ROWS] - rows @ start)
        end: FloatArray = start + np.linalg.solve(gram, toward)
        return end
    w, P = start.copy(), covariance * np.eye(len(start))
    for row, target in zip(zeta, wanted, strict=True):
        phi = P @ row
        A = 1 / (noise + row @ phi)
        w += A * (target - w @ row) * phi
        P -= A * np.outer(phi, phi)
        P.flat[:: len(P) + 1] += drift
    return w


def train_pool(
    zeta: FloatArray,
    wanted: FloatArray,
    weights: FloatArray,
    covariances: FloatArray,
    noise: float,
    drift: float = 0.0,
    block: int = BLOCK,
) -> FloatArray:
    """Train hidden units side by side, each with an output of its own.

    Args:
        zeta: inputs of the hidden units at each sample, (n, k).
        wanted: targets, (n,).
        weights: before the first sample, (2, pool, k + 1), of the hidden units (the last one is
            none) and of the outputs (the last one is that of the hidden unit). The pool holds as
            many units of each activation, in the order of ACTIVATIONS.
        covariances: covariances of each of those before the first sample, (2, k + 1).
        noise: R.
        drift: Q.
        block: samples that are taken at a time.

    Returns:
        Weights after the last sample, (2, pool, k + 1).
    """
    w = weights.copy()
    _, pool, size = w.shape
    C = np.empty((2, pool, size, size))
    C[:] = (covariances[:, :, None] * np.eye(size))[:, None]
    block = 1 if drift else min(block, len(wanted))
    blocks = len(wanted) - len(wanted) % block
    for first, past, count in ((0, blocks, block), (blocks, len(wanted), len(wanted) - blocks)):
        if past == first:
            continue
        scan = _Scan(pool, count, noise)
        Z = np.zeros((size, count + 1))
        Z[-1, -1] = 1.0
        F, change = np.empty((2, pool, size, count + 1)), np.empty((2, pool, size, count))
        less = np.empty_like(C)
        for k in range(first, past, count):
            Z[:-1, :-1] = zeta[k : k + count].T
            np.matmul(C, Z, out=F)
            np.matmul(Z.T, F, out=scan.gram)
            np.matmul(w, Z, out=scan.linear)
            scan.wanted[:] = wanted[k : k + count]
            scan.run()
            np.matmul(F, scan.columns.transpose(0, 1, 3, 2), out=change)
            w += (change @ scan.gain[:, :, None])[..., 0]
            C -= np.matmul(change, change.transpose(0, 1, 3, 2), out=less)
            if drift:
                C[:, :, range(size), range(size)] += drift
    return w


class _Scan:
    """The filter within blocks of a pool.

    Attributes:
        gram: G of hidden units and outputs, (2, pool, B + 1, B + 1).
        linear: net inputs and outputs at the block's beginning, (2, pool, B + 1).
        wanted: targets, (B,).
        columns: T of both, transposed, (2, pool, B, B + 1).
        gain: factors of the columns in the change of the weights, (pool, B).
    """

    def __init__(self, pool: int, count: int, noise: float) -> None:
        self.gram = np.empty((2, pool, count + 1, count + 1))
        self.linear = np.empty((2, pool, count + 1))
        self.wanted = np.empty(count)
        self.columns = np.empty((2, pool, count, count + 1))
        self.gain = np.empty((pool, count))
        # CasADi keeps pointers; the arrays must live.
        self._noise = np.array([noise])
        self._calls: list[tuple[Any, Any]] = []
        copies = pool // len(ACTIVATIONS)
        for k, kind in enumerate(ACTIVATIONS):
            part = slice(k * copies, (k + 1) * copies)
            function: Any = _block(kind, count, copies)
            buffer, evaluate = function.buffer()
            arguments = (
                *(each[node, part] for each in (self.gram, self.linear) for node in range(2)),
                self.wanted,
                self._noise,
            )
            results = (*(self.columns[node, part] for node in range(2)), self.gain[part])
            for place, array in enumerate(arguments):
                buffer.set_arg(place, array.data)
            for place, array in enumerate(results):
                buffer.set_res(place, array.data)
            self._calls.append((buffer, evaluate))

    def run(self) -> None:
        """Compute columns and gain from gram, linear and wanted."""
        for _, evaluate in self._calls:
            evaluate()


@cache
def _block(kind: str, count: int, copies: int) -> ca.Function:
    """Build the filter within a block of `count` samples, for `copies` units of one activation."""
    activation, n = ACTIVATIONS[kind], count + 1
    given = [ca.SX.sym(name, n, n) for name in ("G", "L")]
    linear = [ca.SX.sym(name, n) for name in ("z", "y")]
    wanted, noise = ca.SX.sym("t", count), ca.SX.sym("R")
    # Row k is taken from the diagonal on, so that of symmetric matrices one half is computed.
    (G, L), (z, y) = given, linear
    hidden: list[Any] = []
    output: list[Any] = []
    gains = []
    for k in range(count):
        h, slope = activation.value(z[k], ca), activation.slope(z[k], ca)
        psi = y[-1] * slope
        q = G[k, k:].T
        m = L[k, k:].T + h * L[k:, -1]
        root = 1 / ca.sqrt(noise + psi**2 * q[0] + m[0] + h * m[-1])
        gain = root * (wanted[k] - y[k] - h * y[-1])
        q, m = root * psi * q, root * m
        # Columns of T, in terms of F: the input less the share of the samples before.
        for columns, scale, into in ((hidden, root * psi, 0.0), (output, root, h)):
            column = ca.SX(n, 1)
            column[k], column[-1] = 1.0, into
            for before, taken in columns:
                column -= (taken[k] + into * taken[-1]) * before
            columns.append((scale * column, ca.vertcat(ca.SX(k, 1), q if columns is hidden else m)))
        z = ca.vertcat(z[:k], z[k:] + gain * q)
        y = ca.vertcat(y[:k], y[k:] + gain * m)
        G, L = (
            ca.blockcat([[M[:k, :k], M[:k, k:]], [M[k:, :k], M[k:, k:] - taken @ taken.T]])
            for M, taken in ((G, q), (L, m))
        )
        gains.append(gain)
    results = [
        *(ca.densify(ca.horzcat(*(each for each, _ in columns))) for columns in (hidden, output)),
        ca.vertcat(*gains),
    ]
    arguments = [*given, *linear, wanted, noise]
    one: Any = ca.Function(kind, [*arguments], results)
    symbols = [
        ca.MX.sym(f"a{k}", each.shape[0], each.shape[1] * (copies if k < 4 else 1))
        for k, each in enumerate(arguments)
    ]
    shared = [ca.repmat(each, 1, copies) for each in symbols[4:]]
    found: Any = one.map(copies)(*symbols[:4], *shared)
    return ca.Function(kind, symbols, found)
