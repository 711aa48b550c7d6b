"""Native flavour of an FMU: C sources and the binaries of each platform."""

import struct
from collections.abc import Sequence

from fmu_src.kit.model import Model
from fmu_src.pack.codegen import c_source
from fmu_src.pack.compiler import TARGETS, ZigTarget, compile_library
from fmu_src.pack.fmu.description import describe

# Mach-O universal: magic, and CPU type and subtype by the first part of zig's triple.
_FAT_MAGIC = 0xCAFEBABE
_CPU = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}
_FAT_ALIGNMENT = 14


def files(model: Model, guid: str, targets: Sequence[str]) -> dict[str, bytes]:
    """Return every file of the FMU, by its path in it.

    Args:
        model: what to pack.
        guid: compiled in and described.
        targets: folders to build binaries for.

    Raises:
        SteadytipError: the compiler is missing or refused the sources.
    """
    texts = c_source.sources(model, guid)
    capabilities = {
        "canNotUseMemoryManagementFunctions": "true",
        "providesDirectionalDerivative": str(model.derivatives).lower(),
    }
    found = {"modelDescription.xml": describe(model, guid, capabilities, [c_source.ENTRY])}
    found |= {f"sources/{name}": text.encode() for name, text in texts.items()}
    compiled: dict[tuple[ZigTarget, ...], bytes] = {}
    for target in targets:
        slices = TARGETS[target]
        if slices not in compiled:
            parts = [compile_library(model.name, texts, part).read_bytes() for part in slices]
            compiled[slices] = parts[0] if len(parts) == 1 else _universal(slices, parts)
        found[f"binaries/{target}/{model.name}{slices[0].suffix}"] = compiled[slices]
    return found


def _universal(slices: Sequence[ZigTarget], libraries: Sequence[bytes]) -> bytes:
    """Put libraries of several CPUs into one Mach-O file, each on a page of its own."""
    page = 1 << _FAT_ALIGNMENT
    head = struct.pack(">II", _FAT_MAGIC, len(slices))
    body, at = b"", page
    for part, library in zip(slices, libraries, strict=True):
        cpu, subtype = _CPU[part.triple.partition("-")[0]]
        head += struct.pack(">IIIII", cpu, subtype, at, len(library), _FAT_ALIGNMENT)
        padded = library + b"\0" * (-len(library) % page)
        body, at = body + padded, at + len(padded)
    return head.ljust(page, b"\0") + body
