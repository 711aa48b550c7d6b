"""Parameter sets, units and file names of SSP."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.parts import ssp_markup as markup
from harness.parts.ports import Unit
from harness.parts.ssv import SsvValue, read_ssv, write_ssv
from harness.ssp.names import file_names

EXPONENTS = st.tuples(*[st.integers(-4, 4)] * 8)
SCALES = st.floats(1e-9, 1e9)
TEXT = st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=20)
VALUES = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-(2**31), 2**31 - 1),
    st.booleans(),
    TEXT,
)


@given(values=st.dictionaries(TEXT, VALUES), exponents=EXPONENTS, factor=SCALES)
def test_a_parameter_set_is_read_as_it_was_written(values, exponents, factor, tmp_path_factory):
    unit = Unit("some/unit", exponents, factor, -1.5)
    written = {
        name: SsvValue(value, unit.name, unit) if isinstance(value, float) else SsvValue(value)
        for name, value in values.items()
    }
    path = tmp_path_factory.mktemp("ssv") / "set.ssv"
    path.write_bytes(write_ssv("set", written))
    read = read_ssv(path)
    assert read == written
    assert [type(v.value) for v in read.values()] == [type(v.value) for v in written.values()]


def test_a_unit_without_a_base_unit_is_left_out(tmp_path):
    density = SsvValue(1.0, "m/s2/Hz0.5", Unit("m/s2/Hz0.5"))
    path = tmp_path / "set.ssv"
    path.write_bytes(write_ssv("set", {"density": density}))
    assert read_ssv(path) == {"density": SsvValue(1.0)}


@given(
    value=st.floats(-1e6, 1e6),
    exponents=EXPONENTS,
    factors=st.tuples(SCALES, SCALES),
    offset=SCALES,
)
def test_conversion_there_and_back(value, exponents, factors, offset):
    one, other = Unit("one", exponents, factors[0]), Unit("other", exponents, factors[1], offset)
    there = markup.convert(value, one, other)
    assert there is not None
    back = markup.convert(there, other, one)
    assert back == pytest.approx(value, rel=1e-9, abs=1e-9 * (1 + offset / factors[0]))


def test_degrees_celsius_to_kelvin():
    kelvin = Unit("K", (0, 0, 0, 0, 1, 0, 0, 0))
    celsius = Unit("degC", kelvin.exponents, 1.0, 273.15)
    assert markup.convert(20.0, celsius, kelvin) == pytest.approx(293.15)
    assert markup.convert(20.0, celsius, Unit("m", (0, 1, 0, 0, 0, 0, 0, 0))) is None


@given(st.dictionaries(st.integers(), st.text(max_size=100), max_size=8))
def test_file_names_are_portable_and_tell_apart(wanted):
    names = file_names(wanted, ".fmu")
    assert set(names) == set(wanted)
    assert len({name.casefold() for name in names.values()}) == len(wanted)
    for name in names.values():
        assert name.isascii()
        assert not set(name) & set('/\\:*?"<>|% #')
        assert len(name) < 80


@pytest.mark.parametrize("content", ["", "<a/>", "<!DOCTYPE a><a/>", "\0"])
def test_what_is_no_parameter_set_is_refused(content, tmp_path):
    path = tmp_path / "set.ssv"
    path.write_text(content)
    with pytest.raises(SteadytipError, match=r"set\.ssv"):
        read_ssv(path)
