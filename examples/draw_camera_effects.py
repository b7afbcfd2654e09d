"""Draw what each effect of the camera catalogue does, with no data of your own.

    python examples/draw_camera_effects.py --out pictures
    python examples/draw_camera_effects.py --out pictures camera.defocus camera.wet_surface

One picture an effect, named after it. Left: the statistic in which it shows, along its axis, in the same weather
without the effect and at two strengths. Right: a frame without it and one at the greater strength. The scene is the
embedded test track, seen by a Lucid Triton of few pixels; curves are over all frames. The pictures of
docs/effects-camera.md are made by this script.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from draw_lidar_effects import save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.report.figures import STYLE, plain_axes
from torchweather.scenes import SceneView, test_track
from torchweather.stages import EFFECTS

Array = NDArray[Any]

SIZE_INCH, COLOURS = (6.0, 2.6), 96
WITHOUT, WEAK, STRONG = "#b3bcc5", "#4dabf7", "#0b4f8a"
LEAST_VALUES = 40  # in a bin that is drawn; fewer say little
GAMMA, GAIN = 2.2, 1.6  # of the display
MASK_WHITE, CHANGE_WHITE = 0.15, 0.03  # cover by particles, and departure from the median frame, shown white
WALL_M = 8.0  # depth at which particles are shown: in front of a wall

MIST, FOG, RAIN = tw.Fog(mor_m=150.0), tw.Fog(mor_m=60.0), tw.Rain(25.0)
# Rows and columns of the frame, as shares: all of the road, and the objects ahead.
ROAD, AHEAD = ((0.28, 0.84), (0.0, 1.0)), ((0.42, 0.63), (0.31, 0.69))
HIGH, WALL = ((0.1, 0.66), (0.0, 1.0)), ((0.22, 0.36), (0.3, 0.55))


# ---- frames ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, H, W)`` each."""

    signal: Array
    transmission: Array
    mask: Array


@dataclass(frozen=True)
class Run:
    """Frames with what stands for them in a picture."""

    label: str
    colour: str
    frames: Frames


def frames_of(view: SceneView, weather: Weather, effects: Sequence[Mapping[str, Any]], count: int) -> Frames:
    """Frames in the weather; the same draws for all effects."""
    # The sky of the scene, also where a wall stands in front of it.
    sky = view.rgb[:, view.object_id[0] < 0].mean(1).tolist()
    transform = tw.BayerWeather(weather, view.camera, airlight=sky, effects=effects)
    found = []
    for seed in range(count):
        noise = transform.draw(view.bayer, seed=seed)
        result = transform.run(view.bayer, view.depth_m, noise, normal=view.normal)
        found.append([value[0].numpy() for value in (result.bayer, result.transmission, result.particle_mask)])
    signal, transmission, mask = (np.stack(values) for values in zip(*found, strict=True))
    return Frames(signal, transmission, mask)


def displayed(signal: Array) -> Array:
    """A raw frame as a picture of half its size: each cell of the mosaic one pixel."""
    red, blue = signal[0::2, 0::2], signal[1::2, 1::2]
    green = 0.5 * (signal[0::2, 1::2] + signal[1::2, 0::2])
    picture: Array = np.clip(GAIN * np.stack([red, green, blue], -1), 0.0, 1.0) ** (1.0 / GAMMA)
    return picture


def greens(values: Array) -> Array:
    """One green phase of the mosaic ``(..., H, W)``."""
    found: Array = values[..., 0::2, 1::2]
    return found


# ---- statistics: each gives x and y of a curve ---------------------------------------------------------------------

Statistic = Callable[[SceneView, Run, Run], tuple[Array, Array]]


def binned(x: Array, values: Array, edges: Array) -> tuple[Array, Array]:
    """Mean of the values in each bin of x."""
    found = []
    for low, high in pairwise(edges):
        inside = (x >= low) & (x < high) & np.isfinite(values)
        found.append(values[inside].mean() if inside.sum() >= LEAST_VALUES else np.nan)
    return 0.5 * (edges[1:] + edges[:-1]), np.array(found)


def depth_of(view: SceneView) -> Array:
    return greens(view.depth_m[0].numpy())


DEPTHS_M = np.concatenate([np.arange(2.5, 15.0, 2.5), np.arange(15.0, 61.0, 5.0)])


def against_depth(
    view: SceneView, run: Run, plain: Run, *, make: Callable[[Array, Array], Array]
) -> tuple[Array, Array]:
    """A value made of the signal and of that without the effect, against depth."""
    own, other = (greens(one.frames.signal).mean(0) for one in (run, plain))
    return binned(depth_of(view), make(own, other), DEPTHS_M)


