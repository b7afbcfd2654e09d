"""A page as data: its heading, its sections with their parts, and how to read it; ``page`` renders it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torchweather.report.parts import Part

__all__ = ["Report", "Section"]


@dataclass(frozen=True)
class Section:
    """A heading with parts, and sections below it that ``short`` names in a row of links."""

    title: str
    parts: Sequence[Part]
    id: str = ""
    sections: Sequence[Section] = ()
    short: str = ""


@dataclass(frozen=True)
class Report:
    """A page.

    Args:
        title: heading.
        lead: parts below the heading.
        sections: the page; sections with sections below are chapters.
        head: title of the browser's tab; ``""`` takes the heading.
        footer: how to read the page.
        styles, scripts: files of ``templates`` for its widgets.
        data: handed to the scripts as JSON.
    """

    title: str
    lead: Sequence[Part]
    sections: Sequence[Section]
    head: str = ""
    footer: Section | None = None
    styles: Sequence[str] = ()
    scripts: Sequence[str] = ()
    data: Mapping[str, Any] | None = None
