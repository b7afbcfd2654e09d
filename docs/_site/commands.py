"""Reference of the command line, written from its parsers when the site is built."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

# Placeholders such as <folder> in a help text are words, not tags.
TAG = re.compile(r"<([^>\n]*)>")
WIDTH = 88


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page."""
    root = str(Path(config.docs_dir).parent)
    if root not in sys.path:
        sys.path.insert(0, root)
    from torchweather.cli.program import build_parser

    text = "\n".join(["# Command line", "", *page_of(build_parser())])
    files.append(File.generated(config, "reference/command-line.md", content=text))
    return files


def page_of(program: argparse.ArgumentParser) -> list[str]:
    """Lines of the page: every command, and the commands below it."""
    lines = [f"{program.description}", "", "| command | what it does |", "| --- | --- |"]
    commands = subcommands(program)
    lines += [f"| [`{name}`](#{anchor(name)}) | {help_text} |" for name, _, help_text in commands]
    for name, parser, _ in commands:
        lines += section(name, parser, 2)
    return [*lines, ""]


def subcommands(parser: argparse.ArgumentParser) -> list[tuple[str, argparse.ArgumentParser, str]]:
    """Name, parser and help of the commands of a parser."""
    found = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
            found += [(name, sub, plain(helps.get(name, ""))) for name, sub in action.choices.items()]
    return found


def section(name: str, parser: argparse.ArgumentParser, level: int) -> list[str]:
    """A command: description, usage, arguments."""
    parser.formatter_class = narrow
    lines = ["", f"{'#' * level} {name} {{#{anchor(name)}}}", "", plain(parser.description or ""), ""]
    lines += ["```text", parser.format_usage().removeprefix("usage: ").rstrip(), "```", ""]
    rows = [row(parser, action) for action in parser._actions if shown(action)]
    if rows:
        lines += ["| argument | meaning | default |", "| --- | --- | --- |", *rows]
    for below, sub, _ in subcommands(parser):
        lines += section(f"{name} {below}", sub, level + 1)
    return lines


def narrow(prog: str) -> argparse.HelpFormatter:
    """Formatter of a fixed width, whatever the terminal."""
    return argparse.HelpFormatter(prog, width=WIDTH)


def shown(action: argparse.Action) -> bool:
    """Arguments that a user gives."""
    hidden = isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
    return not hidden and action.help is not argparse.SUPPRESS


def row(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """A row of the table of arguments."""
    value = "" if action.nargs == 0 else argument(action)
    names = ", ".join(f"`{' '.join([name, value]).strip()}`" for name in action.option_strings) or f"`{value}`"
    default = action.default
    hidden = default in (None, False, argparse.SUPPRESS, (), []) or action.nargs == 0
    text = plain(parser._get_formatter()._expand_help(action) if action.help else "")
    return f"| {names} | {text} | {'' if hidden else f'`{cell(str(default))}`'} |"


def argument(action: argparse.Action) -> str:
    """Placeholder of an argument's value."""
    if action.metavar is not None:
        word = " ".join(action.metavar) if isinstance(action.metavar, tuple) else action.metavar
    elif action.choices is not None:
        word = ",".join(str(choice) for choice in action.choices)
    else:
        word = action.dest.upper()
    return f"{word} ..." if action.nargs in ("+", "*") else word


def plain(text: str) -> str:
    """A help text as Markdown of one line."""
    return cell(TAG.sub(r"&lt;\1&gt;", " ".join(text.split())))


def cell(text: str) -> str:
    """A text in the cell of a table."""
    return text.replace("|", "\\|")


def anchor(name: str) -> str:
    """Anchor of a command."""
    return name.replace(" ", "-")
