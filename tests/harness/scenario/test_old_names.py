"""Old names of scenario keys: read for one release, and noted by name."""

from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet

import steadytip as st
from harness.recordings.run_record import METADATA_KEY
from harness.scenario.load import load

HEAD = 'seconds = 4.0\n{step} = 1e-3\n{settle} = 1.5\n[part.hand]\nfmu = "Hand"\n'
ROLES = '[signals]\n{moved} = "hand.tip_*"\n{drive} = "hand.tip_x"\n{stroke} = "hand.tip_y"\n'
HIL = "[hil]\n{slack} = 2e-3\n{patience} = 1.0\n"
OLD = {n: n for n in ("step", "settle", "moved", "drive", "stroke", "slack", "patience")}
NEW = {
    "step": "step_size",
    "settle": "warm_up",
    "moved": "tip_uncompensated",
    "drive": "actuator_voltage",
    "stroke": "actuator_stroke",
    "slack": "sample_deadline",
    "patience": "startup_timeout",
}


def written(folder, names, more="") -> str:
    path = folder / "case.toml"
    path.write_text((HEAD + ROLES + HIL).format(**names) + more, encoding="utf-8")
    return str(path)


def test_old_names_mean_the_new_ones_and_each_is_noted(tmp_path) -> None:
    old, new = load(written(tmp_path, OLD)), load(written(tmp_path, NEW))
    assert old.table == new.table
    assert new.notes == ()
    assert len(old.notes) == len(OLD)
    for name, text in {
        "step": "'step' is called 'step_size' now",
        "moved": "'signals.moved' is called 'signals.tip_uncompensated' now",
        "slack": "'hil.slack' is called 'hil.sample_deadline' now",
    }.items():
        assert any(text in note for note in old.notes), name


def test_a_run_says_the_note(tmp_path) -> None:
    said: list[str] = []
    names = {**NEW, "settle": "settle"}
    st.run(written(tmp_path, names), out=tmp_path / "out", report=False, status=said.append)
    assert "case.toml: 'settle' is called 'warm_up' now; the old name goes soon" in said


def test_old_names_in_overrides_and_variants(tmp_path) -> None:
    path = written(tmp_path, NEW, "[variant.long]\nsettle = 2.0\n")
    assert load(path, variant="long").warm_up == 2.0
    found = load(path, {"settle": 2.5, "signals.drive": "hand.tip_z"})
    assert found.warm_up == 2.5
    assert found.signals.actuator_voltage == "hand.tip_z"
    assert any(note.startswith("overrides: 'settle'") for note in found.notes)


def test_both_names_at_once_are_refused(tmp_path) -> None:
    path = Path(written(tmp_path, NEW))
    path.write_text("settle = 1.0\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(st.SteadytipError, match="'settle' is the old name of 'warm_up'"):
        load(path)


def test_a_record_with_roles_of_before_is_read(tmp_path) -> None:
    result = st.run(written(tmp_path, NEW), out=tmp_path / "out", report=False)
    table = parquet.read_table(result.file)
    text = table.schema.metadata[METADATA_KEY].decode()
    for old in ("moved", "drive", "stroke"):
        text = text.replace(f'"{NEW[old]}"', f'"{old}"')
    path = tmp_path / "old.parquet"
    schema: pa.Schema = table.schema.with_metadata({METADATA_KEY: text.encode()})
    parquet.write_table(table.cast(schema), path)
    old_result = st.read(path)
    assert (old_result.role("tip_uncompensated") == result.role("tip_uncompensated")).all()
    assert set(old_result.metadata.roles) == set(result.metadata.roles)
