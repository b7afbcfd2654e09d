"""Photographs of a user's in rain, fog and snow: pictures, numbers and a page with a slider."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from tqdm import tqdm

from torchweather import __version__
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.depth import ScenePrior
from torchweather.camera.depth.scene_depth import GUESSED, SceneDepth
from torchweather.camera.depth.source import DepthSource
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import normalise, quantise
from torchweather.camera.transform import BayerWeather
from torchweather.core.errors import InputValueError
from torchweather.io import atomic_folder, write_image
from torchweather.report.before_after import (
    LONGEST_PX,
    Comparison,
    Panel,
    comparisons_page,
    panel_caption,
    reduced,
    size_within,
)
from torchweather.report.machine import library_warnings
from torchweather.report.page import write_json, write_report

__all__ = ["SEVERITIES", "Photo", "write_photo_demo"]

# Light to heavy: rates that weather services call moderate to violent; fog from where it is called fog (1000 m).
SEVERITIES: tuple[tuple[str, str, Weather], ...] = (
    *((f"fog-{mor_m}", f"Fog {mor_m} m", Fog(mor_m=float(mor_m))) for mor_m in (1000, 200, 50)),
    *((f"rain-{rate}", f"Rain {rate} mm/h", Rain(float(rate))) for rate in (5, 25, 50)),
    *((f"snow-{rate:g}", f"Snow {rate:g} mm/h", Snow(rate_mm_per_h=rate)) for rate in (0.5, 1.0, 3.0)),
)
MOST_PHOTOS = 12  # ten pictures each: a page of 100 MB, and 700 MB of memory
GUESSED_ALERT = (
    "Depth guessed: no depth was given, so distances are a model of the scene and not a measurement. The pictures show "
    "the kind of weather; do not take numbers from them. Give --depth with a map for pictures that hold."
)


@dataclass(frozen=True)
class Photo:
    """A photograph with what is known of it.

    Args:
        path: the file.
        rgb: ``(3, H, W)`` sRGB, uint8, uint16 or float 0..1.
        camera: of the size of the photograph.
        depth: of the photograph in its own size; ``None`` guesses it.
        notes: sentences about what was guessed.
    """

    path: Path
    rgb: Tensor
    camera: Camera
    depth: DepthSource | None = None
    notes: Sequence[str] = ()


def write_photo_demo(
    out_dir: Path,
    photos: Sequence[Photo],
    *,
    seed: int = 0,
    airlight: Sequence[float] | None = None,
    severities: Sequence[tuple[str, str, Weather]] = SEVERITIES,
    progress: bool = True,
) -> dict[str, Any]:
    """Put photographs in weathers, and write a page with a slider between clear and each weather.

    Args:
        out_dir: gets ``index.html`` (self-contained), ``summary.json`` and the pictures in ``frames/``. What it held
            before stays, unless it has the same name. Nothing is written when anything fails.
        photos: the photographs; larger ones are reduced to 1600 pixels, and the page says so.
        seed: of the weather.
        airlight: linear signal of the sky, red, green, blue; ``None`` takes it from each photograph.
        severities: name of the files, title of the tab, weather.
        progress: show a progress bar.

    Returns:
        What ``summary.json`` holds.
    """
    if not photos:
        raise InputValueError("write_photo_demo: photos must hold one photograph or more; got none.")
    if len(photos) > MOST_PHOTOS:
        raise InputValueError(
            f"write_photo_demo: photos must hold {MOST_PHOTOS} photographs at most, since a page holds them all; got "
            f"{len(photos)}. Show fewer; torchweather apply takes whole folders."
        )
    subjects, comparisons = [], []
    total = len(photos) * len(severities)
    with (
        atomic_folder(Path(out_dir)) as staging,
        tqdm(total=total, desc="weather", unit="picture", disable=not progress) as bar,
    ):
        (staging / "frames").mkdir()
        for number, photo in enumerate(photos):
            clear, camera, scene = _prepared(photo)
            name = f"frame-{number}"
            write_image(staging / "frames" / f"{name}_clear.png", clear)
            panels: list[Panel] = []
            records, said = [], []
            for file, title, weather in severities:
                started = time.perf_counter()
                rgb, used, warned = _weathered(clear, camera, scene, weather, seed, airlight)
                said += warned
                write_image(staging / "frames" / f"{name}_{file}.png", rgb)
                light_from = _airlight_from(airlight, scene)
                caption = panel_caption(
                    weather, seed=seed, confidence=scene.confidence, airlight=used, airlight_from=light_from
                )
                panels.append((title, caption, rgb))
                records.append(
                    {
                        "name": file,
                        "weather": weather.to_dict(),
                        "file": f"frames/{name}_{file}.png",
                        "airlight": used,
                        "airlight_from": light_from,
                        "seconds": round(time.perf_counter() - started, 3),
                    }
                )
                bar.update()
            notes = [*photo.notes, *_size_notes(photo, clear), *scene.notes, *dict.fromkeys(said)]
            alert = GUESSED_ALERT if scene.confidence == GUESSED else ""
            comparisons.append(Comparison(photo.path.name, clear, panels, notes, alert))
            subjects.append(
                {
                    "name": name,
                    "title": photo.path.name,
                    "camera": camera.to_dict(),
                    "depth": scene.confidence,
                    "notes": notes,
                    "clear_file": f"frames/{name}_clear.png",
                    "weathers": records,
                }
            )
        summary = {"torchweather": __version__, "seed": seed, "subjects": subjects}
        found = write_json(staging / "summary.json", summary)
        write_report(comparisons_page(comparisons), staging / "index.html")
    return found


def _depth_of_photo(camera: Camera, image: Tensor) -> SceneDepth:
    """Depth of a photograph of which nothing is known; the one place that chooses the guess."""
    height, width = image.shape[-2:]
    return ScenePrior().scene(camera, height, width, image=image)


def _prepared(photo: Photo) -> tuple[Tensor, Camera, SceneDepth]:
    """The photograph in 8 bits and in the page's size, with its camera and depth."""
    if photo.rgb.ndim != 3 or photo.rgb.shape[0] != 3:
        raise InputValueError(f"{photo.path}: expected one RGB photograph (3, H, W); got {tuple(photo.rgb.shape)}.")
    whole = photo.rgb if photo.rgb.dtype == torch.uint8 else quantise(normalise(photo.rgb), torch.uint8)
    height, width = whole.shape[-2:]
    small = size_within(height, width, LONGEST_PX)
    clear, camera = reduced(whole), photo.camera
    if small != (height, width):
        camera = camera.resized(small[1], small[0])
    if photo.depth is None:
        return clear, camera, _depth_of_photo(camera, clear)
    # A map has the size of the photograph: it is read in full, then reduced without mixing depths.
    return clear, camera, _resized(photo.depth.scene(photo.camera, height, width, image=whole), *small)


