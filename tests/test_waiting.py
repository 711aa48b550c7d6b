"""A wait ends with what it waits for, or says what did not happen."""

import pytest

from tests.waiting import wait_until


def test_a_wait_gives_the_value_that_ended_it() -> None:
    values = iter([0, "", None, 7])
    assert wait_until(lambda: next(values), pause=0.0) == 7


def test_a_wait_in_vain_says_what_did_not_happen() -> None:
    with pytest.raises(AssertionError, match="the end of days did not happen"):
        wait_until(lambda: False, timeout=0.02, what="the end of days")
