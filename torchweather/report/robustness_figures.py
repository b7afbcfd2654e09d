"""Figures of the robustness page: performance against severity, boxes on frames, right and wrong points from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchweather.evaluation.robustness import BoxTruth, ConditionResult
from torchweather.evaluation.robustness.frames import Look
from torchweather.report.figures import MUTED, SHADES, STYLE, plain_axes, png_figure_uri, svg_uri
from torchweather.report.lidar_figures import axes_from_above
from torchweather.report.pictures import jpeg_uri

__all__ = ["FOUND", "LEGENDS", "TRUE", "WRONG", "look_uri", "performance_uri"]

# Of a weather that varies; other amounts and parameters by their own names.
VARIED = {"rate_mm_per_h": "rate", "mor_m": "visibility", "water_mm": "water"}

# Told apart by every eye, on light and on dark.
FOUND, TRUE, IGNORED, WRONG, RIGHT = "#ff8c1a", "#35c4f0", "#b8b8c4", "#e8590c", "#8a97a3"
PICTURE_PX = 640
LEGENDS = {
    "boxes": ((TRUE, "ground truth"), (IGNORED, "to be ignored"), (FOUND, "found, score {threshold} or more")),
    "segmentation": ((RIGHT, "right"), (WRONG, "wrong")),
}
"""By the decoder: colours and what they mean."""


def performance_uri(group: Sequence[ConditionResult], clear: float, measure: str) -> str:
    """Performance against the weather, the heaviest to the right.

    Dashed: in clear air; band: of the storms; lines: 95 % intervals over the frames.
    """
    first = group[0].condition
    shades = SHADES.get(first.kind, ("#5f6f7e",))
    colour = shades[len(shades) // 2]
    place = np.arange(len(group))
    values = np.array([each.value for each in group])
    seeds = np.array([each.by_seed for each in group])
    with mpl.rc_context({**STYLE, "font.size": 9.5}):
        figure = Figure(figsize=(4.2, 2.7))
        axes = figure.add_axes((0.13, 0.19, 0.84, 0.7))
        plain_axes(axes)
        if not math.isnan(clear):
            axes.axhline(clear, color=MUTED, linewidth=1.1, linestyle=(0, (4, 3)))
            axes.text(len(group) - 0.6, clear, "clear", color=MUTED, fontsize=8.5, ha="right", va="bottom")
        if seeds.shape[1] > 1:
            axes.fill_between(place, seeds.min(1), seeds.max(1), color=colour, alpha=0.22, linewidth=0)
        ends = [
            (np.nan, np.nan) if each.interval is None else (each.interval.low, each.interval.high) for each in group
        ]
        low, high = np.array(ends).T
        # An interval of percentiles need not hold the value itself.
        axes.vlines(place, low, high, color=colour, linewidth=1.3, alpha=0.75)
        axes.plot(place, values, "-o", color=colour, linewidth=2.0, markersize=5)
        axes.set_xticks(place, labels=[f"{each.condition.value:g}" for each in group])
        axes.set_xlim(-0.4, len(group) - 0.6 if len(group) > 1 else 0.4)
        axes.set_ylim(-0.03, 1.08)
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
        varied = VARIED.get(first.knob, first.knob.replace("_", " "))
        axes.set_xlabel(f"{varied}, {first.unit}" if first.unit else varied, labelpad=2)
        axes.set_title(f"{measure} in {first.name}", loc="left", pad=5)
        return svg_uri(figure)


def look_uri(look: Look, least_score: float = 0.0) -> str:
    """The detector's input, with the truth and its answer; boxes from a score on."""
    return DRAWN[look.frame.subject.sensor](look, least_score)


def _frame_uri(look: Look, least_score: float) -> str:
    picture = look.shown.float()
    cut = max(1, round(picture.shape[-1] / PICTURE_PX))
    factor = float(cut)
    small = torch.nn.functional.avg_pool2d(picture[None], cut)[0] if cut > 1 else picture
    if small.shape[-1] < PICTURE_PX:  # small frames: whole pixels, so that lines stay thin against objects
        whole = max(1, PICTURE_PX // small.shape[-1])
        small, factor = small.repeat_interleave(whole, -2).repeat_interleave(whole, -1), factor / whole
    drawn = small.clone()
    if isinstance(look.frame.truth, BoxTruth):
        for box, ignored in zip(look.frame.truth.boxes, look.frame.truth.ignore, strict=True):
            _rectangle(drawn, [float(v) / factor for v in box], IGNORED if ignored else TRUE)
        for box, score in zip(look.found["boxes"], look.found["scores"], strict=True):
            if score >= least_score:
                _rectangle(drawn, [float(v) / factor for v in box], FOUND)
    else:
        wrong = torch.as_tensor(look.found != look.frame.truth.classes)
        step = (torch.arange(drawn.shape[-2]) * factor).long(), (torch.arange(drawn.shape[-1]) * factor).long()
        here = wrong[step[0].clamp_max(wrong.shape[0] - 1)][:, step[1].clamp_max(wrong.shape[1] - 1)]
        colour = torch.tensor(mpl.colors.to_rgb(WRONG))[:, None, None]
        drawn = torch.where(here, 0.45 * drawn + 0.55 * colour, drawn)
    return jpeg_uri(drawn)


def _rectangle(picture: Tensor, box: Sequence[float], colour: str, *, width: int = 2) -> None:
    """Draw the edges of a box into ``(3, H, W)``; in place."""
    height, columns = picture.shape[-2:]
    left, right = (int(min(max(v, 0), columns - 1)) for v in (box[0], box[2]))
    top, bottom = (int(min(max(v, 0), height - 1)) for v in (box[1], box[3]))
    ink = torch.tensor(mpl.colors.to_rgb(colour))[:, None, None]
    for rows, cols in (
        (slice(top, top + width), slice(left, right + 1)),
        (slice(max(bottom - width + 1, 0), bottom + 1), slice(left, right + 1)),
        (slice(top, bottom + 1), slice(left, left + width)),
        (slice(top, bottom + 1), slice(max(right - width + 1, 0), right + 1)),
    ):
        picture[:, rows, cols] = ink


def _cloud_uri(look: Look, least_score: float) -> str:
    points, truth = look.shown, np.asarray(look.frame.truth.classes)
    particle = np.zeros(len(points), bool) if look.weather is None else look.weather
    wrong = torch.as_tensor((look.found != truth) | particle)
    with mpl.rc_context({**STYLE, "font.size": 9.0}):
        figure, axes = axes_from_above()
        marks: dict[str, Any] = {"markeredgewidth": 0, "zorder": 3}
        for chosen, colour, size in ((~wrong, RIGHT, 1.2), (wrong, WRONG, 1.8)):
            axes.plot(
                -points[chosen, 1].numpy(), points[chosen, 0].numpy(), ".", color=colour, markersize=size, **marks
            )
        return png_figure_uri(figure, dpi=130)


DRAWN = {"camera": _frame_uri, "lidar": _cloud_uri}
