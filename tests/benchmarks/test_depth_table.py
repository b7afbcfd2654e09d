"""docs/depth-figures.md says what the benchmarks' files say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_is_made_of_the_committed_figures() -> None:
    done = subprocess.run([sys.executable, str(ROOT / "benchmarks/depth_table.py"), "--check"], check=False)
    assert done.returncode == 0, "run python benchmarks/depth_table.py"
