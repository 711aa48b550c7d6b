"""Models are found by their names in the source text, or by importing where these are computed."""

import pytest

from fmu_src.errors import SteadytipError
from fmu_src.pack import discovery

FILE = "fmu_src/tremor/flc.py"


@pytest.fixture
def written(monkeypatch):
    """Gives a source file another text."""

    def write(text: str) -> str | None:
        monkeypatch.setitem(discovery.TEXTS, FILE, text)
        discovery._defined.cache_clear()
        return discovery._defined(FILE)

    yield write
    monkeypatch.undo()
    discovery._defined.cache_clear()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ('MODEL = Model("Other", step)', "Other"),
        ("MODEL: Model = kit.Model(\n    'Other',\n    step)", "Other"),
        ('MODEL = make(name="Other")', "Other"),
        ("MODEL = make(NAME)", "Flc"),
        ("MODEL = INNER", "Flc"),
        ('INNER = Model("Other", step)', None),
        ('def f():\n    MODEL = Model("Other", step)', None),
    ],
)
def test_a_model_is_found_by_its_line(text, name, written):
    assert written(f"import nothing\n{text}\n") == name


def test_names_in_the_text_are_those_of_the_models():
    for name in discovery.model_names():
        assert discovery.load_model(name).name == name


def test_an_unknown_model_is_refused_with_the_nearest():
    with pytest.raises(SteadytipError, match="the nearest is 'Flc'"):
        discovery.module_of("Flcc")
