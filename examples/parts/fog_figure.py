"""Figure of a visibility fitted to fog: echoes against visibility and range, intensities against range."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
from parts.fog_scan import FOG_FROM_M, FOG_TO_M, INTENSITY_EDGES_M, RANGE_EDGES_M
from parts.shared import write_figure
from torch import Tensor


def draw(
    recorded: Tensor,
    fitted: Tensor,
    mor_m: Sequence[float],
    counts: Sequence[float],
    report: dict[str, Any],
    path: Path,
) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.4), layout="constrained")
    left.loglog(mor_m, [max(count, 0.3) for count in counts], ".-", label="simulated")
    left.axhline(report["recorded_fog_echoes"], color="k", label="recorded")
    left.set(xlabel="visibility (MOR) in m", ylabel=f"scattered echoes, {FOG_FROM_M:g} to {FOG_TO_M:g} m")
    left.legend()
    middle.stairs(recorded, RANGE_EDGES_M, color="k", fill=True, alpha=0.3, label="recorded")
    alone = fitted - recorded
    middle.stairs(alone, RANGE_EDGES_M, color="C0", label=f"fog alone, MOR {report['mor_m_at_least']:.0f} m")
    middle.stairs(recorded - alone, RANGE_EDGES_M, color="C3", label="residual: recorded - fog alone")
    middle.axvspan(FOG_FROM_M, FOG_TO_M, color="C1", alpha=0.15, label="used for the fit")
    middle.set(xlabel="range in m", ylabel="scattered echoes in each 0.5 m", yscale="symlog")
    middle.legend(fontsize=8)
    middles = [0.5 * (a + b) for a, b in pairwise(INTENSITY_EDGES_M)]
    means = [mean for _, mean in report["intensities"]]
    right.plot(middles, means, "ko", label="recorded, mean of all surfaces")
    start = next(k for k, mean in enumerate(means) if mean == mean)
    for of_m in (50.0, 200.0):  # two ways through fog of ln 20 / MOR
        fall = [means[start] * 20.0 ** (-2.0 * (m - middles[start]) / of_m) for m in middles[start:]]
        right.plot(middles[start:], fall, label=f"one surface, MOR {of_m:g} m")
    right.set(xlabel="range in m", ylabel="intensity (0 to 255)", yscale="log")
    right.legend(fontsize=8)
    write_figure(path, figure, dpi=100)
