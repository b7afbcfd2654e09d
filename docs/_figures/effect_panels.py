"""Pictures of one or two panels: a statistic without an effect and at two strengths of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from effect_curves import Curve
from effect_drawing import MAP_TITLE, SIZE_INCH, STRONG, WEAK, WITHOUT, setting_text, weather_text
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from torchweather.atmosphere.weather import Weather
from torchweather.report.figures import plain_axes

__all__ = ["Bars", "Lines", "Panel", "Picture", "Run", "draw"]

ALSO = "#e8590c"  # colour of the strong setting in other weather


@dataclass(frozen=True)
class Run:
    """Frames with their label and colour; ``frames`` is of the sensor's own kind."""

    label: str
    colour: str
    frames: Any


Statistic = Callable[[Any, Any], Curve]
"""Of the scene and the frames."""


class Panel(Protocol):
    """A part of a picture."""

    @property
    def instead(self) -> Mapping[str, Any]:
        """Parameters that this panel alone has, with both settings."""
        ...

    def draw(self, axes: Axes, scene: Any, runs: Sequence[Run]) -> None:
        """Draw all runs."""
        ...


@dataclass(frozen=True)
class Lines:
    """A statistic as a line for each run: the broad one is without the effect, so that lines on it are seen."""

    statistic: Statistic
    x: str
    y: str
    log: bool = False
    steps: bool = False
    dots: bool = False
    zero: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)
    instead: Mapping[str, Any] = field(default_factory=dict)
    title: str = ""

    def draw(self, axes: Axes, scene: Any, runs: Sequence[Run]) -> None:
        """Draw all runs."""
        for number, run in enumerate(runs):
            x, y = self.statistic(scene, run.frames)
            x, y = x[np.isfinite(y)], y[np.isfinite(y)]
            style = self._style(number, len(x))
            axes.plot(x, y, color=run.colour, label=run.label, zorder=2 + number, **style)
        if self.log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        if self.zero:
            axes.set_ylim(bottom=0.0)
        if self.title:
            axes.set_title(self.title, loc="left", **MAP_TITLE)
        axes.set(xlabel=self.x, ylabel=self.y, **self.more)

    def _style(self, number: int, points: int) -> dict[str, Any]:
        """Of the run with this number: broad, then thin, then dashed."""
        if self.dots:
            return {"linestyle": "none", "marker": "o", "markersize": (9.0, 6.0, 3.5)[number]}
        style: dict[str, Any] = {"linewidth": 4.5 if number == 0 else 1.6, "solid_capstyle": "butt"}
        if self.steps:
            style["drawstyle"] = "steps-mid"
        elif number and points < 40:
            style |= {"marker": "o", "markersize": 3.0}
        if number > 2:
            style["linestyle"] = (0, (2, 1.5))
        return style


@dataclass(frozen=True)
class Bars:
    """A statistic as a bar for each run in each class."""

    statistic: Statistic
    classes: Sequence[str]
    x: str
    y: str
    base_line: bool = False
    instead: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: Axes, scene: Any, runs: Sequence[Run]) -> None:
        """Draw all runs."""
        width = 0.8 / len(runs)
        for number, run in enumerate(runs):
            place, value = self.statistic(scene, run.frames)
            axes.bar(place + (number - 0.5 * (len(runs) - 1)) * width, value, width, color=run.colour, label=run.label)
        if self.base_line:
            axes.axhline(0.0, color="#1b2733", linewidth=0.8)
        axes.set_xticks(range(len(self.classes)), labels=self.classes)
        axes.grid(axis="x", visible=False)
        axes.set(xlabel=self.x, ylabel=self.y)


@dataclass(frozen=True)
class Picture:
    """How an effect is drawn.

    Args:
        weather: the same without and with the effect.
        settings: weak and strong.
        panels: one or two.
        common: parameters that say where or how.
        also: weather in which the strong setting is drawn once more.
        legend: of which panel, and where in it.
        scene: which of the sensor's scenes.
        common_in_title: write the common parameters beside the weather.
    """

    weather: Weather
    settings: tuple[Mapping[str, Any], Mapping[str, Any]]
    panels: tuple[Panel, ...]
    common: Mapping[str, Any] = field(default_factory=dict)
    also: Weather | None = None
    legend: tuple[int, str] = (0, "best")
    scene: str = "usual"
    common_in_title: bool = False


FramesOf = Callable[[Weather, Mapping[str, Any]], Any]
"""Frames in weather with an effect, which is empty where there is none."""


def runs_of(name: str, picture: Picture, instead: Mapping[str, Any], frames_of: FramesOf) -> list[Run]:
    """Without the effect, weak, strong, and strong in other weather where the picture asks for it."""
    runs = [Run("without", WITHOUT, frames_of(picture.weather, {}))]
    for setting, colour in zip(picture.settings, (WEAK, STRONG), strict=True):
        label = setting_text(name, setting)
        effect = {"effect": name, **picture.common, **setting, **instead}
        runs.append(Run(label, colour, frames_of(picture.weather, effect)))
    if picture.also is not None:
        runs.append(Run(f"{label}, {weather_text(picture.also)}", ALSO, frames_of(picture.also, effect)))
    return runs


def draw(name: str, picture: Picture, scene: Any, frames_of: FramesOf) -> Figure:
    """Draw the picture of one effect.

    Args:
        name: id of the effect.
        picture: how it is drawn.
        scene: of the sensor, as its statistics take it.
        frames_of: simulates.
    """
    usual = runs_of(name, picture, {}, frames_of)
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(picture.panels)))
    for axes, panel in zip(panels, picture.panels, strict=True):
        plain_axes(axes)
        panel.draw(axes, scene, runs_of(name, picture, panel.instead, frames_of) if panel.instead else usual)
    common = setting_text(name, picture.common) if picture.common_in_title else ""
    title = ", ".join(filter(None, (weather_text(picture.weather), common)))
    panels[0].set_title(title, loc="left", fontsize=9)
    number, place = picture.legend
    panels[number].legend(frameon=False, fontsize=8, loc=place)
    return figure
