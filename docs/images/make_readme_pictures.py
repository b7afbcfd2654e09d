"""Make the pictures of the README: a photograph in weather, a film of snow, a point cloud in snow.

    python docs/images/make_readme_pictures.py
    python docs/images/make_readme_pictures.py --out pictures --photograph photographs/downtown_street.jpg
    python docs/images/make_readme_pictures.py --original mmod_cars_test_image2.jpg    # the photograph itself, first

A file of the photograph's name and the ending .json holds what the picture does not tell: angle of view, horizon,
camera height, width of the street, and boxes of the objects that stand on the ground. All of these are estimates, so
the depth is guessed. photographs/SOURCES.md names author and licence.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image, ImageColor, ImageDraw, ImageFilter, ImageFont
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth import SceneDepth, ScenePrior
from torchweather.io import atomic_write
from torchweather.scenes import lidar_view, test_track

HERE = Path(__file__).parent
PHOTOGRAPH = HERE / "photographs" / "downtown_street.jpg"
SEED = 7

WIND_M_PER_S = (0.0, -1.5, 0.0)  # from the left
BREEZE_M_PER_S = (0.0, -0.5, 0.0)  # slow enough for the eye to follow a flake at the film's frame rate
PANELS: dict[str, Weather | None] = {
    "clear": None,
    "rain of 60 mm/h in mist of 400 m visibility": tw.Mixture(
        tw.Rain(rate_mm_per_h=60.0, wind_m_per_s=WIND_M_PER_S), tw.Fog(mor_m=400.0)
    ),
    "fog of 100 m visibility": tw.Fog(mor_m=100.0),
    "snow of 2 mm/h in haze of 800 m visibility": tw.Mixture(
        tw.Snow(rate_mm_per_h=2.0, wind_m_per_s=WIND_M_PER_S), tw.Fog(mor_m=800.0)
    ),
}
PICTURE_WIDTH, GAP = 1600, 8
FILM_WIDTH, FILM_FRAMES, FILM_RATE_HZ = 600, 24, 15.0
# Objects grey, flakes orange, lost points blue: told apart by every eye, as on the pages of `torchweather view`.
OBJECT, FLAKE, LOST, NIGHT = "#b9c6d2", "#ff7f2a", "#4f97ea", "#10161d"
CLOUD_SIZE_PX, CLOUD_SHADES = (1200, 520), 8  # shades of each colour on the dark ground
# The eye of the cloud's picture, in the LiDAR's frame: behind and above it, looking ahead and slightly down.
EYE_M, EYE_PITCH_RAD, EYE_FOCAL = (-17.0, 1.0, 8.0), -0.27, 0.9
NEAREST_M = 1.5  # to the eye


# ---- the photograph ----------------------------------------------------------------------------------------------


def reduced(original: Path, settings: Mapping[str, Any]) -> Image.Image:
    """The original at the width of the settings, its number plates blurred."""
    picture = Image.open(original).convert("RGB")
    width = settings["original_width"]
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    for box in settings["blurred"]:
        picture.paste(picture.crop(box).filter(ImageFilter.GaussianBlur(5)), box)
    return picture


def street(photograph: Path, settings: Mapping[str, Any], box: Sequence[int], width: int) -> tuple[Tensor, Any, Any]:
    """A part of the photograph at a width: image ``(3, H, W)`` uint8, its camera and its guessed scene."""
    picture = Image.open(photograph).convert("RGB")
    focal = picture.width / 2 / math.tan(math.radians(settings["horizontal_view_deg"]) / 2)
    camera = tw.Camera.from_intrinsics(
        focal,
        focal,
        (picture.width - 1) / 2,
        settings["horizon_row"],  # the camera looks level: the horizon is in the row of the principal point
        picture.width,
        picture.height,
        height_m=settings["camera_height_m"],
        exposure_s=settings["exposure_s"],
        lens_blur_px=settings["lens_blur_px"],
    )
    left, top, right, bottom = box
    size = (width, round((bottom - top) * width / (right - left)))
    scale = width / (right - left)
    part = picture.crop((left, top, right, bottom)).resize(size, Image.Resampling.LANCZOS)
    image = torch.from_numpy(np.asarray(part).copy()).permute(2, 0, 1)
    camera = camera.cropped(top, left, bottom - top, right - left).resized(*size)
    prior = ScenePrior(
        horizon="camera",
        near_mask=None,
        street_half_width_m=tuple(settings["street_half_width_m"]),
        farthest_m=settings["farthest_m"],
        boxes=(torch.tensor(settings["objects"], dtype=torch.float32) - torch.tensor([left, top, left, top])) * scale,
    )
    return image, camera, prior.scene(camera, *image.shape[-2:], image=image)


def weathered(weather: Weather, camera: tw.Camera) -> tw.AsBayer:
    """The weather before a car that stands: the photograph does."""
    return tw.AsBayer(tw.BayerWeather(weather, camera))


def as_picture(image: Tensor) -> Image.Image:
    """A picture of ``(3, H, W)`` uint8."""
    return Image.fromarray(image.permute(1, 2, 0).contiguous().numpy())


def labelled(picture: Image.Image, text: str) -> Image.Image:
    """The picture with a small text at the lower left."""
    font = ImageFont.load_default(15)
    draw = ImageDraw.Draw(picture, "RGBA")
    _, _, right, bottom = draw.textbbox((0, 0), text, font=font)
    draw.rectangle((0, picture.height - bottom - 10, right + 16, picture.height), fill=(16, 22, 29, 200))
    draw.text((8, picture.height - bottom - 6), text, font=font, fill=(255, 255, 255))
    return picture


def before_after(photograph: Path, settings: Mapping[str, Any]) -> Image.Image:
    """Two rows of two panels: clear, rain, fog, snow."""
    width = (PICTURE_WIDTH - GAP) // 2
    image, camera, scene = street(photograph, settings, settings["panel"], width)
    rows, columns = image.shape[-2:]
    sheet = Image.new("RGB", (PICTURE_WIDTH, 2 * rows + GAP), "white")
    for number, (text, weather) in enumerate(PANELS.items()):
        seen = image
        if weather is not None:
            transform = weathered(weather, camera)
            seen = transform(image, scene, transform.draw(image, seed=SEED))
        place = (number % 2 * (columns + GAP), number // 2 * (rows + GAP))
        sheet.paste(labelled(as_picture(seen), text), place)
    return sheet


def film(photograph: Path, settings: Mapping[str, Any]) -> list[Image.Image]:
    """Frames of falling snow; the same flakes move from frame to frame."""
    image, camera, scene = street(photograph, settings, settings["film"], FILM_WIDTH)
    assert isinstance(scene, SceneDepth)
    snow = weathered(tw.Snow(rate_mm_per_h=2.0, wind_m_per_s=BREEZE_M_PER_S), camera)
    drawn = snow.draw_sequence(image, FILM_FRAMES, 1.0 / FILM_RATE_HZ, seed=SEED)
    return [as_picture(snow(image, scene, noise)) for noise in drawn]


# ---- the point cloud ---------------------------------------------------------------------------------------------


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


# ---- files -------------------------------------------------------------------------------------------------------


def main() -> None:
    """Write the three pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photograph", type=Path, default=PHOTOGRAPH, help="with a .json of its name beside it")
    parser.add_argument("--original", type=Path, help="make the photograph from this file first")
    parser.add_argument("--columns", type=int, default=2048, help="of the LiDAR's scan")
    parser.add_argument("--out", type=Path, default=HERE, help="folder for the pictures")
    arguments = parser.parse_args()

    settings = json.loads(arguments.photograph.with_suffix(".json").read_text(encoding="utf-8"))
    if arguments.original is not None:
        with atomic_write(arguments.photograph) as unfinished:
            reduced(arguments.original, settings).save(unfinished, format="JPEG", quality=90, optimize=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    frames = film(arguments.photograph, settings)
    moving: dict[str, Any] = {"save_all": True, "append_images": frames[1:], "duration": round(1000 / FILM_RATE_HZ)}
    pictures: dict[str, tuple[Image.Image, dict[str, Any]]] = {
        "readme_before_after.jpg": (
            before_after(arguments.photograph, settings),
            {"format": "JPEG", "quality": 82, "optimize": True},
        ),
        "readme_snow.webp": (frames[0], {"format": "WEBP", "quality": 60, "method": 6, "loop": 0, **moving}),
        "readme_cloud.png": (cloud(arguments.columns), {"format": "PNG", "optimize": True}),
    }
    for name, (picture, how) in pictures.items():
        path = arguments.out / name
        with atomic_write(path) as unfinished:
            picture.save(unfinished, **how)
        print(f"{path}: {picture.width} x {picture.height} px, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
