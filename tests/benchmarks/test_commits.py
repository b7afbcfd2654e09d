"""Every file of figures names the commit of the code that made them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.json")), ids=lambda path: path.name)
def test_figures_name_their_commit(file: Path) -> None:
    found = json.loads(file.read_text(encoding="utf-8"))
    commit = found["commit"] if "commit" in found else found["machine"]["commit"]
    assert re.fullmatch(r"[0-9a-f]{40}( \+ changes)?", commit)
