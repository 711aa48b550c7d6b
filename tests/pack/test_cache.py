"""What was made before: found again whole or not at all, and never too much of it."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.pack import cache as store


def never() -> bytes:
    raise AssertionError("it was made before")


def test_it_is_made_once(tmp_path):
    assert store.recall(tmp_path, "a", lambda: b"content") == b"content"
    assert store.recall(tmp_path, "a", never) == b"content"
    assert store.recall(tmp_path, "b", lambda: b"") == b""
    assert store.recall(tmp_path, "b", never) == b""


@given(content=st.binary(max_size=200), data=st.data())
def test_whatever_is_damaged_or_cut_off_is_made_again(content, data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    store.recall(folder, "a", lambda: content)
    (file,) = folder.iterdir()
    damaged = bytearray(file.read_bytes())
    at = data.draw(st.integers(0, len(damaged)))
    if at == len(damaged):
        damaged += b"more"
    elif data.draw(st.booleans()):
        del damaged[at:]
    else:
        damaged[at] ^= data.draw(st.integers(1, 255))
    file.write_bytes(damaged)
    assert store.recall(folder, "a", lambda: b"again") == b"again"
    assert store.recall(folder, "a", never) == b"again"
    assert len([*folder.iterdir()]) == 1


def test_what_was_used_longest_ago_goes_first(tmp_path):
    for age, key in ((400, "old"), (300, "older but used"), (200, "young")):
        store.recall(tmp_path, key, lambda: bytes(1000))
        file = store.find(tmp_path, key)
        then = file.stat().st_mtime - age
        os.utime(file, (then, then))
    store.recall(tmp_path, "older but used", never)
    store.recall(tmp_path, "new", lambda: bytes(1000), most_bytes=3000)
    assert {file.name.partition("-")[0] for file in tmp_path.iterdir()} == {
        "older but used",
        "young",
        "new",
    }


def test_where_nothing_can_be_kept_it_is_made_each_time(tmp_path):
    (tmp_path / "file").write_text("no folder")
    for content in (b"one", b"two"):
        assert store.recall(tmp_path / "file", "a", lambda content=content: content) == content


def test_what_cannot_be_made_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError):
        store.recall(tmp_path, "a", lambda: bytes(1 // 0))
    assert list(tmp_path.iterdir()) == []


def test_several_at_once_get_the_same(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        found = pool.map(
            lambda k: store.recall(tmp_path, str(k % 2), lambda: b"%d" % (k % 2), most_bytes=1),
            range(200),
        )
        assert list(found) == [b"%d" % (k % 2) for k in range(200)]
    assert len(list(tmp_path.iterdir())) <= 2


def test_a_file_is_found_by_key_and_ending(tmp_path):
    path = store.keep(tmp_path, "a", lambda: b"library", ".so", mode=0o755)
    assert path.read_bytes() == b"library"
    assert store.keep(tmp_path, "a", never, ".so") == path
    assert store.keep(tmp_path, "a", lambda: b"other", ".dll") != path
    with pytest.raises(OSError, match="file"):
        store.keep(path / "folder", "a", lambda: b"file")
