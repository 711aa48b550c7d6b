"""XML from elsewhere, read without trust: no document type, no entities, no network."""

from __future__ import annotations

from typing import Any
from xml.parsers import expat

from lxml import etree

from fmu_src.errors import SteadytipError

__all__ = ["MOST_BYTES", "parse_xml"]

MOST_BYTES = 64 * 2**20
"""Size of a document [byte]."""


class _RootReached(Exception):  # noqa: N818 - ends the look at the prolog, no error
    pass


def parse_xml(content: bytes, where: str) -> Any:
    """Root element of a document.

    A document type declaration is refused outright: entities, which can name files and grow beyond
    all memory, live there, and neither FMI nor SSP has one.

    Args:
        content: the document.
        where: its name, for messages.

    Raises:
        SteadytipError: too large, with a document type, or not well-formed XML.
    """
    if len(content) > MOST_BYTES:
        raise SteadytipError(f"{where} is larger than {MOST_BYTES} bytes, the limit here")
    _refuse_doctype(content, where)
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False
    )
    try:
        return etree.fromstring(content, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise SteadytipError(f"{where} is not well-formed XML: {error}") from None


def _refuse_doctype(content: bytes, where: str) -> None:
    """Look at the prolog with a parser that only reports."""
    found: list[str] = []

    def doctype(name: str, *_: object) -> None:
        found.append(name)
        raise _RootReached

    def element(*_: object) -> None:
        raise _RootReached

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = element
    try:
        parser.Parse(content, True)
    except _RootReached:
        pass
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise SteadytipError(f"{where} is not well-formed XML: {error}") from None
    if found:
        raise SteadytipError(
            f"{where} has a document type declaration (<!DOCTYPE {found[0]}>), which could expand "
            "entities; remove it"
        )
