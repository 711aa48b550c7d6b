"""The check itself: it sees a changed figure, and knows another machine's arithmetic."""

import pytest

from tests.change_indication import conftest
from tests.change_indication.conftest import Check


@pytest.fixture
def tracked(tmp_path, monkeypatch, request) -> Check:
    if request.config.getoption("--update"):
        pytest.skip("the tracked figures are being written")
    monkeypatch.setattr(conftest, "HERE", tmp_path)
    text = f"figure,value\narithmetic,{conftest.arithmetic()}\nrms,0.123456789\nsha256,0f\n"
    (tmp_path / "case.csv").write_text(text, encoding="utf-8")
    return request.getfixturevalue("unchanged")


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"rms": 0.123456788, "sha256": "0f"}, "rms: 0.123456789 -> 0.123456788"),
        ({"rms": 0.123456789, "sha256": "0e"}, "sha256: 0f -> 0e"),
        ({"rms": 0.123456789}, "sha256: 0f -> nothing"),
        ({"rms": 0.123456789, "sha256": "0f", "more": 1.0}, "more: nothing -> 1"),
    ],
)
def test_a_difference_is_named(tracked: Check, figures, words) -> None:
    tracked("case", {"rms": 0.1234567890001, "sha256": "0f"})
    with pytest.raises(AssertionError, match="--update") as failure:
        tracked("case", figures)
    assert words in str(failure.value)


def test_another_arithmetic_may_differ_in_bits_but_not_in_size(tracked, monkeypatch) -> None:
    monkeypatch.setattr(conftest, "arithmetic", lambda: "another")
    tracked("case", {"rms": 0.1235, "sha256": "0e"})
    with pytest.raises(AssertionError, match="rms"):
        tracked("case", {"rms": 0.13, "sha256": "0e"})
