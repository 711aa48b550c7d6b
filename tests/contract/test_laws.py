"""The laws of `steadytip.testing`, which hold a user's model, too, on every model's FMU."""

import pytest

from steadytip.testing import LAWS, laws_of
from tests.contract.conftest import FLAVOURS

CASES = [(flavour, law) for flavour in FLAVOURS for law in laws_of(flavour)]


@pytest.mark.parametrize(("flavour", "law"), CASES)
def test_the_law_holds(model, start, inputs, flavour, law) -> None:
    LAWS[law](model, lambda **values: start(flavour, **values), inputs)
