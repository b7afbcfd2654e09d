"""A photograph in weather, for the README: two rows of panels, and a film of falling snow.

A file of the photograph's name and the ending .json holds what the picture does not tell: angle of view, horizon,
camera height, width of the street, and boxes of the objects that stand on the ground. All of these are estimates, so
the depth is guessed. images/photographs/SOURCES.md names author and licence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFilter, ImageFont
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth import SceneDepth, ScenePrior

IMAGES = Path(__file__).parents[1] / "images"
PHOTOGRAPH = IMAGES / "photographs" / "downtown_street.jpg"
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
