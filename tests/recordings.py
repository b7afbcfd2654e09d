"""Where recordings lie that cannot be shipped: the folder that ``TORCHWEATHER_REAL_DATA`` names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def recording(pattern: str) -> Path:
    """The first file or folder of a pattern in that folder; the test is skipped, visibly, where there is none."""
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root:
        pytest.skip("TORCHWEATHER_REAL_DATA is not set: no real recordings here")
    found = sorted(Path(root).glob(pattern))
    if not found:
        pytest.skip(f"TORCHWEATHER_REAL_DATA holds no {pattern}")
    return found[0]
