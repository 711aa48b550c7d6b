"""Recordings as real loggers write them: a folder of cases beside the checkout, if it is there."""

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from harness.recordings.motion import read_recording

READ = {
    **dict.fromkeys(
        [
            *("quoted_header", "quoted_all", "semicolon_decimal_comma", "comment_preamble"),
            *("hash_header", "blank_first_line", "paren_units", "underscore_units", "t_header"),
            *("mm_micro_latin1", "ns", "trailing_comma_data", "extra_text_comma", "plain"),
        ],
        1.0,
    ),
    "cm": 10.0,
}
"""Size of the motion, in that of `plain`, by the name of the case."""
FOUND = {
    "12s_plain": [],
    "12s_pcjit1ms": ["noisy-clock"],
    "12s_float32": ["noisy-clock"],
    "constant": ["no-motion"],
}
REFUSED = {
    "12s_glitch_02mm": r"x is off by 0\.2 mm in one sample \(line 1502, at 6\.0000 s\)",
    "12s_r20": "sampled-too-slowly",
    "dup_columns": "2 columns are called like x",
}


@pytest.fixture
def case(data_dir):
    """Finds a case by its name."""
    folder = data_dir.parent / "cases" / "motion"
    if not folder.is_dir():
        pytest.skip(f"no cases: {folder} does not exist")

    def find(name):
        (path,) = folder.glob(f"{name}.*")
        return path

    return find


@pytest.mark.parametrize("name", READ)
def test_what_loggers_write_is_read(case, name):
    recording, plain = read_recording(case(name)), read_recording(case("plain"))
    np.testing.assert_allclose(recording.time, plain.time, atol=1e-7)
    np.testing.assert_allclose(recording.position, READ[name] * plain.position, atol=1e-9)
    assert recording.findings == ()


@pytest.mark.parametrize("name", FOUND)
def test_what_is_put_right_or_said_does_not_stop(case, name):
    recording = read_recording(case(name))
    assert [finding.name for finding in recording.findings] == FOUND[name]
    assert len(recording.time) == len(recording.position)


@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_figures_meaningless_is_refused(case, name):
    with pytest.raises(SteadytipError, match=REFUSED[name]):
        read_recording(case(name))
