"""Picture of a camera effect: a curve on the left, a frame without and with the effect on the right."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from camera_frames import Frames
from camera_statistics import Statistic
from effect_curves import Array
from effect_drawing import SIZE_INCH, STRONG, WEAK, WITHOUT, setting_text, weather_text
from effect_panels import Run
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torchweather.atmosphere.weather import Weather
from torchweather.report.figures import plain_axes
from torchweather.scenes import SceneView

GAMMA, GAIN = 2.2, 1.6  # of the display
MASK_WHITE, CHANGE_WHITE = 0.15, 0.03  # cover by particles, and departure from the median frame, shown white
WALL_M = 8.0  # depth at which particles are shown: in front of a wall

# Rows and columns of the frame, as shares: all of the road, and the objects ahead.
ROAD, AHEAD = ((0.28, 0.84), (0.0, 1.0)), ((0.42, 0.63), (0.31, 0.69))
HIGH, WALL = ((0.1, 0.66), (0.0, 1.0)), ((0.22, 0.36), (0.3, 0.55))

Setting = Mapping[str, float]


@dataclass(frozen=True)
class Picture:
    """What stands in the picture of an effect: the weather, two settings, the curves and the part of the frame."""

    weather: Weather
    settings: tuple[Setting, Setting]
    curve: Statistic
    x_label: str
    y_label: str
    part: tuple[tuple[float, float], tuple[float, float]] = ROAD
    common: Setting = field(default_factory=dict)
    legend: str = "best"
    zero: bool = False
    shown: str = "frame"
    one_depth_m: float | None = None
    shown_depth_m: float | None = None
    limits: tuple[float, float] | None = None


def displayed(signal: Array) -> Array:
    """A raw frame as a picture of half its size: each cell of the mosaic one pixel."""
    red, blue = signal[0::2, 0::2], signal[1::2, 1::2]
    green = 0.5 * (signal[0::2, 1::2] + signal[1::2, 0::2])
    picture: Array = np.clip(GAIN * np.stack([red, green, blue], -1), 0.0, 1.0) ** (1.0 / GAMMA)
    return picture


def setting_label(name: str, setting: Setting) -> str:
    """Parameters of an effect, one in a line."""
    if set(setting) == {"red", "green", "blue"}:
        return f"red, green, blue = {setting['red']:g}"
    return setting_text(name, setting, ",\n")


def cut(values: Array, part: tuple[tuple[float, float], tuple[float, float]]) -> Array:
    """A part of a frame, at whole cells of the mosaic."""
    (top, bottom), (left, right) = part
    height, width = values.shape
    rows, stop = 2 * round(height / 2 * top), 2 * round(height / 2 * bottom)
    columns, end = 2 * round(width / 2 * left), 2 * round(width / 2 * right)
    found: Array = values[rows:stop, columns:end]
    return found


def show(axes: Axes, frames: Frames, picture: Picture, title: str) -> None:
    """Draw the first frame, its cover by particles, or its change from the median frame."""
    if picture.shown == "cover":
        axes.imshow(cut(frames.mask[0], picture.part), cmap="gray", vmin=0.0, vmax=MASK_WHITE, interpolation="nearest")
    elif picture.shown == "change":
        change = cut(frames.signal[0] - np.median(frames.signal, 0), picture.part)
        axes.imshow(change, cmap="gray", vmin=-CHANGE_WHITE, vmax=CHANGE_WHITE, interpolation="nearest")
    else:
        axes.imshow(displayed(cut(frames.signal[0], picture.part)), interpolation="nearest")
    axes.set_axis_off()
    axes.set_title(title, loc="left", fontsize=7.5, fontweight="normal", pad=2)


FramesOf = Callable[[Weather, Mapping[str, Any], float | None], Frames]
"""Frames in weather, with an effect (empty: none), of a scene at one depth or its own."""


def draw(name: str, picture: Picture, view: SceneView, frames: FramesOf) -> Figure:
    """Draw the picture of one effect.

    Args:
        name: id of the effect.
        picture: how it is drawn.
        view: scene.
        frames: simulates.
    """
    runs = [Run("without", WITHOUT, frames(picture.weather, {}, picture.one_depth_m))]
    for setting, colour in zip(picture.settings, (WEAK, STRONG), strict=True):
        effect = {"effect": name, **picture.common, **setting}
        label = setting_label(name, setting)
        runs.append(Run(label, colour, frames(picture.weather, effect, picture.one_depth_m)))
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    plain_axes(axes)
    for run in runs:
        x, y = picture.curve(view, run.frames, runs[0].frames)
        if x.dtype.kind == "i":
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.plot(x, y, color=run.colour, label=run.label, linewidth=1.6, marker="o", markersize=2.5)
    axes.set_xlabel(picture.x_label)
    axes.set_ylabel(picture.y_label)
    if picture.zero:
        axes.set_ylim(bottom=0.0)
    axes.set_title(weather_text(picture.weather), loc="left", fontsize=9)
    axes.legend(frameon=False, fontsize=7.5, loc=picture.legend)
    if picture.limits is not None:
        axes.set_ylim(picture.limits)
    shown = [frames(picture.weather, effects, picture.shown_depth_m) for effects in ({}, effect)]
    what = {"frame": "", "cover": "cover by drops, ", "change": "less the median frame, "}[picture.shown]
    show(figure.add_subplot(grid[0, 1]), shown[0], picture, f"{what}without")
    show(figure.add_subplot(grid[1, 1]), shown[1], picture, label.replace("\n", " "))
    return figure
