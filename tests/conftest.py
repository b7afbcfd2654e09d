"""Where the real recordings are, and the visible skip where they are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.recordings import recording


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """Path of a real recording below the folder that TORCHWEATHER_REAL_DATA names."""
    return recording
