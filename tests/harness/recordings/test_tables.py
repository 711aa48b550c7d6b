"""The one reader of tables: columns that nobody asks for do no harm."""

import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from harness.recordings.motion import read_recording
from harness.recordings.tables import TIME, find_columns, read_table

T = np.arange(300) / 250


def _write(path, heading, row):
    lines = [heading, *(row.format(t=t, x=0.1 * t, k=k) for k, t in enumerate(T.tolist()))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("heading", "row"),
    [
        ("time [s],x [mm],y [mm],z [mm],note", "{t},{x},{x},{x},at {k}"),
        ("time [s],x [mm],y [mm],z [mm],grip", "{t},{x},{x},{x},"),
        ("time [s],x [mm],y [mm],z [mm],", "{t},{x},{x},{x},{k}"),
        ("x_m,time [s],x [mm],y [mm],z [mm]", "{k},{t},{x},{x},{x}"),
        ("x_filtered [mm];time [s];x [mm];y [mm];z [mm]", "{k};{t};{x};{x};{x}"),
        ("# bench 3\n# time [s]\tx_mm\ty_mm\tz_mm", "{t}\t{x}\t{x}\t{x}"),
    ],
)
def test_hand_motion_is_found_among_other_columns(tmp_path, heading, row):
    hand = read_recording(_write(tmp_path / "r.csv", heading, row))
    np.testing.assert_allclose(hand.time, T)
    np.testing.assert_allclose(hand.position, 1e-4 * T[:, None] * [1, 1, 1])


def test_a_cell_without_a_number_matters_in_a_column_that_is_used(tmp_path):
    path = _write(tmp_path / "r.csv", "time [s],volts [V],note", "{t},{x},{k}")
    path.write_text(path.read_text().replace(",7\n", ",bad\n"))
    table = read_table(path)
    assert find_columns(table, [TIME])["time"].index == 0
    with pytest.raises(SteadytipError, match=r"line 9, column 3 \('note'\): 'bad' is not a number"):
        table.numbers(2)
