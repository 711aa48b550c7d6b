"""An FMU as a file: its archive, its description as XML, its binaries."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from harness.common.archives import ArchiveError, read
from harness.common.errors import SteadytipError
from harness.common.xml_files import MOST_BYTES, parse_xml
from harness.validation.checks import Failure, Skip

__all__ = ["DESCRIPTION", "VERSION", "Fmu"]

DESCRIPTION = "modelDescription.xml"
VERSION = "2.0"
"""Of FMI; the checklist is for no other."""


@dataclass(frozen=True)
class Fmu:
    """Subject of the checks on files.

    Attributes:
        path: the archive.
    """

    path: Path

    @cached_property
    def infos(self) -> list[zipfile.ZipInfo]:
        """Members of the archive as its directory lists them.

        Raises:
            Failure: it is no archive.
        """
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.infolist()
        except Exception as error:  # zipfile raises a dozen kinds on damaged archives
            raise Failure(f"{self.path.name} is no zip archive: {error}") from None

    @cached_property
    def members(self) -> list[str]:
        """Names of the files."""
        return [info.orig_filename for info in self.infos if not info.is_dir()]

    def content(self, member: str, most_bytes: int = MOST_BYTES) -> bytes:
        """One file.

        Raises:
            Failure: it cannot be read.
        """
        try:
            return read(self.path, member, most_bytes=most_bytes)
        except ArchiveError as error:
            raise Failure(str(error)) from None

    @cached_property
    def root(self) -> Any:
        """Root element of the description, of FMI 2.0.

        Raises:
            Skip: there is none; item A3 or C1 says why.
        """
        try:
            root = self.parsed()
        except Failure:
            raise Skip(f"{DESCRIPTION} cannot be read") from None
        if root.get("fmiVersion") != VERSION:
            raise Skip(f"this is FMI {root.get('fmiVersion')}, not FMI {VERSION}")
        return root

    def parsed(self) -> Any:
        """Root element of the description.

        Raises:
            Failure: why it cannot be read.
        """
        if DESCRIPTION not in self.members:
            raise Failure(f"{DESCRIPTION} is missing at the root of the archive")
        try:
            return parse_xml(self.content(DESCRIPTION), DESCRIPTION)
        except SteadytipError as error:
            raise Failure(str(error)) from None

    @cached_property
    def simulation(self) -> Any:
        """Element CoSimulation.

        Raises:
            Skip: there is none.
        """
        element = self.root.find("CoSimulation")
        if element is None:
            raise Skip("the FMU is not for co-simulation")
        return element

    @property
    def identifier(self) -> str:
        """Base name of the binaries."""
        return str(self.simulation.get("modelIdentifier") or "")

    @cached_property
    def binaries(self) -> dict[str, str]:
        """The FMU's own binary of each platform's folder that has one, by folder."""
        found = {}
        for member in self.members:
            parts = member.split("/")
            if len(parts) == 3 and parts[0] == "binaries":
                base, _, ending = parts[2].rpartition(".")
                if base == self.identifier and ending in {"so", "dll", "dylib"}:
                    found[parts[1]] = member
        return found
