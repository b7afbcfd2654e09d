"""Scores of nets trained clear and in weather, as a table and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Tests = Sequence[tuple[str, bool]]
"""Name of each test, and whether it lies within what was trained on."""


def table(scores: dict[str, Any], name: str, tests: Tests) -> str:
    lines = [f"{name}, mean of {len(scores['clear'])} seeds (largest distance from it)", ""]
    lines.append(f"{'tested in':28s} {'trained clear':>16s} {'trained in weather':>20s} {'gain':>16s}")
    clear, weather = (np.array(scores[arm]) for arm in ("clear", "weather"))
    for k, (test, inside) in enumerate(tests):
        cells = [f"{v.mean():.2f} ({abs(v - v.mean()).max():.2f})" for v in (clear[:, k], weather[:, k])]
        gain = weather[:, k] - clear[:, k]
        cells.append(f"{gain.mean():+.2f} ({abs(gain - gain.mean()).max():.2f})")
        mark = "" if inside else " *"
        lines.append(f"{test + mark:28s} {cells[0]:>16s} {cells[1]:>20s} {cells[2]:>16s}")
    return "\n".join([*lines, "* outside of what was trained on"])


def spread(values: np.ndarray) -> np.ndarray:
    """Distances of the least and the greatest from the mean, ``(2, tests)``."""
    mean = values.mean(0)
    return np.stack([mean - values.min(0), values.max(0) - mean])


def draw(results: dict[str, Any], tests: Tests, path: Path) -> None:
    figure, axes = plt.subplots(1, len(results), figsize=(6.4 * len(results), 4.6), constrained_layout=True)
    names = [name if inside else f"{name} *" for name, inside in tests]
    place = np.arange(len(names))
    kinds = [name.split()[0] if "in" not in name.split() else "mixture" for name, _ in tests]
    groups = [[k for k, one in enumerate(kinds) if one == kind] for kind in dict.fromkeys(kinds)]
    for axis, (title, scores) in zip(np.atleast_1d(axes), results.items(), strict=True):
        for arm, colour, label in (("clear", "0.45", "trained clear"), ("weather", "tab:blue", "trained in weather")):
            values = np.array(scores[arm])
            for group in groups:  # of one weather, light to heavy
                axis.plot(place[group], values.mean(0)[group], "o-", color=colour, label=label)
                axis.errorbar(place[group], values.mean(0)[group], spread(values)[:, group], color=colour, capsize=3)
                label = None
        axis.set_xticks(place, names, rotation=40, ha="right")
        axis.set_ylim(0, 1)
        axis.set_ylabel(title)
        axis.grid(alpha=0.3)
    said = "mean of the seeds, bars: all of them; *: outside of what was trained on"
    handles, labels = np.atleast_1d(axes)[0].get_legend_handles_labels()
    figure.legend(handles, labels, title=said, loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(path, dpi=110)
