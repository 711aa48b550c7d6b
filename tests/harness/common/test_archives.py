"""Archives and XML from elsewhere: nothing outside the folder, without end, or as a traceback."""

import io
import stat
import struct
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.common import archives
from harness.common.archives import ArchiveError, extract, members, read
from harness.common.errors import FaultError
from harness.common.xml_files import parse_xml
from harness.parts.description import describe
from harness.parts.fmi import Instance, unpack
from tests.harness.conftest import HERE, PackProbe


def packed(path: Path, *entries: tuple[str | zipfile.ZipInfo, bytes], **more) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, **more) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return path


def everything_below(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def test_a_good_archive_comes_out_as_it_went_in(tmp_path):
    path = packed(tmp_path / "a.zip", ("a.txt", b"one"), ("sub/b.txt", b"two"), ("empty/", b""))
    assert extract(path, tmp_path / "out") == ["a.txt", "sub/b.txt"]
    assert (tmp_path / "out" / "sub" / "b.txt").read_bytes() == b"two"
    assert (tmp_path / "out" / "empty").is_dir()
    assert members(path) == ["a.txt", "sub/b.txt"]
    assert read(path, "sub/b.txt") == b"two"


def link(name: str, target: str) -> tuple[zipfile.ZipInfo, bytes]:
    info = zipfile.ZipInfo(name)
    info.create_system = 3
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info, target.encode()


HOSTILE = {
    "../evil": "'..' step",
    "a/../../evil": "'..' step",
    "/etc/evil": "absolute",
    "C:/evil": "character",
    "..\\evil": "character",
    "a\\..\\..\\evil": "character",
    "a//b": "empty, '.' or '..'",
    "./a": "empty, '.' or '..'",
    "a/NUL.txt": "Windows",
    "aux": "Windows",
    "a. /b": "Windows",
    "b\x01": "character",
    "what?": "character",
}


def test_what_is_not_wanted_is_judged_all_the_same(tmp_path):
    path = packed(tmp_path / "a.zip", ("a.txt", b"one"), ("b.txt", b"two"))
    assert extract(path, tmp_path / "out", wanted=lambda name: name == "b.txt") == ["b.txt"]
    assert everything_below(tmp_path / "out") == {"b.txt"}
    path = packed(tmp_path / "b.zip", ("a.txt", b"one"), ("../b.txt", b"two"))
    with pytest.raises(ArchiveError, match="step in its path"):
        extract(path, tmp_path / "other", wanted=lambda name: name == "a.txt")


def test_a_run_unpacks_only_what_it_needs(pack_probe: PackProbe, tmp_path):
    path = pack_probe()
    with zipfile.ZipFile(path, "a") as archive:
        for name in ("documentation/a.html", "sources/a.c", "binaries/vax64/a.so"):
            archive.writestr(name, b"not needed")
        for name in ("resources/table.csv", "extra/tool/settings.xml", "binaries/readme.txt"):
            archive.writestr(name, b"perhaps needed")
    description = describe(path)
    folder = unpack(description, tmp_path)
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert names == {
        *("modelDescription.xml", "resources/table.csv", "extra/tool/settings.xml"),
        description.binary(),
    }


@pytest.mark.parametrize(("name", "text"), HOSTILE.items())
def test_names_that_lead_elsewhere_are_refused_before_anything_is_written(name, text, tmp_path):
    path = packed(tmp_path / "a.zip", ("good.txt", b"good"), (name, b"evil"))
    with pytest.raises(ArchiveError, match=text):
        extract(path, tmp_path / "out")
    assert everything_below(tmp_path) == {"a.zip"}
    with pytest.raises(ArchiveError, match=text):
        members(path)


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        ("a.txt", "A.TXT", "one file where case"),
        ("caf\u00e9", "cafe\u0301", "one file where case"),
        ("a", "a/b", "a file and a folder"),
    ],
)
def test_two_members_on_one_place_are_refused(first, second, text, tmp_path):
    path = packed(tmp_path / "a.zip", (first, b"1"), (second, b"2"))
    with pytest.raises(ArchiveError, match=text):
        extract(path, tmp_path / "out")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_one_name_twice_is_refused(tmp_path):
    path = packed(tmp_path / "a.zip", ("a", b"1"), ("a", b"2"))
    with pytest.raises(ArchiveError, match="'a' and 'a' are one file"):
        extract(path, tmp_path / "out")


def test_links_are_refused(tmp_path):
    path = packed(tmp_path / "a.zip", link("door", "/etc"), ("door/passwd", b"evil"))
    with pytest.raises(ArchiveError, match="'door' is a link or a device"):
        extract(path, tmp_path / "out")


def test_other_compression_is_refused(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a", b"1" * 1000)
    with pytest.raises(ArchiveError, match="method 14; use 0"):
        extract(path, tmp_path / "out")


def test_a_bomb_that_admits_its_size_is_refused(tmp_path):
    path = packed(tmp_path / "a.zip", ("zeros", bytes(4 * 2**20)))
    assert path.stat().st_size < 10_000
    with pytest.raises(ArchiveError, match="more than 1048576 bytes"):
        extract(path, tmp_path / "out", most_bytes=2**20)
    assert not (tmp_path / "out").exists()
    with pytest.raises(ArchiveError, match="more than 100 bytes"):
        read(path, "zeros", most_bytes=100)


def test_a_bomb_that_lies_about_its_size_is_stopped(tmp_path):
    path = packed(tmp_path / "a.zip", ("zeros", bytes(4 * 2**20)))
    content = bytearray(path.read_bytes())
    # Uncompressed size in the central directory, 24 bytes behind its signature.
    at = content.index(b"PK\x01\x02") + 24
    content[at : at + 4] = struct.pack("<I", 1000)
    path.write_bytes(content)
    with pytest.raises(ArchiveError):
        extract(path, tmp_path / "out", most_bytes=2**20)
    assert not (tmp_path / "out").exists()


def test_too_many_members_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "MOST_MEMBERS", 3)
    path = packed(tmp_path / "a.zip", *((f"{n}", b"") for n in range(4)))
    with pytest.raises(ArchiveError, match="4 members, more than 3"):
        extract(path, tmp_path / "out")


