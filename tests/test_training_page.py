"""The page about training in weather holds the numbers of its run, and claims no more than they say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
FOUND = json.loads((ROOT / "benchmarks" / "train_in_weather.json").read_text(encoding="utf-8"))
PAGE = (ROOT / "docs" / "training-in-weather.md").read_text(encoding="utf-8")


def rows_of(sensor: str) -> list[dict[str, Any]]:
    return [row for row in FOUND["rows"] if row["sensor"] == sensor]


def test_the_tables_are_those_of_the_numbers() -> None:
    for sensor in dict.fromkeys(row["sensor"] for row in FOUND["rows"]):
        own = rows_of(sensor)
        arms = list(dict.fromkeys(row["arm"] for row in own))
        assert f"| tested in | {' | '.join(arms)} |" in PAGE
        for simulator, test in dict.fromkeys((row["simulator"], row["test"]) for row in own):
            cells = []
            for arm in arms:
                [scores] = [
                    np.array(row["scores"])
                    for row in own
                    if (row["simulator"], row["test"], row["arm"]) == (simulator, test, arm)
                ]
                cells.append(f"{scores.mean():.3f} ({np.abs(scores - scores.mean()).max():.3f})")
            name = test if simulator == "independent" else f"{test}, own simulator"
            assert f"| {name} | {' | '.join(cells)} |" in PAGE


def test_every_row_has_its_settings() -> None:
    for row in FOUND["rows"]:
        assert {"seeds", "steps", "train_scenes", "test_scenes", "simulator"} <= set(row)
        assert len(row["scores"]) in (1, row["seeds"])
        if "camera" in row["sensor"]:
            assert row["trained_in"] != row["tested_in"]


def test_the_page_states_the_gain_over_the_naive_lines() -> None:
    """Mean over the weathers of the independent test, seed by seed."""
    for sensor in dict.fromkeys(row["sensor"] for row in FOUND["rows"]):
        own = [row for row in rows_of(sensor) if row["simulator"] == "independent" and row["test"] != "clear"]
        drawn, naive = (
            np.array([row["scores"] for row in own if row["arm"] == arm]).mean(0) for arm in ("library, drawn", "naive")
        )
        assert ", ".join(f"{one:+.3f}" for one in drawn - naive) in PAGE


def test_the_renderer_of_the_test_owes_nothing_to_the_library() -> None:
    text = (ROOT / "benchmarks" / "independent_weather.py").read_text(encoding="utf-8")
    imports = [line.split()[1].partition(".")[0] for line in text.splitlines() if line.startswith(("import ", "from "))]
    assert set(imports) == {"__future__", "math", "dataclasses", "typing", "numpy"}
