"""Message sets: the shipped ones, and what is wrong with others."""

from pathlib import Path

import pytest

from fmu_src.errors import SteadytipError
from harness.can.database import frame_time, load
from harness.common.errors import ProblemsError

DBC = Path(load("instrument").path).read_text()


@pytest.fixture
def changed(tmp_path):
    def change(*replacements: tuple[str, str]) -> str:
        text = DBC
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "changed.dbc"
        path.write_text(text)
        return str(path)

    return change


@pytest.mark.parametrize("dbc", ["instrument", "instrument_fd"])
def test_both_sets_carry_the_same_ports(dbc) -> None:
    database = load(dbc)
    sent = [s.name for m in database.sent_by("Board") for s in m.ports]
    channels = ["a1x", "a1z", "a2y", "a2z", "a3x", "a3y"]
    assert [n for n in sent if n.startswith("volts_a")] == [f"volts_{c}" for c in channels]
    assert {"volts_mx", "volts_my", "volts_mz", "temperature", "applied_1"} <= set(sent)
    commands = [s.name for m in database.sent_by("Loop") for s in m.ports if m.role == "command"]
    assert commands == ["volts_1", "volts_2", "volts_3"]


def test_timeouts_and_cycles_are_those_of_the_file() -> None:
    timeouts = {m.name: (m.cycle, m.timeout) for m in load("instrument").messages}
    assert timeouts["SensorsA"] == (1e-3, 5e-3)
    assert timeouts["SensorsM"] == (1e-3, 20e-3)
    assert timeouts["PiezoFeedback"] == (10e-3, 50e-3)
    assert timeouts["BoardHeartbeat"] == (0.1, 0.3)


def test_the_bus_has_room_for_all_of_it() -> None:
    """With as many stuff bits as there can be: sensors 40 %, with the command 54 %."""
    database = load("instrument")
    share = {m.name: database.seconds(m) / m.cycle for m in database.messages}
    sensors = sum(share[f"Sensors{part}"] for part in "ABM")
    assert sensors == pytest.approx(0.405, abs=1e-3)
    assert sensors + share["PiezoCommand"] == pytest.approx(0.54, abs=1e-3)
    assert sum(share.values()) < 0.57
    fast = load("instrument_fd")
    assert sum(fast.seconds(m) / m.cycle for m in fast.messages) < 0.37


def test_the_longest_classic_frame_has_135_bits() -> None:
    assert frame_time(8, False, 1e6, 1e6) == pytest.approx(135e-6)
    assert frame_time(8, False, 1e6, 1e6, extended=True) == pytest.approx(160e-6)


@pytest.mark.parametrize(
    ("replacement", "text"),
    [
        ((' SG_ counter : 8|4@1+ (1,0) [0|14] "" Board\n', ""), "'counter' of 4 bits at bit 8"),
        (("field_new", "applied_1"), "signal 'applied_1' is in 'SensorsM' and in"),
        (('"E2EProfile" BO_ 273 1;', '"E2EProfile" BO_ 273 0;'), "need a profile"),
        (('[0|100] "V" Board', '[0|100] "Volt" Board'), "unit 'Volt'"),
        (("[0|100]", "[0|131.07]"), "65535 is not available and in range at once"),
        (('"Role" BO_ 160 2;', '"Role" BO_ 160 9;'), "Role = 9 is none of"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(changed, replacement, text) -> None:
    with pytest.raises((ProblemsError, SteadytipError), match=r"changed\.dbc") as raised:
        load(changed(replacement))
    assert text in str(raised.value)


def test_all_that_is_wrong_is_said_at_once(changed) -> None:
    with pytest.raises(ProblemsError) as raised:
        load(changed(("[0|100]", "[0|131.07]"), ('"Role" BO_ 160 2;', '"Role" BO_ 160 9;')))
    assert len(raised.value.problems) == 7


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("instrumnet", "did you mean 'instrument'?"),
        ("nowhere/my.dbc", "does not exist"),
    ],
)
def test_a_file_that_is_not_there(name, text) -> None:
    with pytest.raises(SteadytipError, match=text.replace("?", r"\?")):
        load(name)


def test_a_file_that_is_none(tmp_path) -> None:
    path = tmp_path / "text.dbc"
    path.write_text("hello")
    with pytest.raises(SteadytipError, match="is no DBC file that can be used"):
        load(str(path))
