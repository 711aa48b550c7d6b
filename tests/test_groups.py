"""Tests of a group are run by one worker; a group that is not seen costs half the suite's time."""

import pytest


@pytest.mark.xdist_group("a group")
def test_workers_know_the_groups(request) -> None:
    if not request.config.getoption("loadgroup", default=False):
        pytest.skip("not spread by groups: needs -n and --dist loadgroup")
    assert request.node.nodeid.endswith("@a group")
