"""Scores of nets by the weather that they were trained in, as tables and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Rows = list[dict[str, Any]]
"""One a test and arm: ``sensor``, ``simulator`` (independent, own, recorded, development), ``test``, ``arm``, and
``scores`` of the seeds."""


SUFFIX = {"own": ", own simulator", "development": ", used for choices"}


def table(rows: Rows, sensor: str) -> str:
    """Tests by arms: mean of the seeds, and in brackets the largest distance of a seed from it; Markdown."""
    own = [row for row in rows if row["sensor"] == sensor]
    arms = list(dict.fromkeys(row["arm"] for row in own))
    lines = [f"| tested in | {' | '.join(arms)} |", f"| --- |{' --- |' * len(arms)}"]
    for simulator, test in dict.fromkeys((row["simulator"], row["test"]) for row in own):
        cells = []
        for arm in arms:
            found = [
                np.array(row["scores"])
                for row in own
                if (row["test"], row["simulator"], row["arm"]) == (test, simulator, arm)
            ]
            cells.append(f"{found[0].mean():.3f} ({np.abs(found[0] - found[0].mean()).max():.3f})" if found else "-")
        name = f"{test}{SUFFIX.get(simulator, '')}"
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def gains(rows: Rows, sensor: str, arm: str, over: str) -> list[float]:
    """By seed: an arm's mean score over another's, in all weathers of the independent or recorded test."""
    own = [
        row
        for row in rows
        if row["sensor"] == sensor and row["simulator"] in ("independent", "recorded") and row["test"] != "clear"
    ]
    mine, other = (np.array([row["scores"] for row in own if row["arm"] == name]).mean(0) for name in (arm, over))
    return [float(one) for one in mine - other]


def draw(rows: Rows, path: Path) -> None:
    sensors = list(dict.fromkeys(row["sensor"] for row in rows))
    figure, axes = plt.subplots(1, len(sensors), figsize=(6.4 * len(sensors), 4.6), constrained_layout=True)
    for axis, sensor in zip(np.atleast_1d(axes), sensors, strict=True):
        own = [row for row in rows if row["sensor"] == sensor]
        tests = list(dict.fromkeys((row["simulator"], row["test"]) for row in own))
        for arm in dict.fromkeys(row["arm"] for row in own):
            means = {(row["simulator"], row["test"]): np.mean(row["scores"]) for row in own if row["arm"] == arm}
            axis.plot([means.get(test, np.nan) for test in tests], "o", label=arm, alpha=0.8)
        names = [f"{test}{SUFFIX.get(simulator, '')}" for simulator, test in tests]
        axis.set_xticks(range(len(tests)), names, rotation=40, ha="right")
        axis.set_ylabel(sensor)
        axis.set_ylim(0, 1)
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    figure.savefig(path, dpi=110)
    plt.close(figure)
