"""Instantiation and messages: items D1 to D4, D13, B3, B5."""

from __future__ import annotations

import ctypes
import locale
import math
import os
import shutil
import sys
from collections.abc import Iterator
from ctypes import c_char_p, c_size_t
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from harness.validation.checks import PROBES, Failure, Level, Note, Skip
from harness.validation.interface import FmiStatus
from harness.validation.probes.host import (
    STEPS,
    FmuInstance,
    Host,
    Library,
    compare,
    initialising,
    stepped,
)

_MODEL_EXCHANGE = 0


@PROBES.check("B3.version", "error", "the binary says FMI 2.0 with default types")
def _version(host: Host) -> Iterator[str]:
    for name, wanted in (("fmi2GetVersion", b"2.0"), ("fmi2GetTypesPlatform", b"default")):
        host.doing(name)
        found = getattr(host.library, name)()
        if found != wanted:
            yield f"{name} returned {found!r}, it has to be {wanted.decode()!r}"


@PROBES.check("D1.plain", "error", "instantiates, initialises and steps as a master would do it")
def _plain(host: Host) -> Iterator[str]:
    slave = stepped(host, STEPS, logging=True)
    slave.need("fmi2Terminate")
    slave.free()
    yield Note(f"{STEPS} steps of {host.step:g} s")


def _refused(host: Host, what: str, name: bytes | None = b"probe", **more: Any) -> Iterator[str]:
    host.messages.clear()
    callbacks = host.callbacks()
    component = FmuInstance.attempt(
        host, host.library, name, callbacks, host.facts["resources"].encode(), **more
    )
    if component:
        yield f"fmi2Instantiate accepts {what}; it has to return NULL"
    elif not any(status >= FmiStatus.Error for _, _, status, _, _ in host.messages):
        yield Note(f"fmi2Instantiate refuses {what}, but no message says why")


_REFUSALS: tuple[tuple[str, Level, str, dict[str, Any]], ...] = (
    ("guid_wrong", "error", "a wrong GUID", {"guid": b"{00000000-dead-beef-0000-000000000000}"}),
    ("guid_null", "error", "NULL as GUID", {"guid": None}),
    ("name_null", "warning", "NULL as instance name", {"name": None}),
    ("name_empty", "warning", "an empty instance name", {"name": b""}),
    ("name_blank", "warning", "a blank instance name", {"name": b"  \t"}),
)
for _id, _level, _what, _more in _REFUSALS:
    PROBES.check(f"D1.{_id}", _level, f"refuses {_what}")(partial(_refused, what=_what, **_more))


@PROBES.check("D1.type_wrong", "error", "refuses to be instantiated for model exchange")
def _type_wrong(host: Host) -> Iterator[str]:
    if host.facts["model_exchange"]:
        raise Skip("the FMU is for model exchange, too")
    yield from _refused(host, "the type model exchange", type=_MODEL_EXCHANGE)


@PROBES.check("D1.callbacks_null", "warning", "refuses NULL as callback functions")
def _callbacks_null(host: Host) -> Iterator[str]:
    if FmuInstance.attempt(host, host.library, b"probe", None, host.facts["resources"].encode()):
        yield "fmi2Instantiate accepts NULL as callback functions"


@PROBES.check("D1.logger_null", "error", "runs and refuses without a logger")
def _logger_null(host: Host) -> Iterator[str]:
    host.doing("fmi2Instantiate")
    FmuInstance.attempt(
        host, host.library, b"probe", host.callbacks(logger=False), b"", guid=b"wrong"
    )
    slave = stepped(host, 2, logger=False, logging=True)
    slave.call("fmi2DoStep", host.begin, -1.0, 1)
    slave.free()
    yield from ()


