"""Zip archives from elsewhere: FMUs (`.fmu`) and systems (`.ssp`), unpacked without trust.

What an archive may not do here: write outside its folder, write one file twice, make links or
devices, use names that another platform reads differently, or fill the disk. The whole list of
members is judged before the first byte is written, and the bytes are counted while they come,
because the sizes that an archive declares are only a claim.
"""

from __future__ import annotations

import re
import shutil
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from fmu_src.errors import SteadytipError

__all__ = ["ArchiveError", "extract", "members", "read", "troubles"]

MOST_BYTES = 2**30
"""What an archive may unpack to, in all [byte]."""
MOST_MEMBERS = 20_000
"""Files and folders in an archive."""

_BLOCK = 2**20
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_ENCRYPTED = 0x1
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError),
    *(NotImplementedError, RuntimeError, ValueError, OverflowError),
)
"""What zipfile raises on damaged, encrypted or exotic archives."""


class ArchiveError(SteadytipError):
    """An archive that is damaged, or that is not unpacked because of what it holds."""


def extract(
    path: Path,
    folder: Path,
    *,
    most_bytes: int = MOST_BYTES,
    wanted: Callable[[str], bool] = lambda _: True,
) -> list[str]:
    """Unpack an archive.

    Args:
        path: the archive.
        folder: where to; new or empty. After a failure it is as it was before.
        most_bytes: limit of the unpacked size in all [byte].
        wanted: whether a member is unpacked, by name; all are judged.

    Returns:
        Names of the files, with `/` between folders, in the archive's order.

    Raises:
        ArchiveError: no archive, damaged, larger than the limit, or with a member that is refused;
            or the folder is not empty, or the disk full.
    """
    existed = folder.exists()
    if existed and (not folder.is_dir() or any(folder.iterdir())):
        raise ArchiveError(f"{path} is not unpacked: {folder} is not an empty folder")
    try:
        with zipfile.ZipFile(path) as archive:
            infos = [i for i in _checked(path, archive, most_bytes) if wanted(i.filename)]
            folder.mkdir(parents=True, exist_ok=True)
            left = most_bytes
            for info in infos:
                target = folder.joinpath(*info.filename.split("/"))
                if info.is_dir():
                    target.mkdir(parents=True, exist_ok=True)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                with target.open("xb") as file:
                    for block in _blocks(path, archive, info, left):
                        file.write(block)
                        left -= len(block)
            return [info.filename for info in infos if not info.is_dir()]
    except (*_DAMAGE, SteadytipError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        if existed:
            folder.mkdir(exist_ok=True)
        if isinstance(error, ArchiveError):
            raise
        raise ArchiveError(f"{path} cannot be unpacked: {_reason(error)}") from None


def members(path: Path, *, most_bytes: int = MOST_BYTES) -> list[str]:
    """Names of the files of an archive, judged as `extract` judges them.

    Raises:
        ArchiveError: as for `extract`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            infos = _checked(path, archive, most_bytes)
            return [info.filename for info in infos if not info.is_dir()]
    except _DAMAGE as error:
        raise ArchiveError(f"{path} is no zip archive: {_reason(error)}") from None


def read(path: Path, member: str, *, most_bytes: int = MOST_BYTES) -> bytes:
    """One file of an archive.

    Args:
        path: the archive.
        member: name of the file in it.
        most_bytes: limit of that file's unpacked size [byte].

    Raises:
        ArchiveError: no archive, damaged, no such member, or larger than the limit.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if member not in archive.namelist():
                raise ArchiveError(f"{path}: {member} is missing in the archive")
            return b"".join(_blocks(path, archive, archive.getinfo(member), most_bytes))
    except _DAMAGE as error:
        raise ArchiveError(f"{path}: {member} cannot be read: {_reason(error)}") from None


def troubles(infos: list[zipfile.ZipInfo]) -> Iterator[str]:
    """Yield what is wrong with the members of an archive, one sentence each."""
    seen: dict[str, str] = {}
    folders: set[str] = set()
    for info in infos:
        name = info.orig_filename
        why = _name_trouble(name) or _kind_trouble(info)
        if why:
            yield f"member {name[:200]!r} {why}"
            continue
        # Windows and macOS do not tell upper from lower case, nor the forms of an accent.
        key = unicodedata.normalize("NFC", name).casefold().rstrip("/")
        if key in seen:
            yield f"members {seen[key]!r} and {name!r} are one file where case does not count"
        seen[key] = name
        parts = key.split("/")
        folders.update("/".join(parts[:n]) for n in range(1, len(parts)))
    for key, name in seen.items():
        if key in folders and not name.endswith("/"):
            yield f"member {name!r} is a file and a folder at once"


def _checked(path: Path, archive: zipfile.ZipFile, most_bytes: int) -> list[zipfile.ZipInfo]:
    infos = archive.infolist()
    if len(infos) > MOST_MEMBERS:
        raise ArchiveError(f"{path} holds {len(infos)} members, more than {MOST_MEMBERS}")
    found = next(troubles(infos), None)
    if found:
        raise ArchiveError(f"{path} is not unpacked: {found}")
    claimed = sum(info.file_size for info in infos)
    if claimed > most_bytes:
        raise _too_large(path, most_bytes)
    return infos


def _name_trouble(name: str) -> str:
    if not name or name.startswith("/"):
        return "has an absolute or empty name"
    if _FORBIDDEN.search(name):
        return 'has a name with a character that not every platform allows (\\ : * ? " < > |)'
    for part in name.removesuffix("/").split("/"):
        if part in {"", ".", ".."}:
            return "has an empty, '.' or '..' step in its path"
        if part[-1] in ". " or _DEVICES.fullmatch(part):
            return "has a name that Windows does not allow"
    return ""


def _kind_trouble(info: zipfile.ZipInfo) -> str:
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in {0, stat.S_IFREG, stat.S_IFDIR}:
        return "is a link or a device"
    if info.flag_bits & _ENCRYPTED:
        return "is encrypted"
    if info.compress_type not in _METHODS:
        return f"is compressed by method {info.compress_type}; use 0 (stored) or 8 (deflated)"
    return ""


def _blocks(
    path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, most_bytes: int
) -> Iterator[bytes]:
    """Content of a member, counted as it comes."""
    left = most_bytes
    with archive.open(info) as file:
        while block := file.read(_BLOCK):
            left -= len(block)
            if left < 0:
                raise _too_large(path, most_bytes)
            yield block


def _too_large(path: Path, most_bytes: int) -> ArchiveError:
    return ArchiveError(f"{path} unpacks to more than {most_bytes} bytes, the limit here")


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
