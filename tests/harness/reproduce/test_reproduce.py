"""`steadytip reproduce`: which items there are, what a name means, and what is written."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmu_src.errors import SteadytipError
from harness.common.figures import Figure
from harness.report.figure_table import figure_table
from harness.reproduce import papers
from harness.reproduce.catalogue import chosen, items
from harness.reproduce.item import Context, Item, ItemResult
from tests.harness.cli import test_cli

ROOT = Path(__file__).parents[3]
KEYS = ["source", "quantity", "unit", "paper", "measured", "setting"]


def call(monkeypatch, capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, output, errors of `steadytip reproduce`; blanks made single."""
    return test_cli.call(monkeypatch, capsys, "reproduce", *map(str, arguments))


@pytest.fixture(autouse=True)
def _no_recordings(monkeypatch):
    monkeypatch.delenv("STEADYTIP_DATA", raising=False)


@pytest.fixture
def drop_in(tmp_path, monkeypatch):
    """Puts the text of a module beside the items, as somebody would who adds one."""
    folder = tmp_path / "more"
    folder.mkdir()
    monkeypatch.setattr(papers, "__path__", [*papers.__path__, str(folder)])
    names = []

    def drop(name: str, run: str, **keys: str) -> None:
        given = {"source": "X99 table 9.9", "title": "T", "group": "dropped"} | keys
        text = "from harness.reproduce.item import *\nfrom harness.common.errors import *\n"
        text += "from harness.common.figures import *\n"
        text += f"def run(context):\n    {run}\n"
        words = ", ".join(f"{key}={value!r}" for key, value in given.items())
        text += f"ITEM = Item(name={name!r}, run=run, {words})\n"
        module = "dropped_" + re.sub(r"\W", "_", name)
        (folder / f"{module}.py").write_text(text)
        names.append(f"harness.reproduce.papers.{module}")

    yield drop
    for name in names:
        sys.modules.pop(name, None)


ONE = "return ItemResult((Figure('X99 table 9.9', 'q', 'um', 2.0, 1.5, 's'),))"


# What there is ------------------------------------------------------------------------------------


def test_without_arguments_all_items_are_listed(monkeypatch, capsys):
    code, shown, _ = call(monkeypatch, capsys)
    assert code == 0
    for item in items():
        assert f"{item.name} {item.source} {item.group} {item.title}" in shown


def test_the_list_comes_without_heavy_imports():
    """However many items there are, and whatever they compute with."""
    code = (
        "import sys; sys.argv = ['steadytip', 'reproduce']\n"
        "from harness.cli.main import app\n"
        "try: app()\n"
        "except SystemExit: pass\n"
        "print(*sys.modules)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "table-6.1" in done.stdout
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "scipy", "casadi", "fmpy", "pyarrow", "plotly", "jinja2"}


def test_items_are_well_formed_and_named_once():
    known = items()
    assert len({item.name for item in known}) == len(known)
    for item in known:
        assert re.fullmatch(r"[a-z0-9.-]+", item.name)
        # Of a paper, or what it is measured on where no paper has it.
        assert re.match(r"[A-Z]+\d* (table|figure)s? \d|BROAD$", item.source)
        assert not item.title.endswith(".")


def test_figures_are_listed_by_their_number():
    names = [item.name for item in items() if item.group == "hysteresis"]
    figures = [name for name in names if name.startswith("figure-7.")]
    assert figures.index("figure-7.8") < figures.index("figure-7.10")


def test_a_file_that_is_dropped_in_is_an_item(drop_in, monkeypatch, capsys, tmp_path):
    drop_in("table-9.9", ONE)
    code, shown, _ = call(monkeypatch, capsys)
    assert "table-9.9 X99 table 9.9 dropped T" in shown
    code, shown, _ = call(monkeypatch, capsys, "9.9", "--out", tmp_path / "o")
    assert code == 0
    assert "q 2 1.5 µm s" in shown


def test_two_items_of_one_name_are_a_mistake(drop_in):
    drop_in("table-6.1", ONE)
    with pytest.raises(SteadytipError, match=r"another item is called 'table-6\.1', too"):
        items()


# What a name means --------------------------------------------------------------------------------


def _item(name, group="g", source="A04 x", **keys):
    return Item(name, source, "t", group, lambda context: ItemResult(), **keys)


KNOWN = [
    _item("table-7.1", "hysteresis"),
    _item("figure-7.1", "hysteresis"),
    _item("figure-7.10", "hysteresis", aliases=("figure-7.11",)),
    _item("table-2.1", "tremor", source="E13 table 2.1"),
]


@pytest.mark.parametrize(
    ("names", "meant"),
    [
        (["table-7.1"], ["table-7.1"]),
        (["7.1"], ["table-7.1", "figure-7.1"]),
        (["Fig. 7.1"], ["figure-7.1"]),
        (["fig7.10", "TABLE_7.1", "figure 7.10"], ["figure-7.10", "table-7.1"]),
        (["7.11"], ["figure-7.10"]),
        (["hysteresis"], ["table-7.1", "figure-7.1", "figure-7.10"]),
        (["e13"], ["table-2.1"]),
        (["all"], ["table-7.1", "figure-7.1", "figure-7.10", "table-2.1"]),
    ],
)
def test_names_mean_items(names, meant):
    assert [item.name for item in chosen(names, KNOWN)] == meant


