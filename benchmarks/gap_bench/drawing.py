"""Pictures of a score."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from .table_text import short_name

__all__ = ["draw_calibration", "draw_confusion"]


def draw_confusion(confusion: dict[str, dict[str, int]], path: Path) -> None:
    """Truth down, answer across."""
    truths = sorted(confusion)
    answers = sorted({one for row in confusion.values() for one in row}, key=lambda one: (one not in truths, one))
    counts = np.array([[confusion[truth].get(one, 0) for one in answers] for truth in truths], dtype=float)
    figure, axes = plt.subplots(figsize=(0.32 * len(answers) + 4.0, 0.3 * len(truths) + 3.0), layout="constrained")
    share = counts / counts.sum(1, keepdims=True)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(answers)), [short_name(one) for one in answers], rotation=90, fontsize=7)
    axes.set_yticks(range(len(truths)), [short_name(one) for one in truths], fontsize=7)
    axes.set(xlabel="answered (number of studies; darker: larger share of a row)", ylabel="hidden")
    for (row, column), value in np.ndenumerate(counts):
        if value:
            ink = "white" if share[row, column] > 0.5 else "black"
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=6, color=ink)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_calibration(bins: list[dict[str, Any]], path: Path) -> None:
    """Share of right names over the confidence that was printed."""
    figure, axes = plt.subplots(figsize=(4.0, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", label="calibrated")
    for one in bins:
        if one["of"]:
            right = one["right"] / one["of"]
            low, high = one["wilson_95"]
            axes.errorbar(
                one["mean_confidence"], right, [[max(right - low, 0)], [max(high - right, 0)]], fmt="o", color="C0"
            )
            axes.annotate(str(one["of"]), (one["mean_confidence"], right), xytext=(4, -10), textcoords="offset points")
    axes.set(xlabel="confidence printed", ylabel="share of right names", xlim=(0, 1.03), ylim=(0, 1.03))
    axes.legend()
    figure.savefig(path, dpi=120)
    plt.close(figure)
