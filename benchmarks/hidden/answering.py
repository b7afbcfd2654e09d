"""Answers of the gap workflow, and pictures of a score."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .sealed import read_json

__all__ = ["answer", "draw_calibration", "draw_confusion"]

# A study of 16,384 beams takes about a minute.
LONGEST_S = 3600.0


def answer(study: Path, seed: int) -> dict[str, Any]:
    """What ``torchweather gap`` says of a study, in a process of its own; an exit code of 2 is a refusal.

    Returns:
        ``seconds``, and ``report`` (``gap.json``) or ``error``.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "answer"
        start = time.perf_counter()
        command = [sys.executable, "-m", "torchweather", "gap", str(study), "--out", str(out), "--seed", str(seed)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
        seconds = round(time.perf_counter() - start, 2)
        if done.returncode == 2:
            return {"seconds": seconds, "error": done.stderr.strip()[-2000:] or "exit code 2"}
        if done.returncode != 0:
            # Not an answer: the workflow itself broke off, and the bench must not score it.
            raise RuntimeError(f"{study}: exit code {done.returncode}: {done.stderr.strip()[-2000:]}")
        return {"seconds": seconds, "report": read_json(out / "gap.json")}


def draw_confusion(confusion: dict[str, dict[str, int]], path: Path) -> None:
    """Truth down, answer across."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    truths = sorted(confusion)
    answers = sorted({one for row in confusion.values() for one in row}, key=lambda one: (one not in truths, one))
    counts = np.array([[confusion[truth].get(one, 0) for one in answers] for truth in truths], dtype=float)
    figure, axes = plt.subplots(figsize=(0.32 * len(answers) + 4.0, 0.3 * len(truths) + 3.0), layout="constrained")
    axes.imshow(counts, cmap="Blues", aspect="auto")
    axes.set_xticks(range(len(answers)), [one.replace("lidar.", "") for one in answers], rotation=90, fontsize=7)
    axes.set_yticks(range(len(truths)), [one.replace("lidar.", "") for one in truths], fontsize=7)
    axes.set(xlabel="answered", ylabel="hidden")
    for (row, column), value in np.ndenumerate(counts):
        if value:
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=6)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_calibration(bins: list[dict[str, Any]], path: Path) -> None:
    """Share of right names over the confidence that was printed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

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
