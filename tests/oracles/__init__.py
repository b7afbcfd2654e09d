"""Reference numbers from independent tools (miepython, mpmath, scipy, itur), each block with its own tolerance."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any


@lru_cache(maxsize=1)
def _all_blocks() -> dict[str, Any]:
    return json.loads((Path(__file__).parent / "physics_oracles.json").read_text(encoding="utf-8"))


def load(block: str) -> dict[str, Any]:
    """One block of the reference numbers, by name."""
    return _all_blocks()[block]
