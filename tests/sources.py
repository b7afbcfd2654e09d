"""Syntax trees of sources, walked faster than ``ast.walk`` walks them."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

__all__ = ["import_statements", "walk"]

BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")  # fields of statements that hold statements


def walk(tree: ast.AST) -> Iterator[ast.AST]:
    """Every node of a tree, in no particular order."""
    stack = [tree]
    while stack:
        node = stack.pop()
        yield node
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                stack.append(value)
            elif isinstance(value, list):
                stack += [one for one in value if isinstance(one, ast.AST)]


@cache
def import_statements(path: Path) -> list[tuple[ast.Import | ast.ImportFrom, bool]]:
    """Imports of a file, in functions as well; true for those that only type checkers read."""
    return list(_imports(ast.parse(path.read_text(encoding="utf-8")).body, for_types=False))


def _imports(block: Sequence[ast.AST], for_types: bool) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for node in block:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, for_types
        guarded = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for field in BLOCKS:
            yield from _imports(getattr(node, field, ()), for_types or (guarded and field == "body"))
