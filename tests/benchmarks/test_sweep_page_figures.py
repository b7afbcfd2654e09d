"""docs/sweep-figures.md says what benchmarks/real_sweeps.json says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_is_made_of_the_committed_figures() -> None:
    done = subprocess.run([sys.executable, str(ROOT / "benchmarks/real_sweeps.py"), "--check"], check=False)
    assert done.returncode == 0, "run python benchmarks/real_sweeps.py --page"
