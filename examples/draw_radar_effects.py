"""Draw what each effect of the radar catalogue does, with no data of your own.

    python examples/draw_radar_effects.py --out pictures
    python examples/draw_radar_effects.py --out pictures radar.wet_radome radar.multipath

One picture an effect, named after it: the statistic in which it shows, along its axis, in the same weather without the
effect and at two strengths. The targets are made up: at rest, of three classes, evenly spread in range, azimuth and
margin over the detection threshold. The radar is the embedded AWR1843-like one. The pictures of docs/effects-radar.md
are made by this script.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from draw_lidar_effects import save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.physics import wet_cover_series_db
from torchweather.report.figures import STYLE, plain_axes
from torchweather.stages import EFFECTS

Array = NDArray[Any]

SIZE_INCH, COLOURS = (6.0, 2.6), 64
WITHOUT, WEAK, STRONG = "#b3bcc5", "#4dabf7", "#0b4f8a"
MAP_TITLE: dict[str, Any] = {"fontsize": 8, "fontweight": "normal"}  # the setting that a map shows
LEAST_VALUES = 20  # in a bin that is drawn; fewer say little

SENSOR = tw.Radar.preset("awr1843-like")
CLEAR_AIR, RAIN, HEAVY_RAIN = tw.Rain(0.0), tw.Rain(25.0), tw.Rain(50.0)
CLASSES = ("car", "person", "bush")
NEAR_M, FAR_M, VIEW_DEG, MOST_MARGIN_DB = 5.0, 65.0, 50.0, 25.0
SPEED_NOISE_M_PER_S, POWER_NOISE_DB = 0.03, 0.4  # of clear frames: a quarter of a bin, and that of an SNR of 24 dB


# ---- frames ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Targets:
    """What the radar detects in clear air; ``(N,)`` each."""

    points: torch.Tensor
    range_m: Array
    azimuth_deg: Array
    margin_db: Array
    kind: Array


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, N)`` of the targets and ``(F, K, 6)`` of what is listed besides; lost is NaN."""

    power_db: Array
    snr_db: Array
    speed_m_per_s: Array
    range_m: Array
    floor_db: Array
    more: Array


@dataclass(frozen=True)
class Run:
    """Frames with what stands for them in a picture, and the settings of the effect."""

    label: str
    colour: str
    frames: Frames
    setting: Mapping[str, Any]


def targets_of(count: int) -> Targets:
    """Spread evenly, in an order that mixes ranges, azimuths, margins and classes."""
    even = torch.quasirandom.SobolEngine(4, scramble=True, seed=7).draw(count).double()
    range_m = NEAR_M + (FAR_M - NEAR_M) * even[:, 0]
    azimuth = torch.deg2rad(VIEW_DEG * (2.0 * even[:, 1] - 1.0))
    margin_db = MOST_MARGIN_DB * even[:, 2]
    power_db = SENSOR.floor_db + SENSOR.detection_snr_db + margin_db
    nothing = torch.zeros_like(range_m)
    columns = [range_m * azimuth.cos(), range_m * azimuth.sin(), nothing, nothing, power_db, nothing]
    kind = (len(CLASSES) * even[:, 3]).floor()
    values = (range_m, torch.rad2deg(azimuth), margin_db, kind.long())
    return Targets(torch.stack(columns, -1), *(value.numpy() for value in values))


def frames_of(targets: Targets, weather: Weather, effects: Sequence[Mapping[str, Any]], count: int) -> Frames:
    """Frames in the weather, each of a clear frame with noise of its own; the same draws for all effects."""
    transform = tw.RadarAttenuation(weather, SENSOR, effects=effects)
    points = targets.points.repeat(count, 1, 1)
    noise = torch.randn(2, *points.shape[:2], generator=torch.Generator().manual_seed(1), dtype=points.dtype)
    points[..., 3] += SPEED_NOISE_M_PER_S * noise[0]
    threshold_db = SENSOR.floor_db + SENSOR.detection_snr_db  # what is listed lies above
    points[..., 4] = (points[..., 4] + POWER_NOISE_DB * noise[1]).clamp_min(threshold_db)
    known = {"target_class": torch.from_numpy(targets.kind), "frame_number": torch.arange(count)}
    state = transform.state_of(points, **known)
    with torch.no_grad():
        found = transform.chain(state, transform.chain.draw(state, seed=torch.arange(count)))
    rows = targets.points.shape[0]
    lost = (found.kind == tw.PointKind.LOST)[..., None]
    listed = torch.where(lost, torch.nan, found.points).numpy()
    own, more = listed[:, :rows], listed[:, rows:]
    snr_db = torch.where(lost[:, :rows, 0], torch.nan, found.snr_db[:, :rows]).numpy()
    range_m = np.linalg.norm(own[..., :3], axis=-1)
    return Frames(own[..., 4], snr_db, own[..., 3], range_m, found.floor_db.numpy(), more)


