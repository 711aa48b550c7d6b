"""The command `steadytip identify` as a user calls it, and the tables that it reads."""

import re
import sys
from pathlib import Path

import numpy as np

from fmu_src.kit.runner import Runner
from harness.cli.main import main
from plants import piezo_stack


class Identify:
    """Calls `steadytip identify KIND`."""

    def __init__(self, monkeypatch, capsys):
        self.monkeypatch, self.capsys = monkeypatch, capsys

    def __call__(self, kind: str, *arguments) -> tuple[int, str, str]:
        """Exit code, output, errors; blanks made single."""
        self.monkeypatch.setattr(sys, "argv", ["steadytip", "identify", kind, *map(str, arguments)])
        self.monkeypatch.setenv("COLUMNS", "200")
        try:
            main()
            code = 0
        except SystemExit as ended:
            code = int(ended.code or 0)
        shown = self.capsys.readouterr()
        return code, re.sub(r"\s+", " ", shown.out), re.sub(r"\s+", " ", shown.err)

    def accepts(self, kind: str, *arguments) -> str:
        """Output of a call that ends with 0 and without errors."""
        code, shown, errors = self(kind, *arguments)
        assert (code, errors) == (0, "")
        return shown

    def refuses(self, kind: str, *arguments) -> str:
        """Errors of a call that ends with 2 and without a traceback."""
        code, _, errors = self(kind, *arguments)
        assert code == 2, arguments
        assert "Traceback" not in errors
        return errors


def plant_response(volts: np.ndarray, rate: float) -> np.ndarray:
    """Stroke of the plant at the end of each sample that a voltage is held."""
    substeps = round(1 / (rate * piezo_stack.MODEL.sample_period))
    held = {"volts": np.repeat(volts, substeps)}
    run = Runner(piezo_stack.MODEL).run(substeps * len(volts), held)
    return run["stroke"][substeps - 1 :: substeps]


def write_csv(path: Path, table: np.ndarray, headings, form="%.9g") -> Path:
    np.savetxt(path, table, form, ",", header=",".join(headings), comments="")
    return path
