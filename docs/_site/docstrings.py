"""Docstrings as the site's generator reads them."""

from __future__ import annotations

import re
from typing import Any

import griffe

EXAMPLE = re.compile(r"^Example:$", re.MULTILINE)
SAME = re.compile(r"\bArguments as ``?(\w+)``?")


class HouseDocstrings(griffe.Extension):
    """``Example:`` opens the section of examples, as ``Examples:`` does; arguments of a class beside it are a link."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rename the heading, and link a class that has the arguments."""
        if obj.docstring is not None:
            text = EXAMPLE.sub("Examples:", obj.docstring.value)
            same = SAME.search(text) if obj.is_class else None
            beside = obj.parent.members.get(same[1]) if same and obj.parent is not None else None
            if beside is not None and not beside.is_alias:
                text = text.replace(same[0], f"Arguments as [`{same[1]}`][{beside.path}]")
            obj.docstring.value = text
