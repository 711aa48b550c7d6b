"""Compile C with the zig that comes as a Python wheel; keep what was compiled by its content.

No other compiler is needed, and every platform's binary can be built on every platform. The same
sources give the same bytes: paths are relative, and nothing of the machine gets in.
"""

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

from fmu_src.errors import SteadytipError
from fmu_src.pack import cache

__all__ = [
    "COMMAND",
    "FOLDER",
    "TARGETS",
    "ZigTarget",
    "compile_c",
    "compile_library",
    "host",
    "host_target",
    "select_targets",
]

COMMAND = (sys.executable, "-m", "ziglang", "cc")
"""The compiler."""
FOLDER = Path("build") / "c"
"""Folder of the compiler's own files and, in `compiled`, of what it has made."""


@dataclass(frozen=True)
class ZigTarget:
    """Target of one compilation: its zig triple, and the ending and flags of its libraries."""

    triple: str
    suffix: str
    flags: tuple[str, ...]


_ELF = ("-fPIC", "-s", "-lm")
# An absolute install name would tell of this machine.
_MACH = ("-g0", "-Wl,-install_name,@rpath/{name}.dylib")
_LINUX = ZigTarget("x86_64-linux-gnu.2.17", ".so", _ELF)
_LINUX_ARM = ZigTarget("aarch64-linux-gnu.2.17", ".so", _ELF)
_WINDOWS = ZigTarget("x86_64-windows-gnu", ".dll", ("-s",))
_MAC = ZigTarget("x86_64-macos.11.0", ".dylib", _MACH)
_MAC_ARM = ZigTarget("aarch64-macos.11.0", ".dylib", _MACH)
TARGETS: dict[str, tuple[ZigTarget, ...]] = {
    "linux64": (_LINUX,),
    "aarch64-linux": (_LINUX_ARM,),
    "win64": (_WINDOWS,),
    "darwin64": (_MAC, _MAC_ARM),
    "aarch64-darwin": (_MAC, _MAC_ARM),
}
"""Targets by platform folder of FMI 2.0. Both of Apple's get the same universal library."""
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


def host() -> str:
    """Return the platform folder of the machine that this Python runs on.

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


def host_target() -> ZigTarget:
    """Return the target of libraries that this process can load.

    Raises:
        SteadytipError: no binary can be built for it.
    """
    return TARGETS[host()][-1 if platform.machine() == "arm64" else 0]


def select_targets(targets: Collection[str] | None) -> list[str]:
    """Return the folders to build for: this platform's by default, every one for `all`.

    Raises:
        SteadytipError: an unknown name.
    """
    if not targets:
        return [host()]
    unknown = set(targets) - set(TARGETS) - {"all"}
    if unknown:
        raise SteadytipError(f"target '{min(unknown)}' must be one of {', '.join(TARGETS)}, or all")
    return [name for name in TARGETS if name in targets or "all" in targets]


def compile_library(
    name: str,
    texts: Mapping[str, str],
    target: ZigTarget | None = None,
    flags: Sequence[str] = _FLAGS,
    entry: str = "fmu.c",
) -> Path:
    """Compile a shared library, unless the same has been compiled before.

    Args:
        name: of the library; on macOS its install name.
        texts: sources and headers by file name.
        target: platform; the one that this process runs on by default.
        flags: of the compiler, beside those of the target.
        entry: the source to compile; it includes the others.

    Returns:
        Path of the library, absolute.

    Raises:
        SteadytipError: the compiler is missing or refused the sources; with its message.
    """
    target = target or host_target()
    library = name + target.suffix
    own = [flag.format(name=name) for flag in target.flags]
    arguments = ["-target", target.triple, *flags, entry, "-o", library, *own]
    try:
        return compile_c(texts, arguments, library)
    except SteadytipError as error:
        raise SteadytipError(
            f"{name}: the compiler refused the generated sources for {target.triple}:\n{error}"
        ) from None


def compile_c(texts: Mapping[str, str], arguments: Sequence[str], product: str) -> Path:
    """Compile C sources, unless the same have been compiled before.

    Args:
        texts: sources and headers by file name.
        arguments: of the compiler; paths are relative to a folder that holds the sources alone.
        product: name of the file that is wanted.

    Returns:
        Path of that file, absolute, under a name that its content determines.

    Raises:
        SteadytipError: the compiler is missing or refused the sources; its message alone.
    """
    made_of = (sorted(texts.items()), tuple(arguments), version("ziglang"))
    key = hashlib.sha256(repr(made_of).encode()).hexdigest()[:32]
    make = partial(_compile, texts, arguments, product)
    return cache.keep(FOLDER / "compiled", key, make, Path(product).suffix, mode=0o755).resolve()


def _compile(texts: Mapping[str, str], arguments: Sequence[str], product: str) -> bytes:
    own_files = FOLDER.resolve()
    own_files.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        # What it keeps of these sources is of no use in another folder, and would pile up.
        caches = {"ZIG_GLOBAL_CACHE_DIR": str(own_files), "ZIG_LOCAL_CACHE_DIR": folder}
        for file, text in texts.items():
            (Path(folder) / file).write_text(text, encoding="utf-8", newline="\n")
        done = subprocess.run(
            [*COMMAND, *arguments],
            cwd=folder,
            env={**os.environ, **caches},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise SteadytipError(done.stderr.strip())
        return (Path(folder) / product).read_bytes()
