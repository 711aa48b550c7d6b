"""The ring: what is read is what was written, whole and in order, whatever the writer does."""

import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.common.errors import RecordError
from harness.hil.ring import Ring, memory_folder
from harness.parts.ports import Column

STEP = 1e-3


def columns(count: int) -> list[Column]:
    return [Column(f"part.port_{i}", "Real", "m", f"signal {i}") for i in range(count)]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "loop.ring"


def test_columns_come_back(path) -> None:
    given = [Column("hand.tip_x", "Real", "µm", "tip"), Column("feed.valid", "Boolean", "", "")]
    Ring.create(path, given, 2e-3, capacity=5)
    ring = Ring.open(path)
    assert ring.columns == tuple(given)
    assert ring.names == ("hand.tip_x", "feed.valid")
    assert (ring.step, ring.capacity, ring.written, ring.closed) == (2e-3, 5, 0, False)


@settings(max_examples=60)
@given(
    capacity=st.integers(2, 9),
    written=st.integers(0, 40),
    wanted=st.integers(0, 12),
    taken=st.none() | st.lists(st.integers(0, 2), min_size=1, max_size=4),
)
def test_the_latest_rows_are_a_list_s_tail(tmp_path_factory, capacity, written, wanted, taken):
    """Of a full ring one row less: the writer may be at its place already."""
    path = tmp_path_factory.getbasetemp() / "tail.ring"
    writer = Ring.create(path, columns(3), STEP, capacity)
    rows = np.arange(3.0 * written).reshape(written, 3)
    for row in rows:
        writer.append(row)
    ticks, values = Ring.open(path).latest(wanted, taken)
    whole = max(0, written - min(wanted, capacity if written < capacity else capacity - 1))
    np.testing.assert_array_equal(ticks, np.arange(whole, written))
    np.testing.assert_array_equal(values, rows[whole:][:, [0, 1, 2] if taken is None else taken])


def test_closing_is_told_and_what_was_read_stays(path) -> None:
    writer = Ring.create(path, columns(2), STEP, capacity=4)
    writer.append(np.array([1.0, 2.0]))
    reader = Ring.open(path)
    _, before = reader.latest(1)
    writer.append(np.array([3.0, 4.0]))
    writer.close()
    assert reader.closed
    assert before.tolist() == [[1.0, 2.0]]
    assert reader.latest(9)[1].tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_a_reader_cannot_write(path) -> None:
    Ring.create(path, columns(2), STEP)
    reader = Ring.open(path)
    with pytest.raises(ValueError, match="read-only"):
        reader._rows[0, 0] = 1.0
    with pytest.raises(TypeError, match="read-only"):
        reader._words[0] = 1


WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from harness.hil.ring import Ring
from harness.parts.ports import Column

columns = [Column(f"part.port_{i}", "Real", "", "") for i in range(int(sys.argv[2]))]
writer = Ring.create(Path(sys.argv[1]), columns, 1e-3, capacity=int(sys.argv[3]))
row = np.empty(len(columns))
end = time.monotonic() + float(sys.argv[4])
while time.monotonic() < end:
    for _ in range(1000):
        row.fill(writer.written)
        writer.append(row)
writer.close()
"""


@pytest.mark.parametrize(("width", "capacity"), [(8, 16), (120, 512)])
def test_no_torn_row_is_returned(path, width, capacity) -> None:
    """A writer without a pause laps the reader again and again; every value is its row's number.

    Expected: rows overwritten during the copy are left out, the others are whole and in order.
    """
    arguments = [str(path), str(width), str(capacity), "1.5"]
    writer = subprocess.Popen([sys.executable, "-c", WRITER, *arguments])
    reader = Ring.open(path, wait=20.0)
    looks = rows = lapped = 0
    newest = -1
    while not reader.closed:
        ticks, values = reader.latest(capacity)
        assert (values == ticks[:, np.newaxis]).all()
        assert (np.diff(ticks) == 1).all()
        assert ticks.size == 0 or ticks[-1] >= newest
        newest = ticks[-1] if ticks.size else newest
        looks, rows, lapped = looks + 1, rows + len(ticks), lapped + (len(ticks) < capacity - 1)
    assert writer.wait(10) == 0
    # How often one overtakes the other is up to the machine; without it nothing was shown.
    if min(looks - 500, rows - 1000, lapped - 20) < 0:
        pytest.skip(f"{looks} looks, {rows} rows, overtaken {lapped} times: too few to tell")


def test_waiting_for_the_writer(path) -> None:
    code = f"import time; time.sleep(0.3)\n{WRITER}"
    arguments = [str(path), "2", "8", "0"]
    with subprocess.Popen([sys.executable, "-c", code, *arguments]):
        assert Ring.open(path, wait=20.0).names == ("part.port_0", "part.port_1")


def test_a_missing_ring_is_told(path) -> None:
    with pytest.raises(SteadytipError, match=r"there is no ring .*loop.ring; is its writer"):
        Ring.open(path)
    begun = time.monotonic()
    with pytest.raises(SteadytipError, match=r"within 0.1 s"):
        Ring.open(path, wait=0.1)
    assert time.monotonic() - begun < 2.0


def test_a_folder_that_takes_no_file(tmp_path) -> None:
    with pytest.raises(RecordError, match=r"cannot make the ring .*: No such file"):
        Ring.create(tmp_path / "missing" / "loop.ring", columns(1), STEP)


def test_another_version_is_told(path) -> None:
    Ring.create(path, columns(1), STEP)
    data = bytearray(path.read_bytes())
    data[8] = 7
    path.write_bytes(data)
    with pytest.raises(SteadytipError, match=r"ring of version 7; this reads 1. Take the same"):
        Ring.open(path)


@settings(max_examples=150)
@given(data=st.data())
def test_a_damaged_file_is_a_clear_error(tmp_path_factory, data) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.ring"
    Ring.create(path, columns(2), STEP, capacity=4)
    content = bytearray(path.read_bytes())
    head = 192 + 100
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, head))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.none() | st.integers(0, len(content)))
    path.write_bytes(content[:cut])
    try:
        ring = Ring.open(path)
    except SteadytipError:
        return
    ticks, values = ring.latest(3)
    assert values.shape == (len(ticks), len(ring.columns))


def test_rings_belong_in_memory() -> None:
    assert memory_folder().is_dir()
