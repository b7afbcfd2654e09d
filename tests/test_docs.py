"""README and docs: every Python block runs, every command parses, every link leads somewhere."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import sys
import types
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from torchweather.cli.program import build_parser
from torchweather.stages import STAGES

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
NOTEBOOKS = ROOT / "docs" / "tutorials"  # run as notebooks by tests/test_docs_notebooks.py
CI_SCRIPT = ROOT / ".ci" / "run"

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
# Takes several seconds and 150 MB at the full resolution that it is about; the same calls run elsewhere.
NOT_RUN = {"docs/as_bayer.md"}
LONG = {"docs/how-to/export-to-onnx.md", "docs/how-to/one-onnx-graph.md"}


class Block(NamedTuple):
    language: str
    text: str
    line: int
    printed: str | None  # the block after it, where that is what it prints


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    listed = []
    for match, after in pairwise([*found, None]):
        assert match is not None  # only the last one is
        follows = after is not None and after[1] == "text" and not text[match.end() : after.start()].strip()
        line = text.count("\n", 0, match.start(2)) + 1
        listed.append(Block(match[1], match[2], line, after[2] if follows and after is not None else None))
    return listed


def commands(page: Path) -> list[str]:
    lines = [line for block in blocks(page) if block.language == "sh" for line in block.text.splitlines()]
    return [line.rpartition("bin/")[2] for line in lines if re.match(r"(\.venv/bin/)?torchweather ", line)]


@pytest.fixture
def only_own_stages() -> Iterator[None]:
    """A stage that a page registers is forgotten after it."""
    before = dict(STAGES)
    yield
    STAGES.clear()
    STAGES.update(before)


def runnable(page: Path) -> object:
    """A page as a case; a page whose graphs take half a minute is left to the long run, as tests/export makes them."""
    return pytest.param(page, marks=[pytest.mark.long] if name_of(page) in LONG else [], id=name_of(page))


@pytest.mark.usefixtures("only_own_stages")
@pytest.mark.parametrize(
    "page",
    [
        runnable(page)
        for page in PAGES
        if page.parent != NOTEBOOKS and any(block.language == "python" for block in blocks(page))
    ],
)
def test_python_on_a_page_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name_of(page) in NOT_RUN:
        pytest.skip("slow: a full frame; its calls run in tests/camera/test_as_bayer.py")
    monkeypatch.chdir(tmp_path)
    # A real module, because classes of a page ask for theirs.
    module = types.ModuleType("a_page_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for block in blocks(page):
        if block.language != "python":
            continue
        code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(code, module.__dict__)
        if block.printed is not None:
            assert printed.getvalue().split() == block.printed.split(), f"{name_of(page)}, line {block.line}"


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=name_of)
def test_commands_on_a_page_are_understood(page: Path) -> None:
    for command in commands(page):
        # argparse leaves the process where it does not understand.
        build_parser().parse_args(shlex.split(command, comments=True)[1:])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_on_a_page_lead_to_files(page: Path) -> None:
    targets = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing


def test_every_page_is_reached_from_the_index() -> None:
    index = ROOT / "docs" / "index.md"
    reached = {(index.parent / link).resolve() for link in LINK.findall(index.read_text(encoding="utf-8"))}
    pages = {page.resolve() for page in PAGES if page not in (index, ROOT / "README.md")}
    assert pages <= reached


def test_ci_runs_the_command_that_the_readme_gives() -> None:
    if not CI_SCRIPT.exists():
        pytest.skip("no .ci here (it is not part of the source distribution)")
    shown = [line for block in blocks(ROOT / "README.md") if block.language == "sh" for line in block.text.splitlines()]
    (test_command,) = [line for line in shown if "pytest" in line]
    assert test_command in CI_SCRIPT.read_text(encoding="utf-8").splitlines()