# ---- statistics: x and y of a curve ------------------------------------------------------------------------------

Curve = tuple[Array, Array]
Statistic = Callable[[Targets, Run], Curve]


def middle(edges: Array) -> Array:
    found: Array = 0.5 * (edges[1:] + edges[:-1])
    return found


def in_bins(axis: Array, values: Array, edges: Array, average: Callable[[Array], Any] = np.nanmean) -> Curve:
    """Average of the values in each bin of the axis; not a number where there are few."""
    place = np.digitize(axis, edges) - 1
    found = np.full(len(edges) - 1, np.nan)
    for number in range(len(found)):
        inside = values[place == number]
        if np.isfinite(inside).sum() >= LEAST_VALUES:
            found[number] = average(inside)
    return middle(edges), found


def over_clear_air(
    targets: Targets, run: Run, axis: str, edges: Array, what: str = "power_db", margin_db: float = 12.0
) -> Curve:
    """Mean power, or SNR, over that in clear air, of targets that no effect drawn here takes under the threshold."""
    clear = {"power_db": targets.points[:, 4].numpy(), "snr_db": targets.margin_db + SENSOR.detection_snr_db}[what]
    ratio = getattr(run.frames, what) - clear
    picked = np.broadcast_to(targets.margin_db > margin_db, ratio.shape)
    return in_bins(np.broadcast_to(getattr(targets, axis), ratio.shape)[picked], ratio[picked], edges)


def of_classes(targets: Targets, run: Run) -> Curve:
    """Mean power over clear air's of each class."""
    place, ratio = over_clear_air(targets, run, "kind", np.arange(len(CLASSES) + 1) - 0.5)
    return place, ratio


def lost_share(targets: Targets, run: Run, edges: Array) -> Curve:
    """Targets that are not listed, percent, by their margin in clear air."""
    lost = 100.0 * np.isnan(run.frames.power_db)
    return in_bins(np.broadcast_to(targets.margin_db, lost.shape), lost, edges)


def density(values: Array, edges: Array, per: float) -> Curve:
    """Finite values in each unit of their axis, over ``per``."""
    counts, _ = np.histogram(values[np.isfinite(values)], edges)
    return middle(edges), counts / np.diff(edges) / per


def range_of(rows: Array) -> Array:
    found: Array = np.linalg.norm(rows[..., :3], axis=-1)
    return found


def more_by_range(targets: Targets, run: Run, edges: Array) -> Curve:
    """Detections besides the targets' in a frame, per metre of range."""
    return density(range_of(run.frames.more), edges, len(run.frames.more))


def more_by_speed(targets: Targets, run: Run, edges: Array) -> Curve:
    """Detections besides the targets' in a frame, per m/s of speed."""
    return density(run.frames.more[..., 3], edges, len(run.frames.more))


def behind_targets(targets: Targets, run: Run, edges: Array) -> Curve:
    """Ghosts by how far they stand behind their target, percent of the targets in a bin."""
    if not run.frames.more.shape[1]:
        return middle(edges), np.zeros(len(edges) - 1)
    behind = range_of(run.frames.more) - targets.range_m
    counts, _ = np.histogram(behind[np.isfinite(behind)], edges)
    return middle(edges), 100.0 * counts / behind.size


def ratio_share(targets: Targets, run: Run, edges: Array) -> Curve:
    """Targets by their power over that in clear air, percent per dB."""
    ratio = (run.frames.power_db - targets.points[:, 4].numpy())[:, targets.margin_db > 12.0]
    x, y = density(ratio, edges, ratio.size / 100.0)
    return x, y


def speed_share(targets: Targets, run: Run, edges: Array) -> Curve:
    """Targets, which stand still, by their measured speed, percent per 0.1 m/s."""
    speed = run.frames.speed_m_per_s
    return density(speed, edges, np.isfinite(speed).sum() / 10.0)


