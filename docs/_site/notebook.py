"""Tutorials as Jupyter notebooks: ``python docs/_site/notebook.py FOLDER`` writes all of them.

A tutorial is one Markdown page. Its Python blocks become cells of code, and what a page says that they print becomes
their output. The site offers each notebook beside its page.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

__all__ = ["TUTORIALS", "as_text", "notebook"]

TUTORIALS = Path(__file__).parents[1] / "tutorials"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"^!\[[^\]]*\]\([^)]*\)\n", re.MULTILINE)
LINK = re.compile(r"\[([^\]]*)\]\(([^)]*)\)")
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def notebook(page: Path) -> dict[str, Any]:
    """Notebook of a tutorial, as version 4.5 of the format has it.

    Pictures are left out, because the cells draw them. A link to another page becomes the page's name.
    """
    text = page.read_text(encoding="utf-8")
    cells: list[dict[str, Any]] = []
    end = 0
    for block in FENCE.finditer(text):
        between = text[end : block.start()].strip()
        end = block.end()
        if between:
            cells.append(written(between, page))
        if block[1] == "python":
            cells.append({"cell_type": "code", "execution_count": None, "outputs": [], "source": lines(block[2])})
        elif block[1] == "text" and not between and cells:
            cells[-1]["outputs"] = [{"output_type": "stream", "name": "stdout", "text": lines(block[2])}]
        else:
            cells.append({"cell_type": "markdown", "source": lines(block[0])})
    cells.append(written(text[end:].strip(), page))
    cells = [cell for cell in cells if cell["source"]]
    numbered = [{"id": f"cell-{number}", "metadata": {}, **cell} for number, cell in enumerate(cells)]
    return {"cells": numbered, "metadata": {"kernelspec": KERNEL}, "nbformat": 4, "nbformat_minor": 5}


def written(text: str, page: Path) -> dict[str, Any]:
    """Cell of text."""

    def named(match: re.Match[str]) -> str:
        target, _, anchor = match[2].partition("#")
        if "://" in target:
            return match[0]
        root = TUTORIALS.parents[1]
        place = (page.parent / target).resolve().relative_to(root).as_posix()
        return f"{match[1]} (`{place}{'#' if anchor else ''}{anchor}`)"

    return {"cell_type": "markdown", "source": lines(LINK.sub(named, PICTURE.sub("", text + "\n")).strip())}


def lines(text: str) -> list[str]:
    """Lines of a cell, each but the last with its end."""
    return text.rstrip("\n").splitlines(keepends=True)


def as_text(page: Path) -> str:
    """Notebook of a tutorial as the text of its file."""
    return json.dumps(notebook(page), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for tutorial in sorted(TUTORIALS.glob("*.md")):
        (folder / f"{tutorial.stem}.ipynb").write_text(as_text(tutorial), encoding="utf-8")
        print(folder / f"{tutorial.stem}.ipynb")
