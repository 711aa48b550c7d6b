"""Where a system stands: an unpacked archive, a document in it, and files beside that."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from fmu_src.errors import SteadytipError
from harness.parts import ssp_markup as markup

__all__ = ["Place", "named"]


@dataclass(frozen=True)
class Place:
    """A system structure description in an unpacked archive.

    Attributes:
        home: folder of the archive's content.
        ssd: name of the document in the archive.
        where: name of the archive for messages.
        seen: references that led here, from the outside to the inside.
    """

    home: Path
    ssd: str
    where: str
    seen: tuple[str, ...] = ()

    def root(self) -> Any:
        """Root element of the document.

        Raises:
            SteadytipError: it is missing, hostile, or against the schema.
        """
        file = self.home / self.ssd
        if not file.is_file():
            raise SteadytipError(f"{self.where} is no SSP archive: {self.ssd} is missing")
        return markup.read(file.read_bytes(), "ssd", f"{self.where}: {self.ssd}")

    def file(self, source: str, path: tuple[str, ...]) -> Path:
        """Return a file of the archive.

        Args:
            source: URI that names it, relative to the document.
            path: names of the element that the URI stands at, for messages.

        Raises:
            SteadytipError: the URI leaves the archive, or there is no such file.
        """
        what = f"{self.where}: source '{source}' of '{'.'.join(path)}'"
        try:
            parts = urlsplit(source)
            steps = PurePosixPath(unquote(parts.path)).parts
            if parts.scheme or parts.netloc or "\\" in source or {"/", ".."} & set(steps):
                raise SteadytipError(f"{what} leaves the archive; only files inside are read")
            file = self.home.joinpath(PurePosixPath(self.ssd).parent, *steps)
            found = file.is_file()
        except (ValueError, OSError):  # no URI at all, or a name that no file can have
            found = False
        if not found:
            raise SteadytipError(f"{what} is missing in the archive")
        return file


def named(error: SteadytipError, file: Path, where: str) -> SteadytipError:
    """Return an error that speaks of a file by its name in the archive, not in the workspace."""
    return SteadytipError(str(error).replace(str(file), where))
