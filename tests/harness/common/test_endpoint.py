import pytest

from harness.common.endpoint import Endpoint

PARTS = ["hand", "hand.motion", "loop"]


@pytest.mark.parametrize(
    ("text", "part", "port"),
    [
        ("hand.tip[1]", "hand", "tip[1]"),
        ("hand.motion.recorded_x", "hand.motion", "recorded_x"),
        ("loop.body.frame[2]", "loop", "body.frame[2]"),
        ("hand.*", "hand", "*"),
    ],
)
def test_the_longest_name_of_a_part_that_fits_is_taken(text, part, port):
    endpoint = Endpoint.find(text, PARTS)
    assert endpoint == (part, port)
    assert str(endpoint) == text


@pytest.mark.parametrize("text", ["handle.tip", "hand", "tip", ""])
def test_a_text_without_a_part_is_no_endpoint(text):
    assert Endpoint.find(text, PARTS) is None
