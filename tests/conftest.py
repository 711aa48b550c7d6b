"""Shared fixtures: where the recordings are."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the recordings, from STEADYTIP_DATA or beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STEADYTIP_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no recordings: {folder} does not exist; set STEADYTIP_DATA to their folder")
    return folder
