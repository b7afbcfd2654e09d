"""Every case answers what it answered when the record was written, by `python -m tests.behaviour.record --write`."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import torch

from tests.behaviour.cases import cases
from tests.behaviour.digest import agree, exact, numbers
from tests.behaviour.record import RECORD, answered, differs, machine

RECORDED = json.loads(RECORD.read_text(encoding="utf-8"))


# Beside graphs that give what torch gives (tests/export) and studies that name what is hidden (tests/gap).
COSTLY = ("graphs/camera", "graphs/lidar", "graphs/radar", "studies/camera", "studies/lidar")


@pytest.mark.filterwarnings("ignore")  # of the exporter
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name in COSTLY else []) for name in cases()]
)
def test_the_answer_is_the_recorded_one(name: str) -> None:
    found, recorded = answered(name), RECORDED["cases"][name]
    assert not differs(name, found, recorded, machine() == RECORDED["machine"]), (found, recorded)


def test_the_record_has_no_case_that_is_gone() -> None:
    assert list(RECORDED["cases"]) == list(cases())


VALUES = torch.linspace(0.0, 1.0, 101)


@pytest.mark.parametrize(
    "other",
    [
        {"a": VALUES.flip(0)},
        {"a": VALUES * 1.0001},
        {"a": VALUES[:-1]},
        {"a": VALUES, "b": 0.0},
        {"a": torch.where(VALUES == 0.5, torch.nan, VALUES)},
    ],
)
def test_another_answer_has_another_hash_and_other_numbers(other: dict[str, Any]) -> None:
    assert exact(other) != exact({"a": VALUES})
    assert not agree(numbers(other), numbers({"a": VALUES}), 1e-5)


def test_rounding_is_another_hash_and_the_same_numbers() -> None:
    rounded = {"a": VALUES * np.float32(1.0 + 1e-6)}
    assert exact(rounded) != exact({"a": VALUES})
    assert agree(numbers(rounded), numbers({"a": VALUES}), 1e-5)
