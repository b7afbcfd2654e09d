"""The numbers of the method stand in one place."""

from __future__ import annotations

import ast
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

import torchweather.gap
from torchweather.gap.inference.config import METHOD, InferenceConfig

ROOM = Path(torchweather.gap.__file__).parent
# Mathematics and plain tables: no choice of the method.
NO_CHOICE = {
    *("CENTRAL_90", "LEAST_SCATTER", "DEEP", "ANSCOMBE", "NOTHING", "TINY", "COUNTING"),
    *("FEWEST", "LEAST", "LENGTHS", "EXPONENTS"),
    *("TABLE_FROM", "TABLE_TO", "TABLE_PLACES", "LEAST_SPREAD", "MOST_SPREAD", "NODES", "FARTHEST", "POINTS"),
}


def constants(path: Path) -> set[str]:
    """Names of the numbers that a module defines."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        numbers = [one for one in ast.walk(node) if isinstance(one, ast.Constant) and type(one.value) in (int, float)]
        names = [one for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
        found |= {one.id for one in names if one.id.isupper() and numbers}
    return found


@pytest.mark.parametrize("folder", ["inference", "statistics"])
def test_no_number_of_the_method_stands_elsewhere(folder: str) -> None:
    found = {path.name: constants(path) - NO_CHOICE for path in (ROOM / folder).glob("*.py")}
    assert not {name: names for name, names in found.items() if names}, "put it into InferenceConfig"


def test_the_numbers_cannot_be_changed_in_passing() -> None:
    with pytest.raises(FrozenInstanceError):
        METHOD.alarm_p = 0.5  # type: ignore[misc]


def test_twenty_numbers_decide_at_most() -> None:
    assert len(fields(InferenceConfig)) <= 20


def test_constants_that_are_set_together_are_seen(tmp_path: Path) -> None:
    (tmp_path / "it.py").write_text('ONE, OTHER = 1, 2.5\nNAMES = ("a",)\n_alone: int = 3\n')
    assert constants(tmp_path / "it.py") == {"ONE", "OTHER"}
