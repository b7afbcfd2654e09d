"""The page on other libraries: lines that need one run where it is installed, and are skipped visibly where not."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import sys
import types
import warnings
from pathlib import Path

import pytest

from tests.test_docs import blocks

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "other-libraries.md"
NEEDS = re.compile(r"^<!-- needs: (\w+) -->\n\n```py$", re.MULTILINE)
# These warn on import, or of their own settings.
WARN = ("lightning", "tensorboard", "albumentations", "datasets", "rerun", "wandb")
IN_CI = ("webdataset", "hydra")


def needed() -> dict[str, int]:
    """Each library and the line at which its block begins."""
    text = PAGE.read_text(encoding="utf-8")
    return {match[1]: text.count("\n", 0, match.end()) + 2 for match in NEEDS.finditer(text)}


# webdataset leaves its shard to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("library", needed())
def test_the_lines_of_a_library_run_where_it_is_installed(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ALBUMENTATIONS_OFFLINE", "1")  # it asks for its newest version on import
    module = types.ModuleType("a_page_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    (block,) = [one for one in blocks(PAGE) if one.line == needed()[library]]
    code = "import numpy as np\nimport torch\nimport torchweather as tw\n" + block.text
    printed = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(printed):
        if library in WARN:
            warnings.simplefilter("ignore")
        exec(compile(code, f"{PAGE.name}, {library}", "exec"), module.__dict__)
    if block.printed is not None:
        assert printed.getvalue().split() == block.printed.split()


def test_the_table_says_what_runs_in_ci() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert set(IN_CI) <= set(needed())
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert any("webdataset" in row and "Hydra" in row and "| in CI |" in row for row in rows)
    assert len(needed()) == 8
