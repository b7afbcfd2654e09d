"""Draw what each effect of the LiDAR catalogue does, with no data of your own.

    python examples/draw_lidar_effects.py --out pictures
    python examples/draw_lidar_effects.py --out pictures lidar.window_loss lidar.spray

One picture an effect, named after it: the statistic in which it shows, along its axis, in the same weather without the
effect and at two strengths. The scene is the embedded test track, the sensor an Ouster OS1-128 with few columns; the
numbers are over all frames. The pictures of docs/effects-lidar.md are made by this script, those of the structure of
the weather by draw_lidar_structure.py.
"""

from __future__ import annotations

import argparse
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray
from PIL import Image

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.io import atomic_write
from torchweather.report.figures import STYLE, plain_axes
from torchweather.scenes import lidar_view, test_track
from torchweather.stages import EFFECTS

Array = NDArray[Any]

SIZE_INCH, DPI, COLOURS = (6.0, 2.6), 120, 64
WITHOUT, WEAK, STRONG = "#b3bcc5", "#4dabf7", "#0b4f8a"
MAP_TITLE: dict[str, Any] = {"fontsize": 8, "fontweight": "normal"}  # the setting that a map shows
LEAST_VALUES = 20  # in a bin that is drawn; fewer say little
NEIGHBOUR_M = 1.0  # apart in range at most, for neighbours on the scan; the filter's default

CLEAR_AIR = tw.Rain(0.0)
RAIN, SNOW, LIGHT_SNOW = tw.Rain(25.0), tw.Snow(1.0), tw.Snow(0.1)
HAZE, MIST, FOG = tw.Fog(mor_m=500.0), tw.Fog(mor_m=200.0), tw.Fog(mor_m=100.0)


# ---- frames ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Beams:
    """What the sensor sees of the scene in clear air; ``(N,)`` each, 0 where there is no return."""

    sensor: tw.Lidar
    points: torch.Tensor
    directions: torch.Tensor
    cos_incidence: torch.Tensor
    range_m: Array
    intensity: Array
    margin_db: Array
    azimuth_deg: Array
    elevation_deg: Array

    @property
    def hit(self) -> Array:
        found: Array = self.range_m > 0
        return found

    @property
    def incidence_deg(self) -> Array:
        found: Array = np.degrees(np.arccos(self.cos_incidence.numpy()))
        return found

    @property
    def grid(self) -> tuple[int, int]:
        assert self.sensor.columns is not None
        return len(self.range_m) // self.sensor.columns, self.sensor.columns


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, N)`` each; the kind is ``PointKind``."""

    range_m: Array
    intensity: Array
    kind: Array

    @property
    def object(self) -> Array:
        found: Array = self.kind == tw.PointKind.OBJECT
        return found

    @property
    def particle(self) -> Array:
        found: Array = self.kind == tw.PointKind.PARTICLE
        return found


@dataclass(frozen=True)
class Run:
    """Frames with what stands for them in a picture."""

    label: str
    colour: str
    frames: Frames


def beams_of(columns: int) -> Beams:
    """The scene seen by the sensor. Rings without offset in azimuth, so that maps have straight columns."""
    sensor = tw.Lidar.preset("ouster-os1-128", columns=columns, intensity_unit="photons", azimuth_offsets_deg=None)
    view = lidar_view(test_track(), sensor)
    range_m = torch.linalg.vector_norm(view.points[:, :3], dim=-1)
    x, y, z = view.directions.numpy().T
    return Beams(
        sensor=sensor,
        points=view.points[:, :4],
        directions=view.directions,
        cos_incidence=view.cos_incidence,
        range_m=range_m.numpy(),
        intensity=view.points[:, 3].numpy(),
        margin_db=10.0 * np.log10(np.maximum(view.points[:, 3].numpy() / sensor.photons_at_threshold, 1e-6)),
        azimuth_deg=np.degrees(np.arctan2(y, x)),
        elevation_deg=np.degrees(np.arcsin(z)),
    )


def frames_of(beams: Beams, weather: Weather, effects: Sequence[Mapping[str, Any]], count: int) -> Frames:
    """Frames in the weather, each of a clear frame with range noise of its own; the same draws for all effects."""
    transform = tw.LidarWeather(weather, beams.sensor, effects=effects)
    noise = torch.randn(count, len(beams.points), generator=torch.Generator().manual_seed(1))
    points = beams.points[None].repeat(count, 1, 1)
    points[..., :3] += (
        beams.sensor.range_noise_m * noise[..., None] * beams.directions * torch.from_numpy(beams.hit)[:, None]
    )
    # The angle of incidence comes with the scene, not with the cloud.
    state = replace(transform.state_of(points, beams.directions), cos_incidence=beams.cos_incidence[None])
    with torch.no_grad():
        found = transform.chain(state, transform.chain.draw(state, seed=torch.arange(count)))
    range_m = torch.linalg.vector_norm(found.points[..., :3], dim=-1)
    return Frames(range_m.numpy(), found.points[..., 3].numpy(), found.kind[..., 0].numpy())


# ---- statistics: x and y of a curve ------------------------------------------------------------------------------

Curve = tuple[Array, Array]
Statistic = Callable[[Beams, Frames], Curve]


def in_bins(axis: Array, values: Array, edges: Array, average: Callable[[Array], Any] = np.mean) -> Curve:
    """Average of the values in each bin of the axis; not a number where there are few."""
    place = np.digitize(axis, edges) - 1
    found = np.full(len(edges) - 1, np.nan)
    for number in range(len(found)):
        inside = values[place == number]
        if len(inside) >= LEAST_VALUES:
            found[number] = average(inside)
    return 0.5 * (edges[1:] + edges[:-1]), found


def intensity_ratio(
    beams: Beams, frames: Frames, axis: str, edges: Array, only: Callable[[Beams], Array] | None = None
) -> Curve:
    """Median intensity of objects over that in clear air, dB; a lost return counts as less than any other."""
    with np.errstate(divide="ignore"):
        ratio_db = 10.0 * np.log10(np.where(frames.object, frames.intensity, 0.0) / np.maximum(beams.intensity, 1e-9))
    picked = beams.hit & (only(beams) if only else True) & ~frames.particle
    x, y = in_bins(np.broadcast_to(getattr(beams, axis), picked.shape)[picked], ratio_db[picked], edges, np.median)
    return x, np.where(np.isfinite(y), y, np.nan)


def lost_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams that see an object in clear air and report nothing, percent."""
    lost = 100.0 * (frames.kind == tw.PointKind.LOST)[:, beams.hit]
    return in_bins(np.broadcast_to(getattr(beams, axis)[beams.hit], lost.shape), lost, edges)


