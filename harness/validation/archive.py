"""The archive: items A1 to A7."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from pathlib import PurePosixPath

from harness.common.archives import ArchiveError, members, troubles
from harness.validation.checks import FILES, Note, Skip
from harness.validation.files import DESCRIPTION, Fmu

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LONGEST_IDENTIFIER = 32
_LONGEST_PATH = 180
"""Windows allows 260 characters; an importer's folder for the FMU takes the rest."""
_NEWEST_ZIP = 20
"""`version needed to extract` of zip 2.0: folders and deflate."""
_PNG = b"\x89PNG\r\n\x1a\n"
_HEADERS = {"fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"}
_FOLDERS = {
    *("win32", "win64", "linux32", "linux64", "darwin64"),
    *("aarch64-darwin", "aarch64-linux", "aarch64-windows", "x86_64-linux", "x86_64-windows"),
    *("x86_64-darwin",),
}
_STANDARD_EXTRAS = {"org.fmi-standard.fmi-ls-ref", "org.fmi-standard.fmi-ls-xcp"}
_DATA_DESCRIPTOR = 0x8


@FILES.check("A1.archive", "error", "the archive can be unpacked without danger")
def _archive(fmu: Fmu) -> Iterator[str]:
    yield from troubles(fmu.infos)
    try:
        members(fmu.path)
    except ArchiveError as error:
        yield str(error)


@FILES.check("A1.format", "warning", "a plain zip: stored or deflated, version 2.0, ending .fmu")
def _format(fmu: Fmu) -> Iterator[str]:
    if fmu.path.suffix != ".fmu":
        yield f"the file is called {fmu.path.name}, it should end in .fmu"
    for info in fmu.infos:
        if info.extract_version > _NEWEST_ZIP:
            yield f"{info.filename} needs zip {info.extract_version / 10}, more than 2.0"
        if info.flag_bits & _DATA_DESCRIPTOR and info.compress_type == zipfile.ZIP_STORED:
            yield f"{info.filename} is stored with its size behind it, which streams cannot read"


@FILES.check("A2.names", "warning", "names in the archive are ASCII")
def _names(fmu: Fmu) -> Iterator[str]:
    for name in fmu.members:
        if not name.isascii():
            yield f"the name {name!r} is not ASCII"


@FILES.check("A2.prefix", "error", "the FMU's files lie at the root of the archive")
def _prefix(fmu: Fmu) -> Iterator[str]:
    for name in fmu.members:
        if (
            PurePosixPath(name).name == DESCRIPTION
            and name != DESCRIPTION
            and (name.count("/") == 1)
        ):
            yield f"{name} is in a folder; zip the content of the folder, not the folder"


@FILES.check("A3.description", "error", "modelDescription.xml is there, well-formed, in UTF-8")
def _description(fmu: Fmu) -> Iterator[str]:
    encoding = fmu.parsed().getroottree().docinfo.encoding
    if (encoding or "").upper() not in {"UTF-8", "US-ASCII"}:
        yield f"the encoding is {encoding}; declare UTF-8"
    if not fmu.content(DESCRIPTION).lstrip(b"\xef\xbb\xbf").startswith(b"<?xml"):
        yield Note("the XML declaration with the encoding is missing")


@FILES.check("A3.documents", "warning", "icon, documentation and licence are there")
def _documents(fmu: Fmu) -> Iterator[str]:
    for name in (*("model.png", "documentation/index.html", "documentation/licenses/license.txt"),):
        if name not in fmu.members and not (
            name.endswith(".txt") and name.replace(".txt", ".html") in fmu.members
        ):
            yield f"{name} is missing"
    if "model.png" in fmu.members and not fmu.content("model.png").startswith(_PNG):
        yield "model.png is no PNG picture"


@FILES.check("A4.binaries", "error", "binaries have the model identifier's name, in known folders")
def _binaries(fmu: Fmu) -> Iterator[str]:
    binaries = [m.split("/") for m in fmu.members if m.startswith("binaries/")]
    for parts in binaries:
        if len(parts) < 3 or parts[1] not in _FOLDERS:
            yield f"{'/'.join(parts)} is in no folder that importers look into"
    for folder in sorted({parts[1] for parts in binaries if len(parts) > 2}):
        if folder not in fmu.binaries:
            yield f"binaries/{folder} has no library called {fmu.identifier}"
    if not fmu.binaries and not any(m.startswith("sources/") for m in fmu.members):
        yield "there are neither binaries nor sources"
    yield Note(f"for {', '.join(sorted(fmu.binaries)) or 'none'}")


@FILES.check("A4.platforms", "warning", "there are binaries for the platforms of the field")
def _platforms(fmu: Fmu) -> Iterator[str]:
    for folder in ("linux64", "win64", "darwin64"):
        if folder not in fmu.binaries:
            yield f"no binary for {folder}"


@FILES.check("A5.sources", "warning", "sources are complete and listed")
def _sources(fmu: Fmu) -> Iterator[str]:
    sources = {m.removeprefix("sources/") for m in fmu.members if m.startswith("sources/")}
    listed = [file.get("name") for file in fmu.simulation.iterfind("SourceFiles/File")]
    if not sources and not listed:
        raise Skip("there are no sources")
    for name in listed:
        if name not in sources:
            yield f"sources/{name} is listed in SourceFiles and missing in the archive"
    if not listed:
        yield "there are sources, but CoSimulation has no SourceFiles"
    if "buildDescription.xml" not in sources:
        yield "sources/buildDescription.xml is missing (FMI 2.0.4 and later)"
    for name in sorted(sources & _HEADERS):
        yield f"sources/{name} is part of the standard, importers bring their own"
    for name in sorted(sources):
        if name.endswith((".c", ".h")):
            text = fmu.content(f"sources/{name}").decode("utf-8", "replace")
            for header in re.findall(r'^\s*#\s*include\s*"([^"]+)"', text, re.MULTILINE):
                beside = (PurePosixPath(name).parent / header).as_posix()
                if beside not in sources and header not in sources | _HEADERS:
                    yield f"sources/{name} includes {header}, which is not in the archive"


@FILES.check("A6.lengths", "warning", "identifier and paths are short enough for every platform")
def _lengths(fmu: Fmu) -> Iterator[str]:
    if len(fmu.identifier) > _LONGEST_IDENTIFIER:
        yield (
            f"modelIdentifier has {len(fmu.identifier)} characters, {_LONGEST_IDENTIFIER} are safe"
        )
    for name in fmu.members:
        if len(name) > _LONGEST_PATH:
            yield f"{name} has {len(name)} characters, {_LONGEST_PATH} are safe on Windows"


@FILES.check("A7.extra", "warning", "extra/ holds folders named by reverse domain only")
def _extra(fmu: Fmu) -> Iterator[str]:
    for folder in sorted({m.split("/")[1] for m in fmu.members if m.startswith("extra/")}):
        if not re.fullmatch(r"[a-z0-9-]+(\.[A-Za-z0-9_-]+)+", folder):
            yield f"extra/{folder} is not named by a reverse domain"
        elif folder.startswith(("org.fmi-standard", "org.modelica")) and (
            folder not in _STANDARD_EXTRAS
        ):
            yield f"extra/{folder} is in the name space of the standard"


@FILES.check("C3.identifier", "error", "the model identifier is a C identifier")
def _identifier(fmu: Fmu) -> Iterator[str]:
    if not _IDENTIFIER.fullmatch(fmu.identifier):
        yield f"modelIdentifier = '{fmu.identifier}' is no C identifier"
