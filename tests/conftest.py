"""Where the real recordings are, and the visible skip where they are not; and a cheap collection of garbage."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.recordings import recording


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """Path of a real recording below the folder that TORCHWEATHER_REAL_DATA names."""
    return recording


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of every later collection: walking it took up to a second each."""
    gc.collect()
    gc.freeze()
