"""The page that a command writes beside its parameter file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from fmu_src.errors import SteadytipError
from harness.common.files import reason
from harness.report.page import Section, made_with, write_sections

__all__ = ["write_topic_page"]


def write_topic_page(
    path: Path,
    title: str,
    subtitle: str,
    introduction: Iterable[str],
    sections: Iterable[Section],
    *packages: str,
) -> Path:
    """Write a page of sections.

    Args:
        path: file to write.
        title: heading of the page.
        subtitle: the line below it.
        introduction: paragraphs above the sections.
        sections: in their order.
        packages: distributions whose versions matter, beside numpy, scipy and plotly.

    Raises:
        SteadytipError: the file cannot be written.
    """
    used = made_with(*packages, "numpy", "scipy", "plotly")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_sections(path, title, subtitle, introduction, sections, used)
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
