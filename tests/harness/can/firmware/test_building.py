"""The board's program is compiled from its sources, once."""

from pathlib import Path

import pytest

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiler import compile_c
from harness.can.firmware import sources
from harness.can.firmware.build import build_board
from tests.harness.can.firmware.board import DBCS, STRICT


@pytest.mark.parametrize("dbc", DBCS)
def test_compiles_without_a_warning_and_only_once(dbc) -> None:
    program = build_board(dbc, STRICT)
    built = program.stat().st_mtime_ns
    assert build_board(dbc, STRICT) == program
    assert program.stat().st_mtime_ns == built
    assert (program.parent / "bus.h").is_file()
    assert program.is_relative_to(Path("build/c/board").resolve())
    assert sources.__wrapped__(dbc) == sources(dbc), "generated code depends on the time"


def test_a_warning_would_be_an_error() -> None:
    with pytest.raises(SteadytipError, match=r"(?s)refused the board.*board\.[ch]"):
        build_board("instrument", ["-Werror", "-Wunused-macros", "-DBOARD_CHANNELS=8"])


def test_a_bus_without_the_boards_messages_is_refused(tmp_path) -> None:
    path = tmp_path / "other.dbc"
    path.write_text('VERSION ""\n\nBU_: A\n\nBO_ 5 PiezoCommand: 8 A\n\n')
    with pytest.raises(SteadytipError, match=r"other\.dbc: 5 problems"):
        build_board(str(path))
    with pytest.raises(SteadytipError, match=r"no DBC file is called 'nowhere'"):
        build_board("nowhere")


@pytest.mark.slow
@pytest.mark.parametrize("dbc", DBCS)
def test_portable_part_compiles_for_a_microcontroller(dbc, tmp_path) -> None:
    """No operating system, no heap: the sources that a firmware takes, for a Cortex-M4."""
    texts = {n: t for n, t in sources(dbc).items() if not n.startswith(("host", "faults"))}
    arguments = ["-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4", "-std=c99", "-Os"]
    units = {n: t for n, t in texts.items() if n in ("board.c", "bus.c", "slcan.c")}
    # The C library's headers come with one; these few words are all that is needed of it.
    texts["string.h"] = (
        "#include <stddef.h>\nvoid *memset(void *, int, size_t);\nsize_t strlen(const char *);\n"
        "char *strchr(const char *, int);\nvoid *memcpy(void *, const void *, size_t);\n"
    )
    texts["math.h"] = "double round(double);\n"
    for name in units:
        flags = [*arguments, "-I.", "-c", name, "-o", "unit.o"]
        made = compile_c(texts, flags, "unit.o").read_bytes()
        assert made[:4] == b"\x7fELF"
        assert made[18] == 40, "machine is ARM"
        for word in (b"malloc", b"printf", b"errno"):
            assert word not in made, f"{name} needs {word.decode()}"
