"""One recording for all boards."""

from pathlib import Path

import numpy as np
import pytest

from harness.can.firmware.process import write_samples


@pytest.fixture(scope="session")
def volts() -> np.ndarray:
    """(samples, 9) whole counts all over the range of the converter, no two samples alike [V]."""
    # Not above: where the board does not run, its module skips the tests and not this folder.
    from tests.harness.can.firmware.board import SAMPLES

    return np.random.default_rng(7).integers(0, 65535, (SAMPLES, 9)) * (5.0 / 65535)


@pytest.fixture(scope="session")
def recording(volts, tmp_path_factory) -> Path:
    n = np.arange(len(volts))
    path = tmp_path_factory.mktemp("board") / "samples.csv"
    return write_samples(path, volts, temperature=-20.0 + 0.3 * n, field_new=n % 10 == 0)
