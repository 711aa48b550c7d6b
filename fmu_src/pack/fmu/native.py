"""The native flavour: C sources and binaries, compiled by the zig that comes as a Python wheel.

No other compiler is needed, and every platform's binary can be built on every platform. The same
sources give the same bytes: paths are relative, and nothing of the machine gets in.
"""

import hashlib
import os
import platform
import struct
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path

from fmu_src.errors import SteadytipError
from fmu_src.kit import Model
from fmu_src.pack import cache as store
from fmu_src.pack.cache import kept
from fmu_src.pack.codegen import c_source as csource
from fmu_src.pack.fmu.description import describe

__all__ = [
    "TARGETS",
    "Slice",
    "chosen",
    "compile_c",
    "compile_library",
    "files",
    "host",
    "kept",
]


@dataclass(frozen=True)
class Slice:
    """What one compilation makes: a target of zig, the ending and flags of its libraries."""

    triple: str
    suffix: str
    flags: tuple[str, ...]


_ELF = ("-fPIC", "-s", "-lm")
# An absolute install name would tell of this machine.
_MACH = ("-g0", "-Wl,-install_name,@rpath/{name}.dylib")
_LINUX = Slice("x86_64-linux-gnu.2.17", ".so", _ELF)
_LINUX_ARM = Slice("aarch64-linux-gnu.2.17", ".so", _ELF)
_WINDOWS = Slice("x86_64-windows-gnu", ".dll", ("-s",))
_MAC = Slice("x86_64-macos.11.0", ".dylib", _MACH)
_MAC_ARM = Slice("aarch64-macos.11.0", ".dylib", _MACH)
TARGETS: dict[str, tuple[Slice, ...]] = {
    "linux64": (_LINUX,),
    "aarch64-linux": (_LINUX_ARM,),
    "win64": (_WINDOWS,),
    "darwin64": (_MAC, _MAC_ARM),
    "aarch64-darwin": (_MAC, _MAC_ARM),
}
"""Folders of FMI 2.0 and the slices in them; both of Apple's get the same universal library."""
_HOSTS = {
    ("Linux", "x86_64"): "linux64",
    ("Linux", "aarch64"): "aarch64-linux",
    ("Windows", "AMD64"): "win64",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "aarch64-darwin",
}
# No fused multiply-add: then platforms agree to the last bits, bit for bit without sin and cos. And
# nobody reads `errno`, for which a square root would become a call.
_FLAGS = (
    "-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-shared"
)  # fmt: skip
# Mach-O universal: magic, and CPU type and subtype by the first part of zig's triple.
_FAT_MAGIC = 0xCAFEBABE
_CPU = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}
_FAT_ALIGNMENT = 14


def host() -> str:
    """Folder of the platform that this Python runs on.

    Raises:
        SteadytipError: no binary can be built for it.
    """
    key = (platform.system(), platform.machine())
    if key not in _HOSTS:
        known = ", ".join(f"{system} {machine}" for system, machine in _HOSTS)
        raise SteadytipError(
            f"no native FMU can be built for {key[0]} {key[1]}, only for {known};"
            " use --flavour python there"
        )
    return _HOSTS[key]


def chosen(targets: Collection[str] | None) -> list[str]:
    """Folders to build for: this platform's by default, `all` for every one.

    Raises:
        SteadytipError: an unknown name.
    """
    if not targets:
        return [host()]
    unknown = set(targets) - set(TARGETS) - {"all"}
    if unknown:
        raise SteadytipError(f"target '{min(unknown)}' must be one of {', '.join(TARGETS)}, or all")
    return [name for name in TARGETS if name in targets or "all" in targets]


def files(model: Model, guid: str, targets: Sequence[str], cache: Path) -> dict[str, bytes]:
    """Every file of the FMU.

    Args:
        model: what to pack.
        guid: compiled in and described.
        targets: folders to build binaries for.
        cache: folder that the compiler keeps its own files in, worth keeping between builds.
    """
    texts = csource.sources(model, guid)
    capabilities = {
        "canNotUseMemoryManagementFunctions": "true",
        "providesDirectionalDerivative": str(model.derivatives).lower(),
    }
    found = {"modelDescription.xml": describe(model, guid, capabilities, [csource.ENTRY])}
    found |= {f"sources/{name}": text.encode() for name, text in texts.items()}
    compiled: dict[tuple[Slice, ...], bytes] = {}
    for target in targets:
        slices = TARGETS[target]
        if slices not in compiled:
            parts = [_library(model.name, texts, part, cache) for part in slices]
            compiled[slices] = parts[0] if len(parts) == 1 else _universal(slices, parts)
        found[f"binaries/{target}/{model.name}{slices[0].suffix}"] = compiled[slices]
    return found


def _library(name: str, texts: Mapping[str, str], part: Slice, cache: Path) -> bytes:
    """What `compile_library` makes, or made of the same text before."""
    made_of = (name, sorted(texts.items()), astuple(part), _FLAGS, version("ziglang"))
    key = hashlib.sha256(repr(made_of).encode()).hexdigest()
    return store.recall(cache / "libraries", key, lambda: compile_library(name, texts, part, cache))


def compile_library(name: str, texts: Mapping[str, str], part: Slice, cache: Path) -> bytes:
    """Build a shared library and return its bytes.

    Args:
        name: model identifier.
        texts: C sources by file name.
        part: platform.
        cache: folder of the compiler's own files.

    Raises:
        SteadytipError: the compiler is missing or refused the sources; with its words.
    """
    library = name + part.suffix
    flags = [flag.format(name=name) for flag in part.flags]
    arguments = ["-target", part.triple, *_FLAGS, csource.ENTRY, "-o", library, *flags]
    try:
        return compile_c(texts, arguments, library, cache)
    except SteadytipError as error:
        raise SteadytipError(
            f"{name}: the compiler refused the generated sources for {part.triple}:\n{error}"
        ) from None


def compile_c(
    texts: Mapping[str, str], arguments: Sequence[str], product: str, cache: Path
) -> bytes:
    """Compile in a folder of its own and return one file of what comes out.

    Args:
        texts: sources and headers by file name.
        arguments: of the compiler, paths relative to that folder.
        product: name of the file that is wanted.
        cache: folder of the compiler's own files.

    Raises:
        SteadytipError: the compiler is missing or refused the sources; its words alone.
    """
    cache = cache.resolve()
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        # What it keeps of these sources is of no use in another folder, and would pile up.
        caches = {"ZIG_GLOBAL_CACHE_DIR": str(cache), "ZIG_LOCAL_CACHE_DIR": folder}
        for file, text in texts.items():
            (Path(folder) / file).write_text(text, encoding="utf-8", newline="\n")
        done = subprocess.run(
            [sys.executable, "-m", "ziglang", "cc", *arguments],
            cwd=folder,
            env={**os.environ, **caches},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise SteadytipError(done.stderr.strip())
        return (Path(folder) / product).read_bytes()


def _universal(slices: Sequence[Slice], libraries: Sequence[bytes]) -> bytes:
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
