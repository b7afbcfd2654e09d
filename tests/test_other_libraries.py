"""The page on other libraries: lines that need one run where it is installed, and are skipped visibly where not.

CI installs the extra `interop` in an environment of its own; there, a skipped test is an error (`.ci/run`).
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import sys
import tomllib
import types
import warnings
from pathlib import Path

import pytest

from tests.test_docs import blocks

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "other-libraries.md"
NEEDS = re.compile(r"^<!-- needs: (\w+) -->\n\n```py$", re.MULTILINE)
# These warn on import, or of their own settings.
WARN = ("lightning", "tensorboard", "albumentations", "datasets", "rerun", "wandb")
PACKAGES = {"hydra": "hydra-core", "rerun": "rerun-sdk"}  # names at the index, where they are not that of the module


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


def test_ci_installs_what_the_page_needs() -> None:
    project = tomllib.loads((PAGE.parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = project["optional-dependencies"]["interop"]
    assert sorted(PACKAGES.get(library, library) for library in needed()) == extra
    rows = [row for row in PAGE.read_text(encoding="utf-8").splitlines() if row.startswith("|") and "`interop`" in row]
    assert len(rows) == 1
    assert rows[0].count("](#") == len(extra)
