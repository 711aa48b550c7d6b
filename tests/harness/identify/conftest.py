"""The command as a fixture."""

import pytest

from tests.harness.identify.commands import Identify


@pytest.fixture
def identify(monkeypatch, capsys):
    return Identify(monkeypatch, capsys)
