"""Answers of the gap workflow, and pictures of a score."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from torchweather.core.errors import TorchweatherError
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.study import Study

from .bench_sensor import OtherMetrics
from .table_text import short_name

__all__ = ["answer", "draw_calibration", "draw_confusion"]


def answer(
    folder: Path, seed: int, effects: Sequence[str] | None = None, other_metrics: OtherMetrics | None = None
) -> dict[str, Any]:
    """What the workflow says of a study.

    Args:
        folder: of the study.
        seed: of the workflow.
        effects: that may be named; ``None``: all.
        other_metrics: of the sensor.

    Returns:
        ``seconds``, and ``report`` (as ``gap.json``), or ``error`` where the workflow refuses the study. Where an
        effect is named also ``other_metrics``, if the sensor has some; their time does not count. Any other exception
        is a fault of the workflow: it breaks the run off and is no answer.
    """
    from torchweather.gap import find_gap

    start = time.perf_counter()
    try:
        study = Study.read(folder)
        report = find_gap(study, effects=effects, seed=seed)
    except TorchweatherError as error:
        return {"seconds": round(time.perf_counter() - start, 2), "error": str(error)}
    found = {"seconds": round(time.perf_counter() - start, 2), "report": report.to_dict()}
    if found["report"]["effects"] and other_metrics is not None:
        with one_thread_an_operation():
            found["other_metrics"] = other_metrics(study, report, seed)
    return found


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