def optical_depth(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    """Of the red and blue pixels together, from the transmission."""
    return binned(depth_of(view), -np.log(np.maximum(greens(run.frames.transmission).mean(0), 1e-6)), DEPTHS_M)


def against_radius(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    height, width = view.bayer.shape[-2:]
    row, column = np.mgrid[:height, :width]
    radius = greens(np.hypot(row - (height - 1) / 2, column - (width - 1) / 2))
    own, other = (greens(one.frames.signal).mean(0) for one in (run, plain))
    return binned(radius, own / other, np.arange(0.0, 310.0, 15.0))


def sharpness(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    """Mean step between neighbours of a colour over that without the effect, against depth."""
    edges = DEPTHS_M[DEPTHS_M < 50.0]
    steps = [np.hypot(*np.gradient(greens(one.frames.signal).mean(0))) for one in (run, plain)]
    (x, own), (_, other) = (binned(depth_of(view), step, edges) for step in steps)
    return x, own / other


def sharpness_by_direction(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    """What is left of steps across edges, against the direction of the step."""
    down, across = np.gradient(greens(plain.frames.signal).mean(0))
    own_down, own_across = np.gradient(greens(run.frames.signal).mean(0))
    size = np.hypot(down, across)
    direction = np.degrees(np.arctan2(down, across)) % 180.0
    left = (own_down * down + own_across * across) / np.maximum(size, 1e-6) ** 2
    strong = size > np.quantile(size, 0.9)
    return binned(direction[strong], left[strong], np.arange(0.0, 181.0, 15.0))


def along_a_row(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    signal = greens(run.frames.signal)[0]
    row = int(0.65 * len(signal))
    return 2.0 * np.arange(signal.shape[1]), signal[row]


def streak_directions(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    """Correlation of the particles' mask with itself twelve pixels along each direction."""
    lean = np.arange(-60.0, 61.0, 5.0)
    mask = run.frames.mask - run.frames.mask.mean((1, 2), keepdims=True)
    whole, found = (mask**2).mean(), []
    for angle in np.radians(lean):
        down, aside = round(12.0 * np.cos(angle)), round(12.0 * np.sin(angle))
        shifted = np.roll(mask, (-down, -aside), (1, 2))[:, : mask.shape[1] - down]
        found.append((mask[:, : mask.shape[1] - down] * shifted).mean() / whole)
    return lean, np.array(found)


def on_the_road(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    own, other = (greens(one.frames.signal).mean(0) for one in (run, plain))
    level = greens(view.normal[2].numpy()) > 0.9
    return binned(depth_of(view)[level], (own / other)[level], np.concatenate([[2.5, 3.5], DEPTHS_M[1:10]]))


def variance(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    signal, mean = greens(run.frames.signal), greens(plain.frames.signal).mean(0)
    return binned(mean, 1e4 * signal.var(0, ddof=1), np.arange(0.02, 0.62, 0.04))


def response(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    own, other = (greens(one.frames.signal)[0] for one in (run, plain))
    return binned(other, own, np.arange(0.0, 0.66, 0.02))


def frame_by_frame(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    there = (depth_of(view) > 30.0) & (depth_of(view) < 50.0)
    return np.arange(len(run.frames.signal)), greens(run.frames.transmission)[:, there].mean(1)


def by_elevation(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    height, width = view.bayer.shape[-2:]
    row = np.mgrid[:height, :width][0]
    elevation = np.degrees(np.arctan(((height - 1) / 2 - row) / view.camera.fy))
    return binned(greens(elevation), greens(run.frames.transmission).mean(0), np.arange(-30.0, 31.0, 3.0))


def flicker(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    return binned(depth_of(view), 1e3 * greens(run.frames.signal).std(0, ddof=1), DEPTHS_M)


def cover(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    return binned(depth_of(view), 100.0 * greens(run.frames.mask).mean(0), DEPTHS_M)


def streak_lengths(view: SceneView, run: Run, plain: Run) -> tuple[Array, Array]:
    """Correlation of the mask with itself some rows below."""
    mask = run.frames.mask - run.frames.mask.mean((1, 2), keepdims=True)
    rows = np.arange(0, 26)
    whole = (mask**2).mean()
    return rows, np.array([(mask[:, : mask.shape[1] - lag] * mask[:, lag:]).mean() / whole for lag in rows])


# ---- pictures ----------------------------------------------------------------------------------------------------

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


ratio = partial(against_depth, make=lambda own, other: own / other)
more = partial(against_depth, make=lambda own, other: own - other)
DEPTH, RATIO, MORE = "depth, m", "signal over that without", "signal more than without"
SHARP = "sharpness over that without"

PICTURES: dict[str, Picture] = {
    "camera.exposure_gain": Picture(MIST, ({"factor": 0.8}, {"factor": 1.4}), ratio, DEPTH, RATIO),
    "camera.airlight_scale": Picture(
        FOG,
        ({"red": 0.8, "green": 0.8, "blue": 0.8}, {"red": 1.2, "green": 1.2, "blue": 1.2}),
        more,
        DEPTH,
        MORE,
        legend="lower left",
        limits=(-0.24, 0.12),
    ),
    "camera.extinction_scale": Picture(
        MIST, ({"factor": 0.5}, {"factor": 2.0}), optical_depth, DEPTH, "optical depth", zero=True
    ),
    "camera.stray_light": Picture(
        MIST, ({"offset": 0.03}, {"offset": 0.1}), more, DEPTH, MORE, zero=True, legend="center right"
    ),
    "camera.aerosol_glow": Picture(
        FOG,
        ({"share_per_optical_depth": 0.3}, {"share_per_optical_depth": 1.5}),
        sharpness,
        DEPTH,
        SHARP,
        AHEAD,
        common={"width_px_per_optical_depth": 4.0},
        zero=True,
    ),
    "camera.defocus": Picture(
        MIST, ({"radius_px": 1.5}, {"radius_px": 4.0}), sharpness, DEPTH, SHARP, AHEAD, zero=True
    ),
    "camera.ego_blur": Picture(
        MIST,
        ({"length_px": 4.0}, {"length_px": 12.0}),
        sharpness_by_direction,
        "direction of the step, degrees",
        SHARP,
        AHEAD,
        common={"angle_rad": 0.0},
        limits=(-0.4, 1.05),
        legend="lower center",
    ),
    "camera.adherent_drops": Picture(
        MIST,
        ({"cover": 0.1}, {"cover": 0.3}),
        along_a_row,
        "column, px",
        "signal along a row",
        legend="upper left",
        limits=(0.1, 0.75),
    ),
    "camera.vignetting": Picture(
        MIST,
        ({"strength": 0.3}, {"strength": 1.0}),
        against_radius,
        "distance from the image's centre, px",
        RATIO,
        ((0.0, 1.0), (0.0, 1.0)),
    ),
    "camera.wind_slant": Picture(
        RAIN,
        ({"angle_rad": 0.2}, {"angle_rad": 0.5}),
        streak_directions,
        "lean of streaks to the right, degrees",
        "correlation 12 px along it",
        WALL,
        shown="cover",
        one_depth_m=WALL_M,
        shown_depth_m=WALL_M,
        limits=(-0.004, 0.045),
        legend="upper left",
    ),
    "camera.wet_surface": Picture(
        MIST,
        ({"darkening": 0.4, "mirror": 0.0}, {"darkening": 0.4, "mirror": 1.0}),
        on_the_road,
        "depth of level ground, m",
        RATIO,
        legend="upper right",
        limits=(0.65, 1.6),
    ),
    "camera.sensor_noise": Picture(
        MIST,
        ({"electrons_per_unit": 3000.0}, {"electrons_per_unit": 500.0}),
        variance,
        "mean signal",
        "variance, 1e-4",
        AHEAD,
        common={"read_electrons": 5.0},
        zero=True,
    ),
    "camera.tone_curve": Picture(
        MIST, ({"gamma": 0.8}, {"gamma": 1.5}), response, "signal without", "signal", zero=True
    ),
    "camera.saturation": Picture(
        MIST, ({"level": 0.45}, {"level": 0.3}), response, "signal without", "signal", zero=True
    ),
    "camera.patchy_fog": Picture(
        FOG, ({"log_std": 0.3}, {"log_std": 0.8}), frame_by_frame, "frame", "transmission, 30 to 50 m away", zero=True
    ),
    "camera.height_fog": Picture(
        FOG,
        ({"scale_height_m": 20.0}, {"scale_height_m": 3.0}),
        by_elevation,
        "elevation, degrees",
        "transmission to 50 m",
        HIGH,
        one_depth_m=50.0,
        zero=True,
        legend="upper left",
    ),
    "camera.streak_contrast": Picture(
        RAIN,
        ({"factor": 0.5}, {"factor": 3.0}),
        flicker,
        DEPTH,
        "standard deviation, 1e-3",
        WALL,
        shown="change",
        shown_depth_m=WALL_M,
        zero=True,
    ),
    "camera.particle_count": Picture(
        RAIN,
        ({"factor": 0.5}, {"factor": 2.0, "depth_max_m": 20.0}),
        cover,
        DEPTH,
        "covered by drops, %",
        WALL,
        shown="cover",
        shown_depth_m=WALL_M,
        zero=True,
        limits=(0.0, 11.0),
        legend="upper left",
    ),
    "camera.rolling_shutter": Picture(
        RAIN,
        ({"row_time_s": 1e-4}, {"row_time_s": 2e-4}),
        streak_lengths,
        "rows apart, px",
        "correlation of the cover",
        WALL,
        shown="cover",
        one_depth_m=WALL_M,
        shown_depth_m=WALL_M,
        zero=True,
    ),
}


def weather_text(weather: Weather) -> str:
    if isinstance(weather, tw.Fog):
        return f"fog, visibility {float(weather.mor_m):g} m"
    return f"{weather.kind}, {float(weather.knob):g} mm/h"


def setting_text(name: str, setting: Setting) -> str:
    units = {parameter.name: parameter.unit.replace("1", "") for parameter in EFFECTS[name].arguments}
    if set(setting) == {"red", "green", "blue"}:
        return f"red, green, blue = {setting['red']:g}"
    texts = (f"{key} = {value:g} {units[key]}".strip() for key, value in setting.items())
    return ",\n".join(texts).replace("-", "−")


def cut(values: Array, part: tuple[tuple[float, float], tuple[float, float]]) -> Array:
    """A part of a frame, at whole cells of the mosaic."""
    (top, bottom), (left, right) = part
    height, width = values.shape
    rows, stop = 2 * round(height / 2 * top), 2 * round(height / 2 * bottom)
    columns, end = 2 * round(width / 2 * left), 2 * round(width / 2 * right)
    found: Array = values[rows:stop, columns:end]
    return found


def show(axes: Axes, frames: Frames, picture: Picture, title: str) -> None:
    if picture.shown == "cover":
        axes.imshow(cut(frames.mask[0], picture.part), cmap="gray", vmin=0.0, vmax=MASK_WHITE, interpolation="nearest")
    elif picture.shown == "change":
        change = cut(frames.signal[0] - np.median(frames.signal, 0), picture.part)
        axes.imshow(change, cmap="gray", vmin=-CHANGE_WHITE, vmax=CHANGE_WHITE, interpolation="nearest")
    else:
        axes.imshow(displayed(cut(frames.signal[0], picture.part)), interpolation="nearest")
    axes.set_axis_off()
    axes.set_title(title, loc="left", fontsize=7.5, fontweight="normal", pad=2)


def draw(
    name: str, view: SceneView, frames: Callable[[Weather, tuple[Mapping[str, Any], ...], float | None], Frames]
) -> Figure:
    """The picture of one effect."""
    picture = PICTURES[name]
    plain = Run("without", WITHOUT, frames(picture.weather, (), picture.one_depth_m))
    runs = [plain]
    for setting, colour in zip(picture.settings, (WEAK, STRONG), strict=True):
        effect = {"effect": name, **picture.common, **setting}
        label = setting_text(name, setting)
        runs.append(Run(label, colour, frames(picture.weather, (effect,), picture.one_depth_m)))
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    plain_axes(axes)
    for run in runs:
        x, y = picture.curve(view, run, plain)
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
    shown = [frames(picture.weather, effects, picture.shown_depth_m) for effects in ((), (effect,))]
    what = {"frame": "", "cover": "cover by drops, ", "change": "less the median frame, "}[picture.shown]
    show(figure.add_subplot(grid[0, 1]), shown[0], picture, f"{what}without")
    show(figure.add_subplot(grid[1, 1]), shown[1], picture, label.replace("\n", " "))
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="ids such as camera.defocus; all unless given")
    parser.add_argument("--out", type=Path, default=Path("camera_effects"), help="folder")
    parser.add_argument("--frames", type=int, default=16, help="over which statistics are taken")
    parser.add_argument(
        "--width", type=int, default=480, help="of the frame in pixels, a multiple of 8; fewer is quicker"
    )
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.effects) - set(PICTURES))
    if unknown:
        parser.error(f"no such effect: {', '.join(unknown)}; known are {', '.join(PICTURES)}")

    camera = tw.Camera.preset("lucid-triton").resized(arguments.width, arguments.width * 3 // 4)
    view = test_track().view(camera)

    @lru_cache
    def at_depth(depth_m: float | None) -> SceneView:
        if depth_m is None:
            return view
        return replace(view, depth_m=torch.full_like(view.depth_m, depth_m))

    plain = lru_cache(lambda weather, depth_m: frames_of(at_depth(depth_m), weather, (), arguments.frames))

    def frames(weather: Weather, effects: tuple[Mapping[str, Any], ...], depth_m: float | None) -> Frames:
        if not effects:
            return plain(weather, depth_m)
        return frames_of(at_depth(depth_m), weather, effects, arguments.frames)

    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.effects or PICTURES:
        path = arguments.out / f"{name}.png"
        with mpl.rc_context({**STYLE, "font.size": 9.0}):
            save(draw(name, view, frames), path, COLOURS)
        print(f"{EFFECTS[name].title}: {path}")


if __name__ == "__main__":
    main()
