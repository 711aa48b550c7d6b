"""Metadata of a run: typed, versioned, and read from records of before."""

import json

import pytest
from pyarrow import parquet

import steadytip as st
from harness.recordings.run_record import METADATA_KEY
from harness.results.run_metadata import VERSION, RunMetadata

OLD = {
    "scenario": "case",
    "step": 1e-3,
    "settle": 2.0,
    "undriven": ["a.u"],
    "roles": {"moved": ["a.y"], "tip": ["b.y"]},
    "parts": {"a": {"kind": "fmu"}},
}


def test_metadata_of_before_are_read_under_the_new_names() -> None:
    found = RunMetadata.read(OLD, "old.parquet")
    assert (found.version, found.step_size, found.warm_up) == (0, 1e-3, 2.0)
    assert found.unconnected == ["a.u"]
    assert found.roles == {"tip_uncompensated": ["a.y"], "tip": ["b.y"]}
    assert RunMetadata.read(json.loads(found.json_text()), "again") == found


def test_a_record_of_a_later_version_is_refused() -> None:
    with pytest.raises(st.SteadytipError, match=r"new\.parquet was written by a later version"):
        RunMetadata.read({**OLD, "version": VERSION + 1}, "new.parquet")


@pytest.mark.parametrize(
    ("values", "words"),
    [({}, "'step_size' is missing"), ({**OLD, "ticks": "many"}, "'ticks' = 'many'")],
)
def test_what_is_no_record_of_a_run_is_said(values, words) -> None:
    with pytest.raises(st.SteadytipError, match="is not the record of a run") as caught:
        RunMetadata.read(values, "file.parquet")
    assert words in str(caught.value)


def test_a_run_writes_its_version(tmp_path) -> None:
    text = 'seconds = 0.01\nstep_size = 1e-3\n[part.hand]\nfmu = "Hand"\n'
    (tmp_path / "one.toml").write_text(text, encoding="utf-8")
    result = st.run(tmp_path / "one.toml", out=tmp_path / "out", report=False)
    assert result.metadata.version == VERSION
    written = json.loads(parquet.read_schema(result.file).metadata[METADATA_KEY])
    assert written["version"] == VERSION
    assert written["step_size"] == 1e-3