def by_frame(targets: Targets, run: Run, what: Callable[[Targets, Frames], Array]) -> Curve:
    """A number of each frame."""
    value = what(targets, run.frames)
    return np.arange(1, len(value) + 1), value


def floors(targets: Targets, frames: Frames) -> Array:
    return frames.floor_db


def listed(targets: Targets, frames: Frames) -> Array:
    found: Array = 100.0 * np.isfinite(frames.power_db).mean(1)
    return found


def listed_of(targets: Targets, run: Run, sizes: Array) -> Curve:
    """Detections listed of a frame that holds so many targets."""
    effects = [{"effect": "radar.detection_limit", **run.setting}] if run.setting else []
    found = [np.isfinite(frames_of(targets_of(int(size)), RAIN, effects, 1).power_db).sum() for size in sizes]
    return sizes, np.array(found)


def residuals(targets: Targets, frames: Frames) -> Array:
    found: Array = 100.0 * np.nanmean(frames.range_m - targets.range_m, axis=1)
    return found


def one_target(targets: Targets, frames: Frames) -> Array:
    """Power over clear air's of a strong target in the middle of the ranges, in each frame."""
    chosen = np.argmin(np.abs(targets.range_m - 25.0) + 50.0 * (targets.margin_db < 20.0))
    found: Array = frames.power_db[:, chosen] - targets.points[chosen, 4].numpy()
    return found


def drying(targets: Targets, run: Run, rain_min: float = 20.0, until_min: float = 90.0) -> Curve:
    """Loss of the cover through a shower of 25 mm/h and after it."""
    time = torch.arange(0.0, until_min + 0.25, 0.25)
    rain = torch.where((time >= 5.0) & (time < 5.0 + rain_min), 25.0, 0.0)
    values = EFFECTS["radar.wet_radome"](**run.setting).config()
    return time.numpy(), wet_cover_series_db(rain, time, **values).numpy()


# ---- panels ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lines:
    """A statistic as a line for each run: the broad one is without the effect, so that lines on it are seen.

    ``instead``: parameters that this panel alone has, with both settings.
    """

    statistic: Statistic
    x: str
    y: str
    steps: bool = False
    dots: bool = False
    zero: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)
    instead: Mapping[str, Any] | None = None

    def draw(self, axes: Axes, targets: Targets, runs: Sequence[Run]) -> None:
        for number, run in enumerate(runs):
            x, y = self.statistic(targets, run)
            x, y = x[np.isfinite(y)], y[np.isfinite(y)]
            style: dict[str, Any] = {"linewidth": 4.5 if number == 0 else 1.6, "solid_capstyle": "butt"}
            if self.dots:
                style = {"linestyle": "none", "marker": "o", "markersize": (9.0, 6.0, 3.5)[number]}
            elif self.steps:
                style["drawstyle"] = "steps-mid"
            elif number and len(x) < 40:
                style |= {"marker": "o", "markersize": 3.0}
            axes.plot(x, y, color=run.colour, label=run.label, zorder=2 + number, **style)
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
    instead: Mapping[str, Any] | None = None

    def draw(self, axes: Axes, targets: Targets, runs: Sequence[Run]) -> None:
        width = 0.8 / len(runs)
        for number, run in enumerate(runs):
            place, value = self.statistic(targets, run)
            axes.bar(place + (number - 0.5 * (len(runs) - 1)) * width, value, width, color=run.colour, label=run.label)
        axes.axhline(0.0, color="#1b2733", linewidth=0.8)
        axes.set_xticks(range(len(self.classes)), labels=self.classes)
        axes.grid(axis="x", visible=False)
        axes.set(xlabel=self.x, ylabel=self.y)


Panel = Lines | Bars


@dataclass(frozen=True)
class Picture:
    """How an effect is drawn.

    Args:
        weather: the same without and with the effect.
        settings: weak and strong.
        panels: one or two.
        common: parameters that say where or how.
        targets: how many.
        legend: of which panel, and where in it.
    """

    weather: Weather
    settings: tuple[Mapping[str, Any], Mapping[str, Any]]
    panels: tuple[Panel, ...]
    common: Mapping[str, Any] = field(default_factory=dict)
    targets: int = 2048
    legend: tuple[int, str] = (0, "best")


