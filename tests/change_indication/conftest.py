"""Change indication: figures and hashes that are tracked, so that a diff shows what a change moves.

Each test compares what it measures with one CSV file beside it. `pytest tests/change_indication
-m "" --update` writes the files anew; the diff is then part of the change, and is reviewed with it.

Figures are written with nine digits. They are compared to the digit where the arithmetic is that of
the machine that wrote them. Elsewhere mathematics libraries differ in the last bit: figures of runs
are compared to one per cent there, hashes are not compared, and figures of fits, which amplify the
last bit, are skipped.
"""

import csv
import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from scipy import fft

HERE = Path(__file__).parent
HEADINGS = ("figure", "value")
DIGITS = 9
ELSEWHERE = 1e-2
"""Relative difference that another machine's mathematics library may make."""
NOTHING = 1e-9
"""Figures below are rounding errors, and compared on the same arithmetic only."""


def arithmetic() -> str:
    """Return a fingerprint of this machine's mathematics: libm, NumPy's loops, LAPACK, FFT."""
    x = np.random.default_rng(0).normal(size=256)
    digest = hashlib.sha256()
    for function in (math.exp, math.sin, math.cos, math.tan, math.tanh, math.erf, math.atan):
        digest.update(np.array([function(value) for value in x]).tobytes())
    for loop in (np.exp, np.sin, np.log1p, np.tanh):
        digest.update(loop(np.abs(x)).tobytes())
    square = x.reshape(16, 16)
    for matrix in (square @ square, np.linalg.inv(square), np.linalg.eigh(square @ square.T)[1]):
        digest.update(matrix.tobytes())
    digest.update(fft.fft(x).tobytes())
    return digest.hexdigest()[:16]


def digest(values: np.ndarray) -> str:
    """Return a hash of an array's float64 values, (...)."""
    return hashlib.sha256(np.ascontiguousarray(values, dtype=float).tobytes()).hexdigest()[:16]


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.{DIGITS}g}"


def _same(old: str, new: str, here: bool) -> bool:
    if here or old == new:
        return old == new
    try:
        a, b = float(old), float(new)
    except ValueError:
        return True  # a hash
    return math.isclose(a, b, rel_tol=ELSEWHERE, abs_tol=NOTHING)


class Check(Protocol):
    def __call__(
        self, name: str, figures: Mapping[str, float | str], portable: bool = True
    ) -> None: ...


@pytest.fixture
def unchanged(request: pytest.FixtureRequest) -> Check:
    """Compares figures with the tracked ones, or writes them."""
    update = request.config.getoption("--update")

    def check(name: str, figures: Mapping[str, float | str], portable: bool = True) -> None:
        assert figures, "nothing was measured"
        path = HERE / f"{name}.csv"
        found = {figure: _text(value) for figure, value in figures.items()}
        if update:
            path.parent.mkdir(exist_ok=True)
            with path.open("w", newline="", encoding="utf-8") as file:
                rows = csv.writer(file, lineterminator="\n")
                rows.writerows([HEADINGS, ("arithmetic", arithmetic()), *found.items()])
            return
        with path.open(newline="", encoding="utf-8") as file:
            _, *rows = csv.reader(file)
        tracked = dict(rows)
        here = tracked.pop("arithmetic") == arithmetic()
        if not here and not portable:
            pytest.skip(f"{path.name} was written on another arithmetic, which fits amplify")
        changed = [
            f"{figure}: {tracked.get(figure, 'nothing')} -> {found.get(figure, 'nothing')}"
            for figure in {**tracked, **found}
            if not (
                figure in tracked
                and figure in found
                and _same(tracked[figure], found[figure], here)
            )
        ]
        assert not changed, (
            "\n".join([f"{len(changed)} of {len(found)} figures of {path.name} changed:", *changed])
            + "\nIf that is meant, run `pytest tests/change_indication -m '' --update` and say why"
            " in the commit."
        )

    return check
