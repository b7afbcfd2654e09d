"""Notebooks of the tutorials, written when the site is built, and a line on each tutorial that leads to its own."""

from __future__ import annotations

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from notebook import TUTORIALS, as_text

FOLDER = "tutorials"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the notebooks."""
    for page in sorted(TUTORIALS.glob("*.md")):
        files.append(File.generated(config, f"{FOLDER}/{page.stem}.ipynb", content=as_text(page)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Offer the notebook under the heading."""
    uri = page.file.src_uri
    if not uri.startswith(f"{FOLDER}/"):
        return markdown
    heading, _, text = markdown.partition("\n")
    name = uri.removeprefix(f"{FOLDER}/").removesuffix(".md")
    return f"{heading}\n\n[Download as a notebook]({name}.ipynb)\n{text}"
