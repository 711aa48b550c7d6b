"""Pages: one HTML file that needs nothing but a browser, of text, tables and plots."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

import fmu_src
from fmu_src.errors import SteadytipError
from harness.common.files import reason, replacing

if TYPE_CHECKING:
    import plotly.graph_objects as go

__all__ = [
    "Plot",
    "Section",
    "Table",
    "made_with",
    "page_text",
    "ready",
    "rendered",
    "write_page",
    "write_sections",
]


@dataclass(frozen=True)
class Plot:
    """One figure of a page.

    Attributes:
        title: heading.
        caption: what is shown, in a sentence.
        figure: plotly figure.
    """

    title: str
    caption: str
    figure: go.Figure


@dataclass(frozen=True)
class Table:
    """One table of a page.

    Attributes:
        columns: headings.
        rows: cells as they are shown.
        numbers: columns that hold numbers, counted from 0.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Section:
    """One part of a page, under a heading.

    Attributes:
        title: heading.
        text: paragraphs.
        tables: in their order.
        plots: in their order, below the tables.
        trouble: why something is missing; empty if nothing is.
    """

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    trouble: str = ""


def rendered(plots: Iterable[Plot]) -> list[dict[str, Any]]:
    """Return plots as templates take them."""
    return [
        {
            "title": plot.title,
            "caption": plot.caption,
            "html": Markup(
                plot.figure.to_html(
                    full_html=False,
                    include_plotlyjs=False,
                    config={"displaylogo": False, "responsive": True},
                )
            ),
        }
        for plot in plots
    ]


def ready(sections: Iterable[Section]) -> list[dict[str, Any]]:
    """Return sections as templates take them."""
    return [{**vars(section), "plots": rendered(section.plots)} for section in sections]


def page_text(template: str, title: str, subtitle: str, plotly: str, **content: Any) -> str:
    """Fill a template.

    Args:
        template: one beside this module that extends `page.html.j2`.
        title: heading of the page.
        subtitle: the line below it.
        plotly: script that draws the plots; empty where the page gets it otherwise.
        content: what the template names.
    """
    environment = Environment(
        loader=PackageLoader("harness", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # The script is the library's own file; it holds no `</script`.
    return environment.get_template(template).render(
        title=title, subtitle=subtitle, plotly=Markup(plotly), **content
    )


def write_page(path: Path, template: str, title: str, subtitle: str, **content: Any) -> Path:
    """Write the page of a template with its plots, all at once or not at all; see `page_text`."""
    page = page_text(template, title, subtitle, get_plotlyjs(), **content)
    with replacing(path) as part:
        part.write_text(page, encoding="utf-8")
    return path


def write_sections(
    path: Path,
    title: str,
    subtitle: str,
    introduction: Iterable[str],
    sections: Iterable[Section],
    metadata: Mapping[str, str],
) -> Path:
    """Write a page of sections, and its folder where there is none.

    Args:
        path: file to write.
        title: heading of the page.
        subtitle: the line below it.
        introduction: paragraphs above the sections.
        sections: in their order.
        metadata: how it was made, by name.

    Raises:
        SteadytipError: the page cannot be written.
    """
    content = {"introduction": list(introduction), "sections": ready(sections)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_page(
            path, "sections.html.j2", title, subtitle, metadata=dict(metadata), **content
        )
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None


def made_with(*packages: str) -> dict[str, str]:
    """Return machine and versions that figures were made with.

    Args:
        packages: distributions whose versions matter.
    """
    versions = {
        "steadytip": fmu_src.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
    return {
        "machine": f"{platform.system()} {platform.machine()}",
        "versions": ", ".join(f"{name} {text}" for name, text in versions.items()),
    }
