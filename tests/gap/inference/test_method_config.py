"""The numbers of the method stand in one place."""

from __future__ import annotations

import ast
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

import torchweather.gap
from torchweather.gap.inference.config import METHOD

ROOM = Path(torchweather.gap.__file__).parent
# Mathematics and plain tables: no choice of the method.
NO_CHOICE = {
    *("CENTRAL_90", "LEAST_SCATTER", "DEEP", "ANSCOMBE", "NOTHING", "TINY", "COUNTING"),
    *("FEWEST", "LEAST", "LENGTHS", "EXPONENTS"),
}


def constants(path: Path) -> set[str]:
    """Names of the numbers that a module defines."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        numbers = [one for one in ast.walk(node) if isinstance(one, ast.Constant) and type(one.value) in (int, float)]
        found |= {one.id for one in targets if isinstance(one, ast.Name) and one.id.isupper() and numbers}
    return found


@pytest.mark.parametrize("folder", ["inference", "statistics"])
def test_no_number_of_the_method_stands_elsewhere(folder: str) -> None:
    found = {path.name: constants(path) - NO_CHOICE for path in (ROOM / folder).glob("*.py")}
    assert not {name: names for name, names in found.items() if names}, "put it into InferenceConfig"


def test_the_numbers_cannot_be_changed_in_passing() -> None:
    with pytest.raises(FrozenInstanceError):
        METHOD.alarm_p = 0.5  # type: ignore[misc]