def _resized(scene: SceneDepth, height: int, width: int) -> SceneDepth:
    """A scene in another size: depth by its nearest pixel, since a mean of two depths is neither; shares by means."""
    scale = height / scene.depth_m.shape[-2]
    if tuple(scene.depth_m.shape[-2:]) == (height, width):
        return SceneDepth(**{**vars(scene), "depth_m": scene.depth_m.reshape(1, height, width)})
    depth_m = F.interpolate(scene.depth_m.reshape(1, 1, *scene.depth_m.shape[-2:]), (height, width), mode="nearest")[0]
    shares = {
        name: F.interpolate(share.reshape(1, 1, *share.shape[-2:]), (height, width), mode="area")[0]
        for name in ("sky", "near_mask", "ground")
        if (share := getattr(scene, name)) is not None
    }
    horizon_row = None if scene.horizon_row is None else scene.horizon_row * scale
    return SceneDepth(**{**vars(scene), "depth_m": depth_m, "horizon_row": horizon_row, **shares})


def _weathered(
    clear: Tensor, camera: Camera, scene: SceneDepth, weather: Weather, seed: int, airlight: Sequence[float] | None
) -> tuple[Tensor, list[float], list[str]]:
    """The picture in a weather, the airlight that was used, and what the library warned of."""
    with library_warnings() as said, torch.no_grad():
        taker = AsBayer(BayerWeather(weather, camera, airlight=airlight))
        result = taker.run(clear, scene, taker.draw(clear, seed=seed))
    used = [round(float(value), 4) for value in result.airlight.reshape(-1)[:3]]
    return result.rgb, used, said


def _airlight_from(airlight: Sequence[float] | None, scene: SceneDepth) -> str:
    """Origin of the airlight in words."""
    if airlight is not None:
        return "given"
    if not bool((scene.sky_share > 0.5).any()):
        return "guessed: no sky in view"
    return "the grey of the sky above the horizon" + (", guessed" if scene.confidence == GUESSED else "")


def _size_notes(photo: Photo, clear: Tensor) -> list[str]:
    before, after = photo.rgb.shape[-2:], clear.shape[-2:]
    if before == after:
        return []
    return [
        f"The photograph of {before[1]} × {before[0]} px was reduced to {after[1]} × {after[0]} px before the weather."
    ]
