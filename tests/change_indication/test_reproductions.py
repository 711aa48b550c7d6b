"""Figures of the papers' tables and plots, as `steadytip reproduce` measures them."""

import json

import pytest

from harness.reproduce.catalogue import items
from tests.change_indication.conftest import Check
from tests.command import steadytip

ELSEWHERE = {"tremor-loop"}
"""Items of minutes, whose runs are those of the scenario `tremor_bench`, which `runs` tracks."""
ITEMS = {item.name: item for item in items() if item.name not in ELSEWHERE}


@pytest.mark.slow
@pytest.mark.parametrize("name", ITEMS)
def test_an_item_measures_the_same(name, tmp_path, request, monkeypatch, unchanged: Check) -> None:
    data = ()
    if ITEMS[name].recordings:
        data = ("--data", request.getfixturevalue("data_dir"))
    # Some items measure more where there are recordings; which then count must not depend on it.
    monkeypatch.delenv("STEADYTIP_DATA", raising=False)
    out = tmp_path / "figures.json"
    steadytip("reproduce", name, "--json", out, "--out", tmp_path, "--quiet", *data)
    figures: dict[str, float] = {}
    for entry in json.loads(out.read_text(encoding="utf-8")):
        key = f"{entry['source']}, {entry['quantity']} [{entry['unit']}], {entry['setting']}"
        assert key not in figures, f"two figures are called '{key}'"
        figures[key] = entry["measured"]
    unchanged(f"reproduce/{name}", figures, portable=False)
