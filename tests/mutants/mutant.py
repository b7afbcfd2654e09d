"""One deliberate break, and where its text stands."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Mutant:
    """A break of one rule of the package.

    Args:
        name: short, unique over all rooms.
        breaks: the physics or the rule that is broken, one line.
        module: dotted name of the module that holds the text.
        old: text that occurs exactly once in the module.
        new: text in its place.
        tests: pytest node ids; each must go red. One without ``[...]`` stands for all its cases: one red is enough.
    """

    name: str
    breaks: str
    module: str
    old: str
    new: str
    tests: tuple[str, ...]

    def file(self, root: Path = ROOT) -> Path:
        """File of the module under a root."""
        path = root.joinpath(*self.module.split("."))
        return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")

    def mutated(self, root: Path = ROOT) -> str:
        """Source of the module with the break."""
        source = self.file(root).read_text(encoding="utf-8")
        if (found := source.count(self.old)) != 1:
            raise LookupError(f"{self.name}: expected its text once in {self.module}; found it {found} times.")
        return source.replace(self.old, self.new)


@cache
def _parsed(file: Path) -> list[ast.stmt]:
    """Statements of a file of tests, which many mutants name."""
    return ast.parse(file.read_text(encoding="utf-8")).body


def missing_test(node: str, root: Path = ROOT) -> str | None:
    """Complaint about a node id whose file, class or function does not exist; None where all do."""
    file, *names = node.split("[")[0].split("::")
    if not (root / file).is_file():
        return f"no file {file}"
    body = _parsed(root / file)
    for name in names:
        found = next((part for part in body if getattr(part, "name", None) == name), None)
        if found is None:
            return f"no {name} in {file}"
        body = list(getattr(found, "body", []))
    return None if names and names[-1].startswith("test") else f"{node} names no test function"