def test_nothing_is_written_into_a_folder_that_holds_something(tmp_path):
    path = packed(tmp_path / "a.zip", ("a", b"1"))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("keep")
    with pytest.raises(ArchiveError, match="not an empty folder"):
        extract(path, tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "keep"


def test_a_damaged_member_leaves_an_empty_folder_empty(tmp_path):
    path = packed(tmp_path / "a.zip", ("good", b"good"), ("bad", bytes(range(256)) * 40))
    content = bytearray(path.read_bytes())
    content[content.index(b"bad") + 30] ^= 0xFF
    path.write_bytes(content)
    (tmp_path / "out").mkdir()
    with pytest.raises(ArchiveError):
        extract(path, tmp_path / "out")
    assert everything_below(tmp_path / "out") == set()


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_the_bytes_are_it_is_an_archive_or_refused(data, tmp_path_factory):
    """Bytes of a good archive are replaced at random."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/one.txt", b"one" * 50)
        archive.writestr("two.txt", b"two")
    content = bytearray(memory.getvalue())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "a.zip"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        names = extract(path, folder / "out" / "in", most_bytes=10_000)
    except ArchiveError:
        names = []
    assert {entry.name for entry in folder.iterdir()} <= {"a.zip", "out"}
    for name in names:
        assert (folder / "out" / "in" / name).resolve().is_relative_to(folder / "out" / "in")


# ---- XML ----------------------------------------------------------------------------------------

LAUGHS = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "ha"}">' for n in range(12))


@pytest.mark.parametrize(
    "text",
    [
        f"<!DOCTYPE a [{LAUGHS}]><a>&e11;</a>",
        f'<!DOCTYPE a [{LAUGHS}]><a b="&e11;"/>',
        '<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]><a>&e;</a>',
        '<!DOCTYPE a SYSTEM "http://localhost/a.dtd"><a/>',
        "<!-- a --><?pi?><!DOCTYPE a><a/>",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_document_type_is_refused_in_any_encoding(text, encoding):
    with pytest.raises(SteadytipError, match=r"x\.xml has a document type declaration"):
        parse_xml(text.encode(encoding), "x.xml")


@pytest.mark.parametrize(
    "content",
    [b"", b"text", b"<a>", b"<a/><b/>", b"<a>&e;</a>", b"\xff\xfe\x00", b"<a>\x00</a>"],
)
def test_what_is_no_xml_is_refused(content):
    with pytest.raises(SteadytipError, match=r"x\.xml is not well-formed XML"):
        parse_xml(content, "x.xml")


def test_depth_and_size_have_an_end(monkeypatch):
    with pytest.raises(SteadytipError):
        parse_xml(b"<a>" * 100_000 + b"</a>" * 100_000, "deep.xml")
    monkeypatch.setattr("harness.common.xml_files.MOST_BYTES", 10)
    with pytest.raises(SteadytipError, match=r"long\.xml is larger than 10 bytes"):
        parse_xml(b"<a>1234567</a>", "long.xml")


@settings(max_examples=300)
@given(st.binary(max_size=200))
def test_whatever_the_bytes_are_it_is_xml_or_refused(content):
    for text in (content, b"<a>" + content + b"</a>"):
        try:
            parse_xml(text, "x.xml")
        except SteadytipError:
            continue


# ---- FMUs ---------------------------------------------------------------------------------------


def hostile_fmu(path: Path, *entries: tuple[str | zipfile.ZipInfo, bytes]) -> Path:
    return packed(path, ("modelDescription.xml", (HERE / "probe.xml").read_bytes()), *entries)


@pytest.mark.parametrize("name", ["../evil", "/evil", "MODELDESCRIPTION.xml", "a\\b"])
def test_a_hostile_fmu_is_not_even_described(name, tmp_path):
    path = hostile_fmu(tmp_path / "evil.fmu", (name, b"evil"))
    with pytest.raises(SteadytipError, match=r"evil\.fmu is not an FMU"):
        describe(path)


def test_entities_in_a_description_are_refused(tmp_path):
    xml = (HERE / "probe.xml").read_text()
    head, rest = xml.split("\n", 1)
    path = tmp_path / "evil.fmu"
    packed(path, ("modelDescription.xml", f"{head}\n<!DOCTYPE a [{LAUGHS}]>\n{rest}".encode()))
    with pytest.raises(SteadytipError, match=r"evil\.fmu: modelDescription\.xml has a document ty"):
        describe(path)


def test_an_fmu_that_changes_after_it_was_read_is_judged_again(pack_probe: PackProbe, tmp_path):
    path = pack_probe()
    description = describe(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("../evil", b"evil")
    work = tmp_path / "work"
    work.mkdir()
    with pytest.raises(FaultError, match=r"'\.\.' step"):
        Instance(description, "part", work)
    assert everything_below(work) == set()
    assert not (tmp_path / "evil").exists()
