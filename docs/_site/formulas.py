"""Formulas of the pages as MathML, converted when the site is built: a reader's browser needs no script for them.

Pages write formulas as GitHub does: a fenced block of the language ``math``, or a formula between ``$`` and a
backtick within a line.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

FORMULA = re.compile(
    r"^(?P<indent>[ \t]*)```math\n(?P<block>.*?)\n[ \t]*```[ \t]*$"
    r"|^[ \t]*```.*?^[ \t]*```[ \t]*$"  # other code stays as it is
    r"|\$`(?P<inline>[^`]+)`\$",
    re.MULTILINE | re.DOTALL,
)
NAMED = re.compile(
    r"(?<!<msup>)(?<!<msub>)(<mi>(?:ln|log|sin|cos|tan|exp|Re)</mi>)(?!<mo|</)"
)  # a function without brackets
UNKNOWN = re.compile(r"(?:\\|&#x0005C;)\w+|&#x00026;|<m[io]>&amp;")


def on_page_markdown(markdown: str, **kwargs: Any) -> str:
    """Markdown of a page with MathML in place of its formulas."""
    return FORMULA.sub(replaced, markdown)


def replaced(match: re.Match[str]) -> str:
    """MathML of one formula; any other code unchanged."""
    if match["block"] is not None:
        return f'{match["indent"]}<div class="formula">{mathml(match["block"], "block")}</div>'
    if match["inline"] is not None:
        return f"<span>{mathml(match['inline'], 'inline')}</span>"  # math alone at the start of a line is a block
    return match[0]


def mathml(formula: str, display: str) -> str:
    """MathML with its LaTeX as the text for screen readers."""
    one_line = " ".join(formula.split())
    found = convert(one_line, display=display)
    unknown = UNKNOWN.search(found)
    if unknown is not None:
        raise PluginError(f"the formula {one_line!r} has {unknown[0]!r}, which latex2mathml does not convert")
    found = NAMED.sub(r'\1<mspace width="0.1667em" />', found)
    return found.replace("<math ", f'<math alttext="{html.escape(one_line)}" ', 1).replace("\n", " ")