def bins(low: float, high: float, step: float) -> Array:
    return np.arange(low, high + 0.5 * step, step)


RANGE, AZIMUTH, MARGIN = "range of the target, m", "azimuth, degrees", "margin in clear air, dB"
RATIO, LOST, FRAME = "power over clear air's, dB", "targets lost, %", "frame"
ratio_by_range = Lines(partial(over_clear_air, axis="range_m", edges=bins(5, 65, 5)), RANGE, RATIO)
snr_by_margin = Lines(
    partial(over_clear_air, axis="margin_db", edges=bins(0, 25, 1), what="snr_db", margin_db=0.0),
    MARGIN,
    "SNR over clear air's, dB",
    more={"ylim": (-9.0, 1.0)},
)
ratio_by_margin = Lines(
    partial(over_clear_air, axis="margin_db", edges=bins(0, 25, 1), margin_db=0.0),
    MARGIN,
    RATIO,
    more={"ylim": (-9.0, 1.0)},
)
lost_by_margin = Lines(partial(lost_share, edges=bins(0, 16, 1)), MARGIN, LOST, zero=True)

PICTURES: dict[str, Picture] = {
    "radar.wet_radome": Picture(
        RAIN,
        ({"film_db": 0.5}, {"film_db": 1.5}),
        (ratio_by_range, Lines(drying, "time, min (rain from 5 to 25 min)", "loss of the cover, dB")),
        legend=(1, "upper right"),
    ),
    "radar.volume_clutter": Picture(
        RAIN,
        ({"share": 0.003}, {"share": 0.01}),
        (
            Lines(
                partial(more_by_range, edges=bins(0, 12, 0.5)),
                "range of the detection, m",
                "detections per m",
                steps=True,
                zero=True,
            ),
            Lines(
                partial(more_by_speed, edges=bins(-6, 6, 0.5)),
                "radial speed, m/s",
                "detections per m/s",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "radar.noise_floor": Picture(RAIN, ({"shift_db": 3.0}, {"shift_db": 6.0}), (lost_by_margin, snr_by_margin)),
    "radar.cfar_shift": Picture(RAIN, ({"shift_db": 3.0}, {"shift_db": 6.0}), (lost_by_margin, snr_by_margin)),
    "radar.path_loss_scale": Picture(
        HEAVY_RAIN, ({"factor": 0.5}, {"factor": 2.0}), (ratio_by_range, lost_by_margin), legend=(0, "lower left")
    ),
    "radar.multipath": Picture(
        CLEAR_AIR,
        ({"amplitude": 0.2}, {"amplitude": 0.5}),
        (
            Lines(
                partial(behind_targets, edges=bins(-0.25, 6.25, 0.5)),
                "range behind the target, m",
                "targets with a ghost, %",
                steps=True,
                zero=True,
            ),
            Lines(
                partial(ratio_share, edges=bins(-10.25, 6.25, 0.5)),
                RATIO,
                "targets per dB, %",
                steps=True,
                zero=True,
                more={"title": "delay_m = 0.1 m", "xlim": (-13.0, 6.0)},
                instead={"delay_m": 0.1},
            ),
        ),
        common={"delay_m": 3.0},
        legend=(1, "upper left"),
    ),
    "radar.doppler_spread": Picture(
        RAIN,
        ({"std_m_per_s": 0.1}, {"std_m_per_s": 0.3}),
        (
            Lines(
                partial(speed_share, edges=bins(-1.0125, 1.0125, 0.025)),
                "measured speed of targets at rest, m/s",
                "targets per 0.1 m/s, %",
                steps=True,
                zero=True,
            ),
        ),
    ),
    "radar.wet_rcs": Picture(
        RAIN,
        ({"gain_db": (0.0, 1.0, 2.0)}, {"gain_db": (-1.0, 2.0, 4.0)}),
        (Bars(of_classes, CLASSES, "class of the target", RATIO),),
    ),
    "radar.interference": Picture(
        RAIN,
        ({"probability": 0.1}, {"probability": 0.4}),
        (
            Lines(partial(by_frame, what=floors), FRAME, "noise floor, dBm", dots=True),
            Lines(partial(by_frame, what=listed), FRAME, "targets detected, %", dots=True, more={"ylim": (0, 105)}),
        ),
        common={"level_db": 10.0},
        legend=(1, "lower left"),
    ),
    "radar.range_migration": Picture(
        RAIN,
        ({"m_per_frame": 0.01}, {"m_per_frame": 0.03}),
        (Lines(partial(by_frame, what=residuals), FRAME, "range less clear air's, cm"),),
    ),
    "radar.pattern_tilt": Picture(
        RAIN,
        ({"angle_rad": 0.05}, {"angle_rad": -0.1}),
        (
            Lines(
                partial(over_clear_air, axis="azimuth_deg", edges=bins(-50, 50, 5)),
                AZIMUTH + " (left is positive)",
                RATIO,
                more={"xlim": (50, -50)},
            ),
        ),
    ),
    "radar.fluctuation": Picture(
        RAIN,
        ({"log_std_db": 1.5}, {"log_std_db": 4.0}),
        (
            Lines(partial(by_frame, what=one_target), FRAME, f"{RATIO}\n(one target)"),
            Lines(
                partial(ratio_share, edges=bins(-16.25, 10.25, 0.5)),
                RATIO,
                "targets per dB, %",
                steps=True,
                zero=True,
                more={"xlim": (-29.0, 10.0)},
            ),
        ),
        legend=(1, "upper left"),
    ),
    "radar.detection_limit": Picture(
        RAIN,
        ({"max_count": 100.0}, {"max_count": 50.0}),
        (
            Lines(partial(lost_share, edges=bins(0, 25, 1)), MARGIN, LOST),
            Lines(partial(listed_of, sizes=bins(16, 256, 16)), "targets in the frame", "detections listed", zero=True),
        ),
        targets=256,
        legend=(1, "upper left"),
    ),
}


def weather_text(weather: Weather) -> str:
    return f"{weather.kind}, {float(weather.knob):g} mm/h" if weather.knob else "clear air"


def value_text(value: Any) -> str:
    found = ", ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"
    return found.replace("-", "−")


def draw(
    name: str, targets: Callable[[int], Targets], frames: Callable[[int, Weather, Mapping[str, Any]], Frames]
) -> Figure:
    """The picture of one effect."""
    picture = PICTURES[name]
    units = {parameter.name: parameter.unit.replace("1", "") for parameter in EFFECTS[name].arguments}
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(picture.panels)))
    for axes, panel in zip(panels, picture.panels, strict=True):
        runs = [Run("without", WITHOUT, frames(picture.targets, picture.weather, {}), {})]
        for setting, colour in zip(picture.settings, (WEAK, STRONG), strict=True):
            label = ", ".join(f"{key} = {value_text(value)} {units[key]}".strip() for key, value in setting.items())
            values = {**picture.common, **setting, **(panel.instead or {})}
            effect = {"effect": name, **values}
            runs.append(Run(label, colour, frames(picture.targets, picture.weather, effect), values))
        plain_axes(axes)
        panel.draw(axes, targets(picture.targets), runs)
    where = ", ".join(f"{key} = {value_text(value)} {units[key]}".strip() for key, value in picture.common.items())
    panels[0].set_title(", ".join(filter(None, (weather_text(picture.weather), where))), loc="left", fontsize=9)
    for axes in panels[1:]:
        axes.set_title(axes.get_title(), loc="left", **MAP_TITLE)
        if axes.get_title(loc="center"):
            axes.set_title("", loc="center")
    number, place = picture.legend
    panels[number].legend(frameon=False, fontsize=8, loc=place)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="ids such as radar.wet_radome; all unless given")
    parser.add_argument("--out", type=Path, default=Path("radar_effects"), help="folder")
    parser.add_argument("--frames", type=int, default=24, help="over which statistics are taken")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.effects) - set(PICTURES))
    if unknown:
        parser.error(f"no such effect: {', '.join(unknown)}; known are {', '.join(PICTURES)}")

    targets = lru_cache(targets_of)

    def frames(count: int, weather: Weather, effect: Mapping[str, Any]) -> Frames:
        return frames_of(targets(count), weather, [effect] if effect else [], arguments.frames)

    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.effects or PICTURES:
        path = arguments.out / f"{name}.png"
        with mpl.rc_context({**STYLE, "font.size": 9.0}):
            save(draw(name, targets, frames), path, COLOURS)
        print(f"{EFFECTS[name].title}: {path}")


if __name__ == "__main__":
    main()
