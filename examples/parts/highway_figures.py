"""Figures of the highway camera: curves, and frames for local use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from parts.shared import write_figure

from torchweather.camera.demosaic import demosaic
from torchweather.camera.tone import srgb_encode
from torchweather.gap.study.simulation import simulate
from torchweather.gap.study.study import Study
from torchweather.io import write_image

__all__ = ["draw_curves", "draw_frames"]


def draw_curves(report: Mapping[str, Any], path: Path) -> None:
    """Fitted visibility over the meter's, and brightness by depth, recorded and simulated."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    blocks = report["blocks"]
    names = list(dict.fromkeys(name for row in blocks for name in row["fits"]))
    for place, name in enumerate(names):
        x = np.arange(len(blocks)) + 0.15 * (place - len(names) / 2)
        ratio = [row["fits"].get(name, [np.nan])[0] / row["meter_m"] for row in blocks]
        left.plot(x, np.clip(ratio, 0.05, 20.0), "o", label=name)
    left.set_yscale("log")
    left.axhline(1.0, color="0.6")
    left.set_xticks(np.arange(len(blocks)), [row["block"][4:] for row in blocks], rotation=90)
    left.set_ylabel("fitted over meter's visibility")
    left.legend(loc="lower right", framealpha=0.9)
    left.set_ylim(0.02, 25.0)
    depth = np.sqrt(np.multiply(report["depth_edges_m"][1:], report["depth_edges_m"][:-1]))
    for kind, style in (("recorded", "-"), ("simulated", "--")):
        for place, curve in enumerate(report["brightness_over_clear"].values()):
            right.plot(depth, curve[kind], style, color=f"C{place % 10}", label=kind if place == 0 else None)
    right.set_xscale("log")
    right.set_yscale("log")
    right.set_xlabel("depth m")
    right.set_ylabel("brightness in fog over clear")
    right.legend()
    write_figure(path, figure, 110)


def draw_frames(study: Study, path: Path, seed: int) -> None:
    """First frame of every condition beside a simulated one."""
    rows = []
    for condition in study.conditions:
        both = [condition.frames[0]["bayer"], simulate(study, condition, seed=seed)["bayer"]]
        rows.append(np.concatenate([np.asarray(frame, dtype=np.float32) for frame in both], axis=1))
    light = torch.from_numpy(np.concatenate(rows))[None]
    shown = srgb_encode(demosaic(light, "RGGB").clamp(0.0, 1.0))
    write_image(path, (255.0 * shown).round().byte())
