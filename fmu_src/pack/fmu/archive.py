"""FMU archives: plain zip, fixed order and times, so that equal content gives equal bytes."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

from fmu_src.pack.cache import write as write_file

_EPOCH = (1980, 1, 1, 0, 0, 0)


def pack(files: Mapping[str, bytes]) -> bytes:
    """Pack files into an archive and return its bytes.

    Args:
        files: contents by name in the archive.
    """
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        # The description first: importers that stream find it at once.
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, whatever system this is
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name])
    return content.getvalue()


def write(path: Path, files: Mapping[str, bytes]) -> None:
    """Write an archive in one go; see `cache.write`."""
    write_file(path, pack(files))


def read(path: Path) -> dict[str, bytes]:
    """Read all files of an archive, by name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
