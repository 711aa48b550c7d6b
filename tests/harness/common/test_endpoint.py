import pytest

from harness.common.endpoint import Endpoint


@pytest.mark.parametrize(
    ("text", "part", "port"),
    [
        ("hand.motion[1]", "hand", "motion[1]"),
        ("loop.body.frame[2]", "loop", "body.frame[2]"),
        ("hand", "hand", ""),
    ],
)
def test_the_first_dot_ends_the_part_and_the_text_comes_back(text, part, port):
    endpoint = Endpoint.parse(text)
    assert endpoint == (part, port)
    assert str(endpoint) == text
