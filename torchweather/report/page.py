"""The HTML of a report: self-contained, every value escaped, a name that is missing is an error."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from torchweather import __version__
from torchweather.io import atomic_write
from torchweather.report.report import Report

__all__ = ["html_of", "storable", "write_json", "write_report"]


@lru_cache(maxsize=1)
def _environment() -> jinja2.Environment:
    """Templates, each compiled once a process: that takes longer than to fill them in."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("torchweather.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"terse": _terse, "flush": _flush}
    return environment


def html_of(report: Report) -> str:
    """HTML of a page, with its style, pictures and scripts in itself."""
    return _environment().get_template("report.html").render(report=report, version=__version__)


def write_report(report: Report, path: str | os.PathLike[str]) -> None:
    """Write a page under a temporary name, then rename it: ``path`` is the whole page or what it was before."""
    text = html_of(report)
    with atomic_write(Path(path)) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Mapping[str, Any]) -> dict[str, Any]:
    """Write the numbers of a page; they come back as JSON holds them."""
    text = json.dumps(value, indent=1, allow_nan=False)
    with atomic_write(path) as unfinished:
        unfinished.write_text(text + "\n", encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def storable(value: Any) -> Any:
    """The value as JSON holds it: numbers that are not finite are the texts ``inf``, ``-inf`` and ``nan``."""
    if isinstance(value, Mapping):
        return {key: storable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [storable(entry) for entry in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _terse(style: str) -> Markup:
    """A style sheet without comments and line ends."""
    bare = re.sub(r"/\*.*?\*/", "", style, flags=re.DOTALL)
    tight = re.sub(r"\s*([{};,])\s*|(:)\s+|\s+", lambda found: found[1] or found[2] or " ", bare)
    return Markup(tight.replace(";}", "}"))


def _flush(script: str) -> Markup:
    """A script without indentation and lines of comment."""
    return Markup(re.sub(r"\n\s*(//.*)?(?=\n)|(?<=\n)\s+", "", script))
