"""Reference of the Python names: a page for each module, class and function, written when the site is built.

The list of names is docs/public-names.md, which a test compares with the code. Modules are read, not imported: the
site is built without PyTorch.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pictures import picture_of_class, read_table, slider

PACKAGE = "torchweather"
SECTION = re.compile(r"^## `(torchweather[\w.]*)`: (.*)$", re.MULTILINE)
CODE = re.compile(r"`(\w+)`")
LONGEST_VALUE = 60
KINDS = {"class": "Classes", "function": "Functions", "value": "Values"}


@dataclass(frozen=True)
class Name:
    """A public name.

    Args:
        module: public module that it is imported from.
        name: the name.
        found: what it names; ``None`` where reading the source does not tell.
        twin: another name of the module differs in case alone.
    """

    module: str
    name: str
    found: griffe.Object | None
    twin: bool = False

    @property
    def kind(self) -> str:
        """``class``, ``function`` or ``value``."""
        if self.found is not None and self.found.is_class:
            return "class"
        return "function" if self.found is not None and self.found.is_function else "value"

    @property
    def path(self) -> str:
        """Where the source defines it."""
        return f"{self.module}.{self.name}" if self.found is None else self.found.path

    @property
    def first_line(self) -> str:
        """First sentence of the docstring, or the value of a constant."""
        if self.found is not None and self.found.docstring is not None:
            return " ".join(self.found.docstring.value.split("\n\n")[0].split()).replace("|", "\\|")
        value = str(getattr(self.found, "value", "") or "")
        return f"`{value}`" if value and len(value) <= LONGEST_VALUE and "|" not in value and "`" not in value else ""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    docs = Path(config.docs_dir)
    modules = public_names(docs / "public-names.md", docs.parent)
    table = read_table(docs)
    home: dict[str, Name] = {}
    for names in modules.values():
        for name in names:
            home.setdefault(name.path, name)
    pages = {"reference/python.md": overview(modules, docs / "public-names.md")}
    for module, names in modules.items():
        pages[f"reference/{module}.md"] = module_page(module, names, home)
    for name in home.values():
        if name.kind != "value":
            pages[page_of(name)] = page_in_full(name, table)
    if len({uri.lower() for uri in pages}) < len(pages):
        raise PluginError("pages of the reference differ in case alone: one would be lost on a disk that ignores case")
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def public_names(page: Path, root: Path) -> dict[str, list[Name]]:
    """Public names of each module, with what the source says of them."""
    loader = griffe.GriffeLoader(search_paths=[root], docstring_parser="google")
    package = loader.load(PACKAGE, try_relative_path=False)
    loader.resolve_aliases(implicit=True, external=False)
    parts = SECTION.split(page.read_text(encoding="utf-8"))[1:]
    listed: dict[str, list[Name]] = {}
    for module, _, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        listed[module] = with_twins([Name(module, name, find(package, module, name)) for name in CODE.findall(text)])
    return listed


def with_twins(names: list[Name]) -> list[Name]:
    """Names of a module, with a mark on those that differ in case alone, such as ``Rates`` and ``rates``."""
    small = [name.name.lower() for name in names]
    return [replace(name, twin=small.count(name.name.lower()) > 1) for name in names]


def find(package: griffe.Object | griffe.Alias, module: str, name: str) -> griffe.Object | None:
    """Object that a public name stands for."""
    inside = f"{module}.{name}".removeprefix(f"{PACKAGE}.")
    try:
        member = package[inside]
        if member.is_module and name in member.members:  # a file of the same name
            member = member.members[name]
        return member.final_target if member.is_alias else member
    except KeyError as error:
        raise PluginError(f"docs/public-names.md lists {module}.{name}, which the source does not define") from error
    except (griffe.AliasResolutionError, griffe.CyclicAliasError):
        return None  # a value that another library defines


def page_of(name: Name) -> str:
    """Page of a class or function; twins get different ones on a disk that ignores case, too."""
    return f"reference/{name.module}/{name.name}{f'-{name.kind}' if name.twin else ''}.md"


def overview(modules: dict[str, list[Name]], page: Path) -> str:
    """All modules on one page."""
    about = dict(SECTION.findall(page.read_text(encoding="utf-8")))
    rows = [f"| [`{module}`]({module}.md) | {about[module]} | {len(names)} |" for module, names in modules.items()]
    return "\n".join(["# Python", "", "| module | what is in it | names |", "| --- | --- | ---: |", *rows, ""])


def module_page(module: str, names: list[Name], home: dict[str, Name]) -> str:
    """Lists of a module's names by kind."""
    lines = [f"# {module}", "", "[Python](python.md)"]
    for kind, title in KINDS.items():
        listed = [name for name in names if name.kind == kind]
        lines += ["", f"## {title}", ""] if listed else []
        for name in listed:
            about = f": {name.first_line}" if name.first_line else ""
            lines.append(f"- {link_to(name, home[name.path])}{about}")
    return "\n".join([*lines, ""])


def link_to(name: Name, first: Name) -> str:
    """Link from a module's page to the page of a name."""
    if name.kind == "value":
        return f"`{name.name}`"
    return f"[`{name.name}`]({page_of(first).removeprefix('reference/')})"


def page_in_full(name: Name, table: dict[str, Any]) -> str:
    """A class with its methods, or a function; with its picture of the gallery where there is one."""
    shown = picture_of_class(name.name, table)
    picture = []
    if shown is not None:
        sensor = shown["sensor"]
        picture = [slider(shown, "../../../"), "", f"*{shown['title']} ([gallery](../../gallery/{sensor}.md)).*", ""]
    return "\n".join(
        [
            f"# {name.name}",
            "",
            f"[Python](../python.md) / [`{name.module}`](../{name.module}.md)",
            "",
            "```python",
            f"from {name.module} import {name.name}",
            "```",
            "",
            *picture,
            f"::: {name.path}",
            "    options:",
            "      heading_level: 2",
            "      show_root_heading: true",
            "",
        ]
    )
