"""Where the real recordings are, and the visible skip where they are not."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """Path of a real recording below the folder that TORCHWEATHER_REAL_DATA names."""
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root:
        pytest.skip("TORCHWEATHER_REAL_DATA is not set: no real recordings here")

    def find(name: str) -> Path:
        found = sorted(Path(root).glob(name))
        if not found:
            pytest.skip(f"TORCHWEATHER_REAL_DATA holds no {name}")
        return found[0]

    return find
