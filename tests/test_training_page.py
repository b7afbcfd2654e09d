"""The page about training in weather says what the numbers say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]


def test_the_table_is_that_of_the_numbers() -> None:
    found = json.loads((ROOT / "benchmarks" / "train_in_weather.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "training-in-weather.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")][2:]
    assert len(rows) == len(found["tests"])
    for k, (row, test) in enumerate(zip(rows, found["tests"], strict=True)):
        assert row[0] == test["name"] + ("" if test["trained_on"] else " *")
        cells = []
        for scores in found["scores"].values():
            clear, weather = (np.array(scores[arm])[:, k] for arm in ("clear", "weather"))
            assert len(clear) == 3
            gain = weather - clear
            cells += [f"{clear.mean():.2f}", f"{weather.mean():.2f}"]
            cells.append(f"{gain.mean():+.2f} ({abs(gain - gain.mean()).max():.2f})")
        assert row[1:] == cells


def test_weather_in_training_helps_in_weather_that_was_not_trained_on() -> None:
    found = json.loads((ROOT / "benchmarks" / "train_in_weather.json").read_text(encoding="utf-8"))
    for scores in found["scores"].values():
        unseen = [k for k, test in enumerate(found["tests"]) if not test["trained_on"]]
        clear, weather = (np.array(scores[arm])[:, unseen].mean(1) for arm in ("clear", "weather"))
        assert (weather > clear).all()  # of every seed
