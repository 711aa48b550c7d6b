"""The binaries as files, of every platform: items B1 to B3. Read by LIEF, none is loaded."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any

from harness.validation.checks import FILES, Failure, Note, Skip
from harness.validation.files import Fmu
from harness.validation.interface import SIGNATURES

_MACHINES = {
    "linux64": {"X86_64"},
    "x86_64-linux": {"X86_64"},
    "linux32": {"I386"},
    "aarch64-linux": {"AARCH64"},
    "win64": {"AMD64"},
    "x86_64-windows": {"AMD64"},
    "win32": {"I386"},
    "aarch64-windows": {"ARM64"},
    "darwin64": {"X86_64", "ARM64"},
    "x86_64-darwin": {"X86_64"},
    "aarch64-darwin": {"ARM64"},
}
_SYSTEM = re.compile(
    r"(lib(c|m|dl|rt|pthread)\.so\.\d+|ld-linux-.*|linux-vdso.*"
    r"|kernel32\.dll|user32\.dll|advapi32\.dll|ntdll\.dll|api-ms-win-.*\.dll|ucrtbase\.dll"
    r"|/usr/lib/libSystem\.B\.dylib|/usr/lib/libc\+\+\.1\.dylib)",
    re.IGNORECASE,
)
_OLDEST_GLIBC = (2, 28)
"""Highest glibc that may be needed: that of the oldest systems still in use on rigs."""
_LIBRARY = {"so": "ELF", "dll": "PE", "dylib": "MachO"}
_MOST_BYTES = 2**28
_LINKER = {"__dso_handle", "_mh_dylib_header"}
"""What every Mach-O library has from its linker."""
_EXECUTABLE = 1  # PF_X of an ELF segment


def _parsed(fmu: Fmu) -> Iterator[tuple[str, Any]]:
    """Yield each binary (each slice of a universal one) with its path in the archive."""
    try:
        import lief
    except ImportError:
        raise Skip("binaries are read by LIEF: pip install 'steadytip[validate]'") from None
    lief.logging.disable()
    if not fmu.binaries:
        raise Skip("there are no binaries")
    for member in fmu.binaries.values():
        content = fmu.content(member, _MOST_BYTES)
        kind = _LIBRARY[member.rpartition(".")[2]]
        parsed: Any = getattr(lief, kind).parse(io.BytesIO(content))
        if parsed is None:
            raise Failure(f"{member} is no library of the kind {kind}")
        for binary in parsed if kind == "MachO" else [parsed]:
            yield member, binary


def _exported(binary: Any) -> set[str]:
    # Mach-O names have an underscore in front, PE exports have theirs in a table of its own.
    if hasattr(binary, "get_export"):
        export = binary.get_export()
        return {entry.name for entry in export.entries} if export else set()
    names = {str(symbol.name) for symbol in binary.exported_symbols}
    return {name.removeprefix("_") for name in names} if hasattr(binary, "commands") else names


@FILES.check("B1.exported", "error", "all 34 functions of the standard are exported")
def _functions(fmu: Fmu) -> Iterator[str]:
    for member, binary in _parsed(fmu):
        missing = sorted(SIGNATURES.keys() - _exported(binary))
        if missing:
            yield f"{member} does not export {', '.join(missing[:6])} ({len(missing)} in all)"


@FILES.check("B1.nothing_else", "warning", "nothing else is exported")
def _nothing_else(fmu: Fmu) -> Iterator[str]:
    for member, binary in _parsed(fmu):
        extra = sorted(_exported(binary) - SIGNATURES.keys() - _LINKER)
        if extra:
            yield (
                f"{member} exports {len(extra)} more symbols, {', '.join(extra[:4])} among them; "
                "compile with hidden visibility"
            )


@FILES.check("B2.dependencies", "warning", "nothing but the system's libraries is needed")
def _dependencies(fmu: Fmu) -> Iterator[str]:
    for member, binary in _parsed(fmu):
        libraries = [getattr(library, "name", library) for library in binary.libraries]
        own = member.rpartition("/")[2]
        foreign = [
            name for name in libraries if not _SYSTEM.fullmatch(name) and not name.endswith(own)
        ]
        beside = {m.rpartition("/")[2] for m in fmu.members}
        for name in foreign:
            where = "it is in the archive" if name in beside else "it is not in the archive"
            yield f"{member} needs {name}; {where}"


@FILES.check("B2.glibc", "warning", "runs with an old C library")
def _glibc(fmu: Fmu) -> Iterator[str]:
    for member, binary in _parsed(fmu):
        if not hasattr(binary, "symbols_version_requirement"):
            continue
        versions = [
            tuple(int(digit) for digit in found[1].split("."))
            for entry in binary.symbols_version_requirement
            for auxiliary in entry.get_auxiliary_symbols()
            if (found := re.fullmatch(r"GLIBC_([\d.]+)", auxiliary.name))
        ]
        newest = max(versions, default=(2, 0))
        text = f"{member} needs glibc {'.'.join(map(str, newest))}"
        yield text if newest > _OLDEST_GLIBC else Note(text)


@FILES.check("B2.hardening", "warning", "no executable stack, no search path of the build machine")
def _hardening(fmu: Fmu) -> Iterator[str]:
    for member, binary in _parsed(fmu):
        if hasattr(binary, "symbols_version_requirement"):
            # Without the segment the kernel makes the stack executable.
            stacks = [s for s in binary.segments if s.type.name == "GNU_STACK"]
            if not stacks or any(stack.flags.value & _EXECUTABLE for stack in stacks):
                yield f"{member} asks for an executable stack"
            for entry in binary.dynamic_entries:
                if entry.tag.name in {"RPATH", "RUNPATH"}:
                    path = getattr(entry, "rpath", getattr(entry, "runpath", ""))
                    if not path.startswith("$ORIGIN"):
                        yield f"{member} looks for libraries in {path}"
        elif not binary.has_nx:
            yield f"{member} asks for an executable stack"


@FILES.check("B2.machine", "error", "binaries are for the machine of their folder")
def _machine(fmu: Fmu) -> Iterator[str]:
    machines: dict[str, set[str]] = {}
    for member, binary in _parsed(fmu):
        header = binary.header
        for attribute in ("machine_type", "machine", "cpu_type"):
            if hasattr(header, attribute):
                machines.setdefault(member, set()).add(str(getattr(header, attribute).name))
    for folder, member in fmu.binaries.items():
        wanted, found = _MACHINES.get(folder), machines[member]
        # One slice of a universal library is enough.
        if wanted and not wanted & found:
            yield f"{member} is for {', '.join(sorted(found))}, not for {', '.join(sorted(wanted))}"
