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
    own = [row for row in rows if row["sensor"] == sensor and not row.get("ablation")]
    arms = list(dict.fromkeys(row["arm"] for row in own))
    lines = [f"| tested in | {' | '.join(arms)} |", f"| --- |{' --- |' * len(arms)}"]
    for simulator, test in dict.fromkeys((row["simulator"], row["test"]) for row in own):
        cells = [cell(own, simulator, test, arm) for arm in arms]
        lines.append(f"| {test}{SUFFIX.get(simulator, '')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def ablations(rows: Rows, sensor: str) -> str:
    """Arms that lack or change one part, by the tests that are not of the own simulator; Markdown, empty for none."""
    own = [row for row in rows if row["sensor"] == sensor and row.get("ablation") and row["simulator"] != "own"]
    tests = list(dict.fromkeys((row["simulator"], row["test"]) for row in own))
    names = [f"{test}{SUFFIX.get(simulator, '')}" for simulator, test in tests]
    lines = [f"| arm | {' | '.join(names)} |", f"| --- |{' --- |' * len(tests)}"]
    for arm in dict.fromkeys(row["arm"] for row in own):
        lines.append(f"| {arm} | {' | '.join(cell(own, *test, arm) for test in tests)} |")
    return "\n".join(lines) if own else ""


def cell(rows: Rows, simulator: str, test: str, arm: str) -> str:
    wanted = (simulator, test, arm)
    found = [np.array(row["scores"]) for row in rows if (row["simulator"], row["test"], row["arm"]) == wanted]
    return f"{found[0].mean():.3f} ({np.abs(found[0] - found[0].mean()).max():.3f})" if found else "-"


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
    figure, axes = plt.subplots(1, len(sensors), figsize=(6.4 * len(sensors), 5.4), constrained_layout=True)
    for axis, sensor in zip(np.atleast_1d(axes), sensors, strict=True):
        own = [row for row in rows if row["sensor"] == sensor and not row.get("ablation")]
        tests = list(dict.fromkeys((row["simulator"], row["test"]) for row in own))
        for arm in dict.fromkeys(row["arm"] for row in own):
            means = {(row["simulator"], row["test"]): np.mean(row["scores"]) for row in own if row["arm"] == arm}
            axis.plot([means.get(test, np.nan) for test in tests], "o", label=arm, alpha=0.8)
        names = [f"{test}{SUFFIX.get(simulator, '')}" for simulator, test in tests]
        axis.set_xticks(range(len(tests)), names, rotation=40, ha="right")
        axis.set_title(sensor, fontsize="medium")
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    figure.savefig(path, dpi=110)
    plt.close(figure)
