"""The page about training in weather holds the numbers of its run, and claims no more than they say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tests.running_examples import load_example

ROOT = Path(__file__).parents[1]
FOUND = json.loads((ROOT / "benchmarks" / "train_in_weather.json").read_text(encoding="utf-8"))
PAGE = (ROOT / "docs" / "training-in-weather.md").read_text(encoding="utf-8")


def rows_of(sensor: str) -> list[dict[str, Any]]:
    return [row for row in FOUND["rows"] if row["sensor"] == sensor]


def test_the_tables_are_those_of_the_numbers() -> None:
    results = load_example("parts/training_results.py")
    for sensor in dict.fromkeys(row["sensor"] for row in FOUND["rows"]):
        for lines in (results.table(rows_of(sensor), sensor), results.ablations(rows_of(sensor), sensor)):
            assert lines in PAGE, lines


def test_a_table_has_means_and_the_farthest_seeds() -> None:
    results = load_example("parts/training_results.py")
    row = {"sensor": "s", "test": "t", "arm": "a", "scores": [0.1, 0.2, 0.6]}
    rows = [{**row, "simulator": "independent"}, {**row, "simulator": "own"}]
    rows += [{**row, "simulator": "independent", "arm": "without b", "scores": [0.5], "ablation": True}]
    wanted = ["| tested in | a |", "| --- | --- |", "| t | 0.300 (0.300) |", "| t, own simulator | 0.300 (0.300) |"]
    assert results.table(rows, "s").splitlines() == wanted
    assert results.ablations(rows, "s").splitlines() == [
        "| arm | t |",
        "| --- | --- |",
        "| without b | 0.500 (0.000) |",
    ]


def test_every_row_has_its_settings() -> None:
    for row in FOUND["rows"]:
        assert {"seeds", "steps", "train_scenes", "test_scenes", "simulator"} <= set(row)
        assert len(row["scores"]) in (1, row["seeds"])
        if "camera" in row["sensor"]:
            assert row["trained_in"] != row["tested_in"]


def test_the_page_states_the_gain_over_the_naive_lines() -> None:
    """Mean over the weathers of the independent test, seed by seed."""
    for sensor in dict.fromkeys(row["sensor"] for row in FOUND["rows"]):
        own = [row for row in rows_of(sensor) if row["simulator"] in ("independent", "recorded")]
        own = [row for row in own if row["test"] != "clear"]
        drawn, naive = (
            np.array([row["scores"] for row in own if row["arm"] == arm]).mean(0) for arm in ("library, drawn", "naive")
        )
        assert ", ".join(f"{one:+.3f}" for one in drawn - naive) in PAGE


def test_the_renderer_of_the_test_owes_nothing_to_the_library() -> None:
    text = (ROOT / "benchmarks" / "independent_weather.py").read_text(encoding="utf-8")
    imports = [line.split()[1].partition(".")[0] for line in text.splitlines() if line.startswith(("import ", "from "))]
    assert set(imports) == {"__future__", "math", "dataclasses", "typing", "numpy"}
