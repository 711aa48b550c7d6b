"""One worker runs all tests of a group; where it does not, the suite takes twice as long."""

import pytest


@pytest.mark.xdist_group("a group")
def test_workers_know_the_groups(request) -> None:
    if not request.config.getoption("loadgroup", default=False):
        pytest.skip("not spread by groups: needs -n and --dist loadgroup")
    assert request.node.nodeid.endswith("@a group")
