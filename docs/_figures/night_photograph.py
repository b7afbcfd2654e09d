"""Draw a photograph taken by day as if by night: in clear air, fog, rain, on a wet road and in snow.

    python docs/_figures/night_photograph.py --out docs/images/night_photograph.jpg

No photograph of a night is at hand whose licence allows to ship it. So the day's light is divided out of the one of
the README, and lamps light what is left. Beside the photograph lies a .json of its name with what the picture does not
tell (readme_street.py). Depth, lamps and reflectances are guessed.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from readme_street import GAP, PHOTOGRAPH, as_picture, labelled, street
from torch import Tensor

import torchweather as tw
from torchweather.camera.depth import SceneDepth
from torchweather.camera.surfaces import surface_normals
from torchweather.camera.tone import srgb_decode, srgb_encode
from torchweather.io import atomic_write
from torchweather.scenes.night_view import lit_by_lamps

SEED, COLUMNS, WIDTH = 3, 2, 796
FINER = 2  # what is drawn, then reduced: outlines of cars are sharp
EXPOSURE_S, SATURATION_CD_PER_M2 = 1 / 30, 7.3  # at f/1.8 and ISO 1600: the example of Night(saturation_cd_per_m2)
ASPHALT, WHITEST = 0.1, 0.6  # reflectance of the road, and what brighter things come near to
DARKEST = 0.02  # share of the pixels
GREY_BELOW = 0.03  # reflectance; the colour of darker things is noise
SKY_EDGE_PX = 5  # a pixel this near to the sky may hold some of its light
SCENES: dict[str, tw.Mixture | None] = {
    "clear": None,
    "Fog(60)": tw.Mixture(tw.Fog(60.0)),
    "Rain(25)": tw.Mixture(tw.Rain(25.0)),
    "Rain(25), WetRoad(puddles=0.5)": tw.Mixture(tw.Rain(25.0), tw.WetRoad(puddles=0.5)),
    "Snow(2)": tw.Mixture(tw.Snow(2.0)),
}


def reflectance_of(image: Tensor, scene: SceneDepth) -> Tensor:
    """Reflectance of what a day's photograph ``(3, H, W)`` shows.

    The darkest pixels show the glare of the lens, which is subtracted. One light for the whole picture, in which the
    road reflects ``ASPHALT`` in each colour. What the sun lights beside
    a road in the shade would reflect more than all: a shoulder takes it to ``WHITEST``. Along the sky the darkest of
    the neighbours stands in, because the sky shines through.
    """
    light = srgb_decode(image.float() / 255.0)
    light = (light - light.flatten(1).quantile(DARKEST, 1)[:, None, None]).clamp_min(0.0)
    assert scene.ground is not None
    road = scene.ground[0] > 0.9
    share = light / light[:, road].median(1).values[:, None, None] * ASPHALT
    share = torch.lerp(share.mean(0), share, (share.mean(0) / GREY_BELOW).clamp_max(1.0))
    reflectance = WHITEST * (1.0 - torch.exp(-share / WHITEST))
    darkest = -torch.nn.functional.max_pool2d(-reflectance, SKY_EDGE_PX, 1, SKY_EDGE_PX // 2)
    edge = torch.nn.functional.max_pool2d(scene.sky_share, SKY_EDGE_PX, 1, SKY_EDGE_PX // 2) > 0.02
    return torch.where(edge, darkest, reflectance)


def outlined_street(
    photograph: Path, settings: Mapping[str, Any], box: Sequence[int], width: int
) -> tuple[Tensor, tw.Camera, SceneDepth]:
    """A part of the photograph as of ``street``, with the cars that have an outline in place of their boxes.

    Headlamps light a car, and not the road beside it: the soft edges of boxes would show. A car's depth is that of the
    ground at its lowest point.
    """
    outlines = [np.array(points, dtype=float) for points in settings["outlines"]]
    boxes = [one for one in settings["objects"] if not any(_covered(one, points) for points in outlines)]
    image, camera, scene = street(photograph, {**settings, "objects": boxes}, box, width)
    left, top, right, _ = box
    scale = width / (right - left)
    depth_m, ground = scene.depth_m.clone(), scene.ground.clone()
    for points in sorted(outlines, key=lambda one: one[:, 1].max()):  # nearer cars hide others
        drawn = Image.new("L", (depth_m.shape[-1], depth_m.shape[-2]))
        ImageDraw.Draw(drawn).polygon([tuple(point) for point in (points - (left, top)) * scale], fill=1)
        inside = torch.from_numpy(np.asarray(drawn).astype(bool))
        rows_below = (points[:, 1].max() - settings["horizon_row"]) * scale
        depth_m[:, inside] = camera.height_m * camera.fy / rows_below
        ground[:, inside] = 0.0
    return image, camera, replace(scene, depth_m=depth_m, ground=ground)


def _covered(box: Sequence[float], points: NDArray[np.float64]) -> bool:
    """Whether the middle of a box lies within the bounds of an outline."""
    middle = np.array([box[0] + box[2], box[1] + box[3]]) / 2.0
    return bool((points.min(0) <= middle).all() and (middle <= points.max(0)).all())


def lamps_of(
    listed: Sequence[Mapping[str, Any]], box: Sequence[int], camera: tw.Camera, scene: SceneDepth
) -> list[tw.Lamp]:
    """Lamps at pixels of the photograph, in front of what the guess shows there, and lamps at places."""
    left, top, right, _ = box
    scale = camera.width / (right - left)
    cx, cy = camera.principal_point_px
    lamps = []
    for values in listed:
        more = {key: value for key, value in values.items() if key != "pixel"}
        if "pixel" in values:
            column, row = (
                (values["pixel"][0] + 0.5 - left) * scale - 0.5,
                (values["pixel"][1] + 0.5 - top) * scale - 0.5,
            )
            depth_m = min(more.pop("depth_m", 1e3), float(scene.depth_m[0, round(row), round(column)]))
            aside, up = -(column - cx) / camera.fx * depth_m, camera.height_m - (row - cy) / camera.fy * depth_m
            more["position_m"] = (depth_m, aside, up)
        lamps.append(tw.Lamp.of(more))
    return lamps


def relit(image: Tensor, scene: SceneDepth, camera: tw.Camera, night: tw.Night) -> Tensor:
    """The photograph by night in clear air, sRGB ``(3, H, W)``, uint8."""
    transform = tw.BayerWeather(tw.Rain(0.0), camera)
    normal = surface_normals(transform.planes_state(image[None].float(), transform.scene_of(image, scene), (1,)))[0]
    lit = lit_by_lamps(reflectance_of(image, scene), scene.depth_m, normal, scene.sky_share, camera, night)
    return (255.0 * srgb_encode(lit)).round().to(torch.uint8)


def night_street(width: int, photograph: Path = PHOTOGRAPH) -> tuple[Tensor, Tensor, tw.Camera, SceneDepth, tw.Night]:
    """The street by day and relit, ``(3, H, W)`` uint8, its camera at a night's exposure, its guess, and its lamps."""
    settings = json.loads(photograph.with_suffix(".json").read_text(encoding="utf-8"))
    day, camera, scene = outlined_street(photograph, settings, settings["panel"], width)
    camera = replace(camera, exposure_s=EXPOSURE_S)
    lamps = lamps_of(settings["lamps"], settings["panel"], camera, scene)
    night = tw.Night(lamps=tuple(lamps), saturation_cd_per_m2=SATURATION_CD_PER_M2)
    return day, relit(day, scene, camera, night), camera, scene, night


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photograph", type=Path, default=PHOTOGRAPH, help="with a .json of its name beside it")
    parser.add_argument("--out", type=Path, default=Path("night_photograph.jpg"))
    arguments = parser.parse_args()
    day, clear, camera, scene, night = night_street(FINER * WIDTH, arguments.photograph)
    panels = {"day photograph": day}
    for title, weather in SCENES.items():
        seen = clear
        if weather is not None:
            transform = tw.AsBayer(tw.BayerWeather(weather, camera, night=night, scattering="multiple"))
            seen = transform(clear, scene, transform.draw(clear, seed=SEED))
        panels[f"relit day photograph: {title}"] = seen
    rows, columns = (size // FINER for size in day.shape[-2:])
    lines = math.ceil(len(panels) / COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * columns + GAP, lines * (rows + GAP) - GAP), "white")
    for number, (title, panel) in enumerate(panels.items()):
        place = (number % COLUMNS * (columns + GAP), number // COLUMNS * (rows + GAP))
        reduced = as_picture(panel).resize((columns, rows), Image.Resampling.LANCZOS)
        sheet.paste(labelled(reduced, title), place)
    with atomic_write(arguments.out) as unfinished:
        sheet.save(unfinished, format="JPEG", quality=85, optimize=True)
    print(arguments.out)


if __name__ == "__main__":
    main()
