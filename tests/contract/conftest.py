"""The transforms of the table, one after the other, as fixtures."""

from __future__ import annotations

from typing import Any

import pytest

from tests.contract.table import TABLE, Entry, transform_of


@pytest.fixture(params=list(TABLE))
def name(request: pytest.FixtureRequest) -> str:
    """Name of an entry of the table."""
    found: str = request.param
    return found


@pytest.fixture
def entry(name: str) -> Entry:
    """The entry: how to build the transform, its inputs and its weathers."""
    return TABLE[name]


@pytest.fixture
def transform(name: str) -> Any:
    """The transform at the intensity that shows; shared, so a test that changes it takes a copy."""
    return transform_of(name)