@PROBES.check("D2.copies", "error", "copies the instance name and the callback functions")
def _copies(host: Host) -> Iterator[str]:
    environment = 0x5EED
    name = ctypes.create_string_buffer(b"the name of it")
    slave = FmuInstance(host, name=name, environment=environment)
    ctypes.memset(ctypes.byref(slave.callbacks), 0, ctypes.sizeof(slave.callbacks))
    ctypes.memset(name, ord("X"), len(name) - 1)
    host.messages.clear()
    slave.initialise()
    slave.call("fmi2DoStep", host.begin, -1.0, 1)
    if not host.messages:
        yield Note("the FMU said nothing, so its copies were not seen")
    for found, heard, *_ in host.messages:
        if found != environment:
            yield f"componentEnvironment is {found:#x} in the logger, it was {environment:#x}"
        if heard is not None and heard not in {b"the name of it", b""}:
            yield f"the instance name is {heard!r} in the logger, it was b'the name of it'"


# ---- Resource URIs ------------------------------------------------------------------------------


def _uri_works(host: Host, form: str, folder: str = "") -> Iterator[str]:
    """Compare results with the FMU unpacked in `folder` and its resources named in a form."""
    here = Path(host.facts["folder"])
    library: Library | None = None
    reference = host.reference_run()
    if folder:
        here = Path.cwd() / folder
        shutil.copytree(host.facts["folder"], here)
        library = Library(
            host, str(here / Path(host.facts["library"]).relative_to(host.facts["folder"]))
        )
    path = (here / "resources").as_posix()
    uri = form.format(path=quote(path, safe="/:").removeprefix("/"))
    try:
        slave = stepped(host, library=library, resources=uri.encode())
        seen = slave.run(0, STEPS)
        slave.free()
    except Failure as failure:
        raise Failure(f"with the resources at {uri}: {failure}") from None
    yield from compare(seen, reference, f"with the resources at {uri}")


for _id, _form, _folder, _what in (
    ("three_slashes", "file:///{path}", "", "file:///path"),
    ("one_slash", "file:/{path}", "", "file:/path"),
    ("localhost", "file://localhost/{path}", "", "file://localhost/path"),
    ("trailing_slash", "file:///{path}/", "", "file:///path/"),
    ("spaces", "file:///{path}", "a b  c", "a folder with blanks"),
    ("non_ascii", "file:///{path}", "\u00fcml\u00e4ut-\u96ea-\u03c0", "a folder in UTF-8"),
    ("percent", "file:///{path}", "100%25+#x", "a folder with % + #"),
):
    PROBES.check(f"D3.{_id}", "error", f"finds its resources: {_what}")(
        partial(_uri_works, form=_form, folder=_folder)
    )


@PROBES.check("D3.bad_uri", "error", "survives a resource URI that is NULL, empty or nonsense")
def _bad_uri(host: Host) -> Iterator[str]:
    for uri in (
        None,
        b"",
        b"no uri at all",
        b"file:",
        b"file:///%",
        b"file:///%zz%",
        b"http://x/y",
    ):
        host.messages.clear()
        callbacks = host.callbacks()
        component = FmuInstance.attempt(host, host.library, b"probe", callbacks, uri)
        if not component and not host.facts["has_resources"]:
            yield Note(f"no instance with the URI {uri!r}, though there are no resources")
        if component:
            host.library.fmi2FreeInstance(component)


# ---- Messages -----------------------------------------------------------------------------------


def _provoke(host: Host, slave: FmuInstance) -> None:
    """Make an FMU talk: refused steps, unknown references, a call out of turn."""
    slave.call("fmi2DoStep", host.begin, -host.step, 1)
    for variable in host.inputs[:1]:
        slave.set_to(variable, math.nan)
    slave.call("fmi2ExitInitializationMode")


@PROBES.check("D4.categories", "warning", "messages come in declared categories and are plain text")
def _categories(host: Host) -> Iterator[str]:
    slave = stepped(host, logging=True)
    _provoke(host, slave)
    declared = set(host.facts["categories"])
    found = {(category, text) for *_, category, text in host.messages}
    for category in sorted({c.decode("utf-8", "replace") if c else "NULL" for c, _ in found}):
        if category not in declared:
            yield f"category '{category}' of a message is not among LogCategories"
    for text in sorted(t or b"" for _, t in found if t is None or t.endswith((b"\n", b"\r"))):
        yield f"message {text!r} is empty or ends with a line break"
    yield Note(f"{len(host.messages)} messages heard")


