"""A page from its template: everything that is filled in is escaped, a name that is missing is an error."""

from __future__ import annotations

import jinja2

__all__ = ["html_page"]


def html_page(template: str, **values: object) -> str:
    """HTML of a template of this package.

    Args:
        template: its file name in ``report/templates``.
        values: what it shows.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("torchweather.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)
