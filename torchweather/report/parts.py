"""Parts of a section: text, verdicts, tables, figures, pictures; used as ``parts.Table``.

Plain text is escaped where it is shown. Text with markup comes from ``markup``, which escapes what it fills in.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from torchweather.core.errors import InputValueError


def markup(text: str, *values: object, **named: object) -> Markup:
    """Text with markup; values that are filled in are escaped.

    Example:
        >>> str(markup("<code>{}</code>", "<script>"))
        '<code>&lt;script&gt;</code>'
    """
    return Markup(text).format(*values, **named)


def link(target: str, text: str | None = None) -> Markup:
    """Link to a file beside the page, or to an id of the page (``#id``)."""
    address = target if target.startswith("#") else quote(target)
    return markup('<a href="{}">{}</a>', address, target if text is None else text)


def items(text: str) -> list[str]:
    r"""Items of a text whose lines begin with ``- ``, or go on.

    Example:
        >>> items("- one\n  goes on\n- two")
        ['one goes on', 'two']
    """
    found = [" ".join(one.split()) for one in re.split(r"^\s*- ", text, flags=re.MULTILINE)]
    return [type(text)(one) for one in found if one]


class Part:
    """One part of a section; the macro of its name in ``templates/report.html`` draws it."""

    @property
    def macro(self) -> str:
        """Name of the macro."""
        return type(self).__name__.lower()


@dataclass(frozen=True)
class Verdict(Part):
    """The answer of the page in one paragraph."""

    text: str


@dataclass(frozen=True)
class Alert(Part):
    """A warning in a frame, with its first words in bold."""

    text: str
    bold: str = ""
    grave: bool = False


@dataclass(frozen=True)
class Paragraph(Part):
    """Running text; ``look`` is ``text``, or ``lead``, ``note``, ``fine`` and others of ``page.css``."""

    text: str
    look: str = "text"


@dataclass(frozen=True)
class Note(Paragraph):
    """A remark in muted ink."""

    look: str = "note"


@dataclass(frozen=True)
class Fine(Paragraph):
    """Small print."""

    look: str = "fine"


@dataclass(frozen=True)
class Prose(Part):
    """Paragraphs that flow in two columns where there is room."""

    paragraphs: Sequence[str]


@dataclass(frozen=True)
class Heading(Part):
    """A heading within a section, with a remark behind it."""

    text: str
    small: str = ""
    id: str = ""


@dataclass(frozen=True)
class Facts(Part):
    """Names with values: in a row (``facts``), as large numbers (``big``), or one below the other (``reasons``)."""

    items: Sequence[tuple[str, str]]
    look: str = "facts"


@dataclass(frozen=True)
class Key:
    """One entry of a legend: a dot of a colour, a mark of a shape (``look``), or a glyph in the colour."""

    name: str
    colour: str = ""
    glyph: str = ""
    look: str = ""


@dataclass(frozen=True)
class Legend(Part):
    """Colours and marks with their meaning; ``chart`` where they belong to line charts, which dark pages turn over."""

    keys: Sequence[Key]
    chart: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Args:
        text: what it holds.
        small: lines below, in small muted print.
        look: class of ``page.css``.
        data: attributes ``data-*``.
        shade: 0 to 1, strength of a warm ground.
        bar_px: length of a bar before the text.
    """

    text: str = ""
    small: Sequence[str] = ()
    look: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)
    shade: float | None = None
    bar_px: int | None = None


@dataclass(frozen=True)
class Column:
    """A column: numbers to the right, or ``look`` ``left``, ``words`` (which wrap) or ``unit``."""

    title: str
    look: str = ""


Heads = list["Column | str"]
"""Headings of a table."""


@dataclass(frozen=True)
class Table(Part):
    """A table that scrolls sideways where it is too wide.

    Args:
        columns: the first holds the names of the rows; a plain text is a column of numbers.
        rows: a text in place of a row is a heading over all columns.
        look: class of ``page.css``.
        over: headings over several columns, text and number of columns.
    """

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[Cell | str] | str]
    look: str = ""
    over: Sequence[tuple[str, int]] = ()


@dataclass(frozen=True)
class Figure(Part):
    """A picture or a chart.

    Args:
        picture: data URI.
        alt: its content in words.
        title, small: heading above, and a remark behind it.
        caption, facts: below it, bold and muted.
        look: ``chart`` (dark pages turn its lightness over), ``pixels`` (enlarged without smoothing), ``wide`` (scrolls
            sideways), ``bar`` (a bar of colours), ``map`` (in its own size), ``medium``; several with a space.
    """

    picture: str
    alt: str
    title: str = ""
    small: str = ""
    caption: str = ""
    facts: Sequence[str] = ()
    look: str = ""

    def __post_init__(self) -> None:
        if not self.alt:
            raise InputValueError("Figure: alt must describe the picture; got an empty text.")


@dataclass(frozen=True)
class Pictures(Part):
    """Figures side by side, ``across`` of them where there is room."""

    figures: Sequence[Figure]
    across: int = 3
    look: str = ""


@dataclass(frozen=True)
class Listing(Part):
    """A list with bullets."""

    items: Sequence[str]


@dataclass(frozen=True)
class Code(Part):
    """Lines of a program."""

    text: str


@dataclass(frozen=True)
class Details(Part):
    """Parts that open at a click."""

    summary: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Columns(Part):
    """Titles with parts side by side, one below the other where there is no room."""

    columns: Sequence[tuple[str, Sequence[Part]]]


@dataclass(frozen=True)
class Widget(Part):
    """A template of its own within the page, driven by a script."""

    template: str
    values: Mapping[str, Any]
