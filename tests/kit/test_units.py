import pytest

from fmu_src.errors import SteadytipError
from fmu_src.kit.units import base_exponents


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("m", {"m": 1}),
        ("m/s2", {"m": 1, "s": -2}),
        ("rad/s", {"s": -1, "rad": 1}),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("V.s2/m", {"kg": 1, "m": 1, "s": -1, "A": -1}),
        ("Hz", {"s": -1}),
        ("1/s", {"s": -1}),
        ("m/m", {}),
        ("m/s2/Hz0.5", None),
        ("degC", {"K": 1}),
        ("V/K", {"kg": 1, "m": 2, "s": -3, "A": -1, "K": -1}),
    ],
)
def test_exponents_follow_from_the_name(unit, exponents) -> None:
    assert base_exponents(unit) == exponents


@pytest.mark.parametrize("unit", ["furlong", "m^2", "m//s", "", "2m"])
def test_unknown_units_are_refused_by_name(unit) -> None:
    with pytest.raises(SteadytipError, match="unit"):
        base_exponents(unit)
