"""Files of the repository that pages link to, brought into the site.

Pages link to scripts, records and Markdown beside ``docs/``, as GitHub shows them. The site has a copy of each
below ``repository/``. A link to a file that does not exist stays as it is, and the strict build refuses it.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

FOLDER = "repository"
LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)]*)?\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add every file that a page links to, and those that added pages link to."""
    root, docs = roots(config)
    waiting = [file for file in files.documentation_pages() if file.abs_src_path is not None]
    known = {file.src_uri for file in files}
    while waiting:
        file = waiting.pop()
        for target in linked(file.content_string, place_of(file.src_uri, root, docs), root):
            uri = uri_of(target, root, docs)
            if uri in known:
                continue
            known.add(uri)
            added = File.generated(config, uri, content=target.read_bytes())
            files.append(added)
            if added.is_documentation_page():
                waiting.append(added)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to the site's copies."""
    root, docs = roots(config)
    folder = place_of(page.file.src_uri, root, docs)

    def rewritten(match: re.Match[str]) -> str:
        target = target_of(match[2], folder, root)
        if target is None:
            return match[0]
        uri = uri_of(target, root, docs)
        return match[1] + posixpath.relpath(uri, posixpath.dirname(page.file.src_uri) or ".") + match[3]

    return LINK.sub(rewritten, markdown)


def roots(config: MkDocsConfig) -> tuple[Path, Path]:
    """Folder of the repository and of the documentation."""
    docs = Path(config.docs_dir).resolve()
    return docs.parent, docs


def place_of(uri: str, root: Path, docs: Path) -> Path:
    """Folder in the repository that holds a page of the site."""
    inside = uri.removeprefix(f"{FOLDER}/")
    return (root / inside if inside != uri else docs / uri).parent


def uri_of(target: Path, root: Path, docs: Path) -> str:
    """Place of a file in the site."""
    if target.is_relative_to(docs):
        return target.relative_to(docs).as_posix()
    return f"{FOLDER}/{target.relative_to(root).as_posix()}"


def target_of(link: str, folder: Path, root: Path) -> Path | None:
    """File of the repository that a link leads to; ``None`` for other hosts, folders and missing files."""
    if "://" in link or link.startswith(("/", "mailto:")):
        return None
    target = (folder / link).resolve()
    return target if target.is_file() and target.is_relative_to(root) else None


def linked(markdown: str, folder: Path, root: Path) -> list[Path]:
    """Files of the repository that a page links to."""
    targets = (target_of(match[2], folder, root) for match in LINK.finditer(markdown))
    return [target for target in targets if target is not None]
