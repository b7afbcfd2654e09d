"""A point cloud in snow, for the README: the embedded test track, coloured by what each point is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image, ImageColor
from torch import Tensor

import torchweather as tw
from torchweather.scenes import lidar_view, test_track

SEED = 7
# Objects grey, flakes orange, lost points blue: told apart by every eye, as on the pages of `torchweather view`.
OBJECT, FLAKE, LOST, NIGHT = "#b9c6d2", "#ff7f2a", "#4f97ea", "#10161d"
CLOUD_SIZE_PX, CLOUD_SHADES = (1200, 520), 8  # shades of each colour on the dark ground
# The eye of the cloud's picture, in the LiDAR's frame: behind and above it, looking ahead and slightly down.
EYE_M, EYE_PITCH_RAD, EYE_FOCAL = (-17.0, 1.0, 8.0), -0.27, 0.9
NEAREST_M = 1.5  # to the eye


def seen_by_eye(points: Tensor) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Columns, rows (units of the picture's width, from its middle, up) and distance of points before the eye."""
    x, y, z = (points[:, :3].double() - torch.tensor(EYE_M, dtype=torch.float64)).numpy().T
    cos, sin = math.cos(EYE_PITCH_RAD), math.sin(EYE_PITCH_RAD)
    ahead, up = cos * x + sin * z, cos * z - sin * x
    before = ahead > NEAREST_M
    ahead, up, aside = ahead[before], up[before], -y[before]
    return EYE_FOCAL * aside / ahead, EYE_FOCAL * up / ahead, ahead


def cloud(columns: int) -> Image.Image:
    """The embedded test track, scanned in snow, from behind the sensor; coloured by what each point is."""
    sensor = tw.Lidar.preset("ouster-os1-128", columns=columns)
    view = lidar_view(test_track(), sensor, range_noise_seed=SEED)
    snow = tw.LidarSnow(tw.Snow(rate_mm_per_h=0.2), sensor)
    result = snow.run(view.points, snow.draw(view.points, seed=SEED), directions=view.directions)
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    kind = result.kind.reshape(-1)
    lost = view.hit & (kind == tw.PointKind.LOST)
    parts = (
        (f"{int((kind == tw.PointKind.OBJECT).sum()):,} points of objects", result.points, kind == 0, OBJECT, 1.5),
        (f"{int(lost.sum()):,} lost", view.points, lost, LOST, 8.0),
        (f"{int((kind == tw.PointKind.PARTICLE).sum()):,} on flakes", result.points, kind == 1, FLAKE, 2.4),
    )
    width, height = CLOUD_SIZE_PX
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=NIGHT)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.5, 0.5), ylim=(-0.55 * height / width, 0.45 * height / width))
    axes.set_axis_off()
    for text, points, shown, colour, size in parts:
        x, y, distance_m = seen_by_eye(points[shown])
        sizes = size * np.clip(14.0 / distance_m, 0.5, 1.5)
        axes.scatter(x, y, s=sizes, c=colour, linewidths=0, label=text)
    legend = axes.legend(
        loc="upper left", facecolor=NIGHT, edgecolor=NIGHT, framealpha=0.85, labelcolor="white", fontsize=10
    )
    for handle in legend.legend_handles:
        handle.set_sizes([28.0])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return Image.fromarray(pixels.copy()).quantize(palette=shades(), dither=Image.Dither.NONE)


def shades() -> Image.Image:
    """The palette of the cloud's picture: each colour, and white, in steps from the dark ground."""
    ground = np.array(ImageColor.getrgb(NIGHT), dtype=float)
    steps = np.linspace(0.0, 1.0, CLOUD_SHADES)[:, None]
    inks = [np.array(ImageColor.getrgb(colour), dtype=float) for colour in (OBJECT, FLAKE, LOST, "white")]
    colours = np.concatenate([ground + steps * (ink - ground) for ink in inks])
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.round().astype(int).reshape(-1).tolist())
    return palette