@PROBES.check("D4.format", "error", "text from outside is never used as a printf format")
def _format(host: Host) -> Iterator[str]:
    slave = stepped(host, name=b"%s%n%s%n 100% #r1#", logging=True)
    _provoke(host, slave)
    slave.free()
    host.messages.clear()
    callbacks = host.callbacks()
    FmuInstance.attempt(host, host.library, b"%s%n", callbacks, guid=b"%n%s%n%s%n%s")
    yield from ()


@PROBES.check("D4.debug_logging", "warning", "fmi2SetDebugLogging takes declared categories only")
def _debug_logging(host: Host) -> Iterator[str]:
    slave = FmuInstance(host)
    slave.need("fmi2SetDebugLogging", 1, c_size_t(0), None)
    for category in host.facts["categories"]:
        names = (c_char_p * 1)(category.encode())
        if slave.call("fmi2SetDebugLogging", 1, c_size_t(1), names) != FmiStatus.OK:
            yield f"the declared category '{category}' is refused"
    names = (c_char_p * 1)(b"no such category")
    if slave.call("fmi2SetDebugLogging", 1, c_size_t(1), names) < FmiStatus.Warning:
        yield "an unknown category is accepted in silence"


# ---- Freeing, surroundings ----------------------------------------------------------------------


@PROBES.check("D13.free_null", "error", "fmi2FreeInstance(NULL) does nothing")
def _free_null(host: Host) -> Iterator[str]:
    host.doing("fmi2FreeInstance(NULL)")
    host.library.fmi2FreeInstance(None)
    yield from ()


@PROBES.check("D13.free_anywhere", "error", "can be freed in every state, and read once terminated")
def _free_anywhere(host: Host) -> Iterator[str]:
    FmuInstance(host).free()
    slave = initialising(host)
    slave.free()
    slave = stepped(host)
    slave.free()
    slave = stepped(host)
    last = slave.run(0, 3)[-1]
    slave.call("fmi2DoStep", math.nan, -1.0, 1)
    slave.free()
    slave = stepped(host, 3)
    slave.need("fmi2Terminate")
    yield from compare([slave.values()], [last], "values after fmi2Terminate")
    slave.free()


def _surroundings(host: Host) -> dict[str, object]:
    """Return the settings of the process that an FMU has to leave alone."""
    # Results that come out differently with another rounding mode, or with denormals off. The
    # factor comes from outside, else Python would compute all of this before it runs.
    one = float(host.facts["one"])
    arithmetic = (one + 2.0**-54, -one - 2.0**-54, one + 3 * 2.0**-54, one * 2.0**-1074)
    found: dict[str, object] = {
        "floating-point environment": arithmetic,
        "working directory": str(Path.cwd()),
        "locale": locale.setlocale(locale.LC_ALL, None),
    }
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.partition(":")[::2] for line in status.read_text().splitlines())
        found["signal handlers"] = tuple(
            lines.get(key, "") for key in ("SigBlk", "SigIgn", "SigCgt")
        )
        found["file mode mask"] = lines.get("Umask", "")
    if sys.platform.startswith("linux"):
        variables = ctypes.POINTER(c_char_p).in_dll(ctypes.CDLL(None), "environ")
        texts: list[bytes] = []
        while (text := variables[len(texts)]) is not None:
            texts.append(text)
        found["environment variables"] = sorted(texts)
        libm = ctypes.CDLL("libm.so.6")
        found["rounding mode"] = libm.fegetround()
        found["floating-point exceptions that trap"] = libm.fegetexcept()
    return found


@PROBES.check("B5.surroundings", "warning", "leaves the process as it was")
def _left_alone(host: Host) -> Iterator[str]:
    before = _surroundings(host)
    slave = stepped(host, STEPS)
    slave.need("fmi2Terminate")
    slave.free()
    for what, now in _surroundings(host).items():
        if now != before[what]:
            yield f"the {what} changed: {before[what]} before, {now} after"
    sys.stdout.flush()
    printed = os.fstat(1).st_size
    if printed:
        yield f"{printed} bytes were written to the standard output; use the logger"
