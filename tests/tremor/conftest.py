"""What the tests of several filters share: recorded hands, and how they are scored."""

import pytest

from harness.recordings.motion import recordings
from harness.reproduce.experiments import tremor


@pytest.fixture(scope="session")
def hands(data_dir):
    """Motions of the ten recorded hands."""
    found = [tremor.recorded(path) for path in recordings([data_dir / "hand_motion_m2s2"])]
    assert len(found) == 10
    return found


@pytest.fixture(scope="session")
def ranked(hands):
    """Column of a filter, by name and delay [s], on the recorded hands."""
    known = tremor.filters()

    def column(name: str, delay: float) -> tremor.FilterScores:
        each = known[name]
        return tremor.FilterScores([tremor.score(hand, each.tremor(hand, delay)) for hand in hands])

    return column