@pytest.mark.parametrize(
    ("name", "hint"),
    [("hysterisis", "did you mean 'hysteresis'?"), ("tabel-7.1", "did you mean 'table-7.1'?")],
)
def test_unknown_names_tell_the_nearest(name, hint):
    with pytest.raises(SteadytipError) as caught:
        chosen([name, "7.1"], KNOWN)
    assert str(caught.value) == f"reproduce: nothing is called '{name}'; {hint}"


def test_an_unknown_name_ends_with_2(monkeypatch, capsys):
    code, _, err = call(monkeypatch, capsys, "manipulater")
    assert code == 2
    assert "nothing is called 'manipulater'; did you mean 'manipulator'?" in err


# What is written ----------------------------------------------------------------------------------


def test_numbers_go_to_json_and_page(drop_in, monkeypatch, capsys, tmp_path):
    drop_in("table-9.9", "return ItemResult((Figure('X99 table 9.9', 'a < b', 'um', None, 1.5, 'at 2 um'),), (), ('Note on 3 um.',))")  # fmt: skip  # noqa: E501
    target = tmp_path / "new" / "r.json"
    code, shown, _ = call(monkeypatch, capsys, "9.9", "--json", target, "--out", tmp_path / "o")
    assert code == 0
    (entry,) = json.loads(target.read_text())
    assert list(entry) == KEYS
    assert entry == {
        "source": "X99 table 9.9", "quantity": "a < b", "unit": "um", "paper": None,
        "measured": 1.5, "setting": "at 2 um",
    }  # fmt: skip
    assert "a < b – 1.5 µm at 2 µm" in shown
    assert f"json: {target}" in shown
    page = (tmp_path / "o" / "reproduce.html").read_text(encoding="utf-8")
    page = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    for text in ("X99 table 9.9: T", "a &lt; b", "at 2 µm", "Note on 3 µm.", "versions"):
        assert text in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#|data:)", page)


def test_quiet_says_nothing(drop_in, monkeypatch, capsys, tmp_path):
    drop_in("table-9.9", ONE)
    assert call(monkeypatch, capsys, "9.9", "-q", "--out", tmp_path) == (0, "", "")


def test_an_item_that_fails_does_not_keep_the_others(drop_in, monkeypatch, capsys, tmp_path):
    drop_in("table-9.8", "raise SteadytipError('too bad')")
    drop_in("table-9.9", ONE)
    target = tmp_path / "r.json"
    code, shown, _ = call(monkeypatch, capsys, "dropped", "--json", target, "--out", tmp_path / "o")
    assert code == 1
    assert "ended early: too bad" in shown
    assert len(json.loads(target.read_text())) == 1
    assert "Ended early: too bad" in (tmp_path / "o" / "reproduce.html").read_text("utf-8")


def test_items_without_their_recordings_are_skipped_and_say_so(
    drop_in, monkeypatch, capsys, tmp_path
):
    drop_in("table-9.8", "return ItemResult(notes=(str(context.recordings('hands').name),))",
            recordings=("hands",))  # fmt: skip
    drop_in("table-9.9", ONE)
    code, shown, _ = call(monkeypatch, capsys, "dropped", "--out", tmp_path / "o")
    assert code == 0
    assert "skipped: it needs the recordings hands, and no folder of recordings is given" in shown
    assert "q 2 1.5" in shown
    code, _, err = call(monkeypatch, capsys, "9.8", "--out", tmp_path / "o")
    assert code == 2
    assert "table-9.8 needs the recordings hands" in err
    assert "--data FOLDER" in err
    code, _, err = call(monkeypatch, capsys, "9.8", "--data", tmp_path, "--out", tmp_path / "o")
    assert code == 2
    assert f"{tmp_path} does not hold them" in err
    code, _, err = call(monkeypatch, capsys, "9.8", "--data", tmp_path / "no")
    assert code == 2
    assert "there is no such folder" in err
    (tmp_path / "hands").mkdir()
    code, shown, _ = call(monkeypatch, capsys, "9.8", "--data", tmp_path, "--out", tmp_path / "o")
    assert code == 0
    assert "hands" in shown
    assert "skipped" not in shown


def test_recordings_that_are_not_there_are_named():
    with pytest.raises(SteadytipError, match="'hands': there is no folder; give theirs with"):
        Context().recordings("hands")


def test_progress_is_told_by_the_item():
    from harness.reproduce.engine import run_items

    told = []

    def run(context):
        context.progress(0.5, "half")
        return ItemResult()

    item = Item("a", "A04 x", "t", "g", run)
    (done,) = run_items([item], None, lambda item, share, what: told.append((share, what)))
    assert told == [(0.0, ""), (0.5, "half")]
    assert not done.error


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_that_are_not_finite_are_no_figures(value):
    with pytest.raises(SteadytipError, match=r"'measured' = .* must be finite"):
        Figure("A04 x", "q", "", None, value, "s")


def test_cells_are_for_people():
    figure = Figure("A04 x", "q", "um/us", 20.0, 22.16049, "15 um in 50 us, volume")
    assert figure_table([figure]).rows[0] == ("q", "20", "22.16", "µm/µs", "15 µm in 50 µs, volume")


def test_an_unwritable_file_is_the_users_mistake(drop_in, monkeypatch, capsys, tmp_path):
    drop_in("table-9.9", ONE)
    (tmp_path / "file").write_text("")
    code, _, err = call(monkeypatch, capsys, "9.9", "--out", tmp_path / "file")
    assert code == 2
    assert "cannot be written" in err