def nearer_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams that meet an object where there is none in clear air, percent."""
    nearer = 100.0 * (frames.object & (~beams.hit | (frames.range_m < beams.range_m - 0.5)))
    return in_bins(np.broadcast_to(getattr(beams, axis), nearer.shape), nearer, edges)


def particle_count(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Particle returns of a frame in each metre of range."""
    counts, _ = np.histogram(frames.range_m[frames.particle], edges)
    return 0.5 * (edges[1:] + edges[:-1]), counts / np.diff(edges) / len(frames.range_m)


def particle_intensity(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Mean intensity of the particle returns, photons."""
    return in_bins(frames.range_m[frames.particle], frames.intensity[frames.particle], edges)


def residual(beams: Beams, frames: Frames, axis: Callable[[Beams], Array], edges: Array) -> Curve:
    """Mean range of objects less that in clear air, cm."""
    picked = frames.object & beams.hit
    error_cm = 100.0 * (frames.range_m - beams.range_m)[picked]
    return in_bins(np.broadcast_to(axis(beams), picked.shape)[picked], error_cm, edges)


def residual_share(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Objects with a range less that in clear air, in cm, in each bin, percent."""
    picked = frames.object & beams.hit
    counts, _ = np.histogram(100.0 * (frames.range_m - beams.range_m)[picked], edges)
    return 0.5 * (edges[1:] + edges[:-1]), 100.0 * counts / picked.sum()


def neighbours(beams: Beams, frames: Frames) -> Curve:
    """Particle returns of a frame by how many of their eight neighbours on the scan return from near their range."""
    rows, columns = beams.grid
    reported = np.where(frames.kind == tw.PointKind.LOST, np.nan, frames.range_m).reshape(-1, rows, columns)
    framed = np.pad(
        np.pad(reported, ((0, 0), (0, 0), (1, 1)), "wrap"), ((0, 0), (1, 1), (0, 0)), constant_values=np.nan
    )
    near = np.zeros(reported.shape, int)
    for row in range(3):
        for column in range(3):
            if (row, column) != (1, 1):
                other = framed[:, row : row + rows, column : column + columns]
                near += np.abs(other - reported) <= NEIGHBOUR_M
    found = near.reshape(frames.kind.shape)[frames.particle]
    return np.arange(6), np.bincount(np.minimum(found, 5), minlength=6) / len(frames.kind)


BEHIND_M = np.array([5.0, 10.0, 15.0, 20.0, 30.0, 60.0])
BEHIND = (*(f"{a:g}–{b:g}" for a, b in pairwise(BEHIND_M)), "sky")


def particles_before(beams: Beams, frames: Frames) -> Curve:
    """Beams that return a particle by the range of the object behind it, percent; the last is the sky."""
    share = 100.0 * frames.particle.mean(0)
    _, found = in_bins(beams.range_m[beams.hit], share[beams.hit], BEHIND_M)
    return np.arange(len(BEHIND)), np.append(found, share[~beams.hit].mean())


def particles_in_frames(beams: Beams, frames: Frames) -> Curve:
    """Particle returns of each frame, thousands."""
    return np.arange(1, len(frames.kind) + 1), 1e-3 * frames.particle.sum(1)


# ---- panels ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lines:
    """A statistic as a line for each run: the broad one is without the effect, so that lines on it are seen."""

    statistic: Statistic
    x: str
    y: str
    log: bool = False
    steps: bool = False
    zero: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        for number, run in enumerate(runs):
            x, y = self.statistic(beams, run.frames)
            x, y = x[np.isfinite(y)], y[np.isfinite(y)]
            style: dict[str, Any] = {"linewidth": 4.5 if number == 0 else 1.6, "solid_capstyle": "butt"}
            if self.steps:
                style["drawstyle"] = "steps-mid"
            elif number and len(x) < 40:
                style |= {"marker": "o", "markersize": 3.0}
            if number > 2:
                style["linestyle"] = (0, (2, 1.5))
            axes.plot(x, y, color=run.colour, label=run.label, zorder=2 + number, **style)
        if self.log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        if self.zero:
            axes.set_ylim(bottom=0.0)
        axes.set(xlabel=self.x, ylabel=self.y, **self.more)


@dataclass(frozen=True)
class Bars:
    """A statistic as a bar for each run in each class."""

    statistic: Statistic
    classes: Sequence[str]
    x: str
    y: str

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        width = 0.8 / len(runs)
        for number, run in enumerate(runs):
            place, value = self.statistic(beams, run.frames)
            axes.bar(place + (number - 0.5 * (len(runs) - 1)) * width, value, width, color=run.colour, label=run.label)
        axes.set_xticks(range(len(self.classes)), labels=self.classes)
        axes.grid(axis="x", visible=False)
        axes.set(xlabel=self.x, ylabel=self.y)


@dataclass(frozen=True)
class FromAbove:
    """Particle returns of one frame of the first and the last run from above."""

    half_m: float
    behind_only: bool = False

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        x, y, _ = beams.directions.numpy().T
        objects = beams.hit
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        axes.plot((x * beams.range_m)[objects], (y * beams.range_m)[objects], ",", color="#dde3e9", zorder=1)
        for run, size in ((runs[0], 2.5), (runs[-1], 1.4)):
            seen, range_m = run.frames.particle[0], run.frames.range_m[0]
            axes.plot((x * range_m)[seen], (y * range_m)[seen], "o", markersize=size, mew=0, color=run.colour, zorder=2)
        axes.plot(0.0, 0.0, "^", color="#1b2733", markersize=5, zorder=3)
        half = self.half_m
        axes.set(
            xlim=(-half, 0.4 * half if self.behind_only else half),
            ylim=(-half, half) if not self.behind_only else (-0.7 * half, 0.7 * half),
        )
        axes.set_aspect("equal")
        axes.set(xlabel="x, forward, m", ylabel="y, left, m")


@dataclass(frozen=True)
class RangeImage:
    """Range of one frame of the last run over azimuth and elevation."""

    half_deg: float
    most_m: float

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        frames = runs[-1].frames
        seen = (frames.range_m[0] > 0) & (np.abs(beams.azimuth_deg) <= self.half_deg)
        shown = axes.scatter(
            beams.azimuth_deg[seen],
            beams.elevation_deg[seen],
            c=frames.range_m[0][seen],
            s=6.0,
            marker="s",
            linewidths=0,
            cmap="viridis_r",
            vmin=0.0,
            vmax=self.most_m,
        )
        bar = axes.figure.colorbar(shown, ax=axes, pad=0.02)
        bar.set_label("range, m")
        axes.set(xlim=(self.half_deg, -self.half_deg), xlabel="azimuth, degrees", ylabel="elevation, degrees")


@dataclass(frozen=True)
class LostMap:
    """Share of the frames of the last run in which a beam lost its object, over azimuth and elevation."""

    half_deg: float

    def draw(self, axes: Axes, beams: Beams, runs: Sequence[Run]) -> None:
        axes.set_title(runs[-1].label, loc="left", **MAP_TITLE)
        share = 100.0 * (runs[-1].frames.kind == tw.PointKind.LOST).mean(0)
        seen = beams.hit & (np.abs(beams.azimuth_deg) <= self.half_deg)
        shown = axes.scatter(
            beams.azimuth_deg[seen],
            beams.elevation_deg[seen],
            c=share[seen],
            s=3.5,
            marker="s",
            linewidths=0,
            cmap=LinearSegmentedColormap.from_list("lost", ("#d5e3f0", STRONG)),
            vmin=0.0,
            vmax=100.0,
        )
        bar = axes.figure.colorbar(shown, ax=axes, pad=0.02)
        bar.set_label("lost, %")
        axes.set(xlim=(self.half_deg, -self.half_deg), xlabel="azimuth, degrees", ylabel="elevation, degrees")


Panel = Lines | Bars | FromAbove | RangeImage | LostMap


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
    """

    weather: Weather
    settings: tuple[Mapping[str, float], Mapping[str, float]]
    panels: tuple[Panel, ...]
    common: Mapping[str, float] = field(default_factory=dict)
    also: Weather | None = None
    legend: tuple[int, str] = (0, "best")


def bins(low: float, high: float, step: float) -> Array:
    return np.arange(low, high + 0.5 * step, step)


RATIO, PARTICLES, LOST = "intensity over clear air's, dB", "particle returns per m", "objects lost, %"
OBJECT_RANGE, PARTICLE_RANGE = "range of the object, m", "range of the particle, m"
counts = Lines(partial(particle_count, edges=bins(2, 20, 0.5)), PARTICLE_RANGE, PARTICLES, steps=True, zero=True)
brightness = Lines(
    partial(particle_intensity, edges=bins(2, 20, 1)), PARTICLE_RANGE, "particle intensity, photons", log=True
)
ratio_by_range = Lines(partial(intensity_ratio, axis="range_m", edges=bins(4, 46, 6)), OBJECT_RANGE, RATIO)
lost_by_margin = Lines(
    partial(lost_share, axis="margin_db", edges=bins(0, 16, 1)), "margin in clear air, dB", LOST, zero=True
)
ratio_by_margin = Lines(
    partial(intensity_ratio, axis="margin_db", edges=bins(0, 16, 1)),
    "margin in clear air, dB",
    RATIO,
    more={"ylim": (-5.0, 1.0)},
)


def margin_of(beams: Beams) -> Array:
    return beams.margin_db


def optical_depth_of(beams: Beams) -> Array:
    depth: Array = float(tw.LidarFog(FOG, beams.sensor).extinction_per_m) * beams.range_m
    return depth


def at_10_to_12_m(beams: Beams) -> Array:
    return (beams.range_m > 10.0) & (beams.range_m <= 12.0)


def bright(beams: Beams) -> Array:
    """Objects that no loss drawn here takes under the threshold."""
    return beams.margin_db > 7.0


PICTURES: dict[str, Picture] = {
    "lidar.beam_divergence": Picture(
        SNOW, ({"extra_mrad": 2.0}, {"extra_mrad": 6.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.isolated_return_filter": Picture(
        LIGHT_SNOW,
        ({"probability": 0.5}, {"probability": 1.0}),
        (
            Bars(
                neighbours,
                ("0", "1", "2", "3", "4", "≥ 5"),
                "neighbours on the scan within 1 m of range",
                "particle returns",
            ),
            FromAbove(15.0),
        ),
        common={"radius_m": NEIGHBOUR_M},
    ),
    "lidar.threshold_shift": Picture(RAIN, ({"shift_db": 2.0}, {"shift_db": 5.0}), (lost_by_margin, ratio_by_margin)),
    "lidar.window_loss": Picture(
        SNOW,
        ({"loss_db": 2.0}, {"loss_db": 5.0}),
        (
            Lines(
                partial(intensity_ratio, axis="range_m", edges=bins(4, 34, 5), only=bright),
                OBJECT_RANGE,
                RATIO,
                more={"ylim": (-6.5, 0.3)},
            ),
            counts,
        ),
        legend=(1, "best"),
    ),
    "lidar.extinction_scale": Picture(HAZE, ({"factor": 0.5}, {"factor": 2.0}), (ratio_by_range, lost_by_margin)),
    "lidar.wet_target": Picture(
        LIGHT_SNOW,
        ({"share": 0.3}, {"share": 0.6}),
        (
            Lines(
                partial(intensity_ratio, axis="incidence_deg", edges=bins(0, 90, 6)),
                "angle of incidence, degrees",
                RATIO,
            ),
            replace(brightness, more={"ylim": (8.0, 40.0)}),
        ),
    ),
    "lidar.blind_zone": Picture(SNOW, ({"range_m": 4.0}, {"range_m": 7.0}), (counts,)),
    "lidar.range_noise": Picture(
        RAIN,
        ({"std_m": 0.02}, {"std_m": 0.05}),
        (
            Lines(
                partial(residual_share, edges=np.arange(-15.5, 16.0, 1.0)),
                "range less clear air's, cm",
                "objects per cm, %",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "lidar.range_bias": Picture(
        RAIN,
        ({"offset_m": 0.05}, {"walk_m_per_decade": -0.05}),
        (
            Lines(
                partial(residual, axis=margin_of, edges=bins(0, 16, 1)),
                "margin in clear air, dB",
                "range less clear air's, cm",
            ),
        ),
    ),
    "lidar.limited_extent": Picture(SNOW, ({"extent_m": 20.0}, {"extent_m": 8.0}), (ratio_by_range, counts)),
    "lidar.last_return": Picture(
        SNOW,
        ({"probability": 0.5}, {"probability": 1.0}),
        (Bars(particles_before, BEHIND, "range of the object behind, m", "beams with a particle, %"),),
    ),
    "lidar.static_structure": Picture(
        RAIN,
        ({"width_rad": 0.1}, {"width_rad": 0.3}),
        (
            Lines(
                partial(nearer_share, axis="azimuth_deg", edges=bins(-40, 40, 1.40625)),
                "azimuth, degrees",
                "new object returns, %",
                zero=True,
                more={"xlim": (40, -40)},
            ),
            RangeImage(40.0, 40.0),
        ),
        common={"azimuth_rad": -0.5, "range_m": 9.0},
    ),
    "lidar.intensity_compression": Picture(
        MIST,
        ({"exponent": 0.5}, {"saturation": 100.0}),
        (
            Lines(
                partial(intensity_ratio, axis="intensity", edges=bins(0, 260, 20), only=at_10_to_12_m),
                "intensity in clear air, photons",
                RATIO,
            ),
            lost_by_margin,
        ),
    ),
    "lidar.range_stretch": Picture(
        FOG,
        ({"m_per_optical_depth": 0.1}, {"m_per_optical_depth": 0.3}),
        (
            Lines(
                partial(residual, axis=optical_depth_of, edges=bins(0, 1.5, 0.1)),
                "optical depth, one way",
                "range less clear air's, cm",
            ),
        ),
    ),
    "lidar.crosstalk": Picture(
        RAIN,
        ({"probability": 0.001}, {"probability": 0.003}),
        (
            Lines(
                partial(particle_count, edges=bins(0, 120, 10)),
                "range of the point, m",
                "spurious points per m",
                zero=True,
            ),
            FromAbove(120.0),
        ),
        also=CLEAR_AIR,
    ),
    "lidar.particle_backscatter": Picture(
        SNOW, ({"gain_db": -3.0}, {"gain_db": 3.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.sector_loss": Picture(
        RAIN,
        ({"loss_db": 2.0}, {"loss_db": 5.0}),
        (
            Lines(
                partial(intensity_ratio, axis="azimuth_deg", edges=bins(-60, 60, 3)),
                "azimuth, degrees",
                RATIO,
                more={"xlim": (60, -60)},
            ),
            LostMap(60.0),
        ),
        common={"azimuth_rad": -0.6, "width_rad": 0.5},
    ),
    "lidar.patchy_weather": Picture(
        SNOW,
        ({"log_std": 0.3}, {"log_std": 0.6}),
        (Lines(particles_in_frames, "frame", "particle returns, thousands", zero=True),),
    ),
    "lidar.spray": Picture(
        RAIN,
        ({"strength": 0.3}, {"strength": 1.0}),
        (counts, FromAbove(20.0, behind_only=True)),
        common={"azimuth_rad": math.pi, "width_rad": 0.5},
    ),
    "lidar.ring_gain": Picture(
        RAIN,
        ({"db_per_ring": 0.03}, {"db_per_ring": 0.1}),
        (Lines(partial(intensity_ratio, axis="elevation_deg", edges=bins(-22, 10, 2)), "elevation, degrees", RATIO),),
    ),
}


def weather_text(weather: Weather) -> str:
    if isinstance(weather, tw.Fog):
        return f"fog, visibility {float(weather.mor_m):g} m"
    return f"{weather.kind}, {float(weather.knob):g} mm/h" if weather.knob else "clear air"


def draw(
    name: str,
    beams: Beams,
    frames: Callable[[Weather, tuple[Mapping[str, Any], ...]], Frames],
    picture: Picture | None = None,
) -> Figure:
    """The picture of one effect, as ``PICTURES`` says unless given."""
    picture = PICTURES[name] if picture is None else picture
    runs = [Run("without", WITHOUT, frames(picture.weather, ()))]
    for setting, colour in zip(picture.settings, (WEAK, STRONG), strict=True):
        units = {parameter.name: parameter.unit.replace("1", "") for parameter in EFFECTS[name].arguments}
        texts = (f"{key} = {value:g} {units[key]}".strip() for key, value in setting.items())
        label = ", ".join(texts).replace("-", "−")
        effect = {"effect": name, **picture.common, **setting}
        runs.append(Run(label, colour, frames(picture.weather, (effect,))))
    if picture.also is not None:
        runs.append(Run(f"{label}, {weather_text(picture.also)}", "#e8590c", frames(picture.also, (effect,))))
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(picture.panels)))
    for axes, panel in zip(panels, picture.panels, strict=True):
        plain_axes(axes)
        panel.draw(axes, beams, runs)
    panels[0].set_title(weather_text(picture.weather), loc="left", fontsize=9)
    where, place = picture.legend
    panels[where].legend(frameon=False, fontsize=8, loc=place)
    return figure


def save(figure: Figure, path: Path, colours: int = COLOURS) -> None:
    """A PNG of few colours, written under another name first."""
    memory = io.BytesIO()
    figure.savefig(memory, dpi=DPI)
    image = Image.open(memory).convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    with atomic_write(path) as unfinished:
        image.save(unfinished, format="PNG", optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="ids such as lidar.window_loss; all unless given")
    parser.add_argument("--out", type=Path, default=Path("lidar_effects"), help="folder")
    parser.add_argument("--frames", type=int, default=24, help="over which statistics are taken")
    parser.add_argument("--columns", type=int, default=256, help="of the scan; fewer is quicker")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.effects) - set(PICTURES))
    if unknown:
        parser.error(f"no such effect: {', '.join(unknown)}; known are {', '.join(PICTURES)}")

    beams = beams_of(arguments.columns)
    plain = lru_cache(lambda weather: frames_of(beams, weather, (), arguments.frames))

    def frames(weather: Weather, effects: tuple[Mapping[str, Any], ...]) -> Frames:
        return frames_of(beams, weather, effects, arguments.frames) if effects else plain(weather)

    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.effects or PICTURES:
        path = arguments.out / f"{name}.png"
        with mpl.rc_context({**STYLE, "font.size": 9.0}):
            save(draw(name, beams, frames), path)
        print(f"{EFFECTS[name].title}: {path}")


if __name__ == "__main__":
    main()
