"""An embedded scene at night: the surfaces of a day's view in the light of lamps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchweather.camera.bayer import mosaic
from torchweather.camera.night.found_lamps import lamp_in_view
from torchweather.camera.night.lamps import Lamp, Night, beam_share
from torchweather.scenes.scene import Scene, SceneView

__all__ = ["night_view"]

SKY_CD_PER_M2 = 0.01  # of a suburb's night sky, order of magnitude
GRAZING = 0.05  # least cosine of incidence: headlamps light a rough road even at grazing incidence
WHITE_FROM = 0.3  # least of a lamp's colours with which all of them saturate
RING = 0.5  # of saturation, in the ring of a lamp's pixels, where a lens spreads its light


def night_view(scene: Scene, view: SceneView, night: Night) -> SceneView:
    """View of a scene by a camera at night in clear air, from its view by day.

    Each surface keeps its reflectance, the share of the day's light that it shows, and is lit by the own headlamps, by
    the lamps given, and by a faint sky. Lamps cast no shadows. A lamp in the picture saturates its pixels.

    Args:
        scene: whose light the day's view was taken in.
        view: by day, of ``scene.view(camera)``.
        night: lamps, ``Night(lamps=[...])``, and the exposure.

    Example:
        >>> from torchweather.scenes import test_track
        >>> from torchweather.sensors import Camera
        >>> day = test_track().view(Camera.preset("lucid-triton").resized(32, 24))
        >>> night = night_view(test_track(), day, Night(lamps=()))
        >>> bool(night.rgb.mean() < 0.2 * day.rgb.mean())
        True
    """
    sky_light, ground_light = scene.light.irradiance(view.normal.movedim(0, -1))
    by_day = (sky_light + ground_light).movedim(-1, 0).clamp_min(1e-6) / math.pi
    reflectance = torch.where(torch.isfinite(view.depth_m), view.rgb / by_day, 0.0)
    light = torch.zeros_like(view.rgb)
    place = _places(view)
    for lamp in (*night.own_lamps, *night.given_lamps):
        light = light + torch.tensor(lamp.colour)[:, None, None] * _lux(lamp, place, view.normal)
    level = (light / math.pi + SKY_CD_PER_M2) * reflectance
    level = torch.where(torch.isfinite(view.depth_m), level, torch.full_like(level, SKY_CD_PER_M2))
    rgb = (level / night.saturation_cd_per_m2).clamp(0.0, 1.0)
    _draw_lamps(rgb, night.given_lamps, view, night)
    return replace(view, rgb=rgb, bayer=mosaic(rgb, view.camera.bayer_pattern))


def _places(view: SceneView) -> Tensor:
    """Forward, left, up of every pixel's surface, ``(3, H, W)``."""
    rotation = torch.tensor(view.camera.camera_from_vehicle())
    direction = view.camera.ray_directions()
    along = direction / direction[2:]
    depth_m = torch.where(torch.isfinite(view.depth_m), view.depth_m, 1e4)
    place = torch.einsum("ji,jhw->ihw", rotation, along) * depth_m
    return place + torch.tensor([0.0, 0.0, view.camera.height_m])[:, None, None]


def _lux(lamp: Lamp, place: Tensor, normal: Tensor) -> Tensor:
    """Illuminance of every pixel's surface, ``(1, H, W)``."""
    offset = place - torch.tensor(lamp.position_m)[:, None, None]
    square = offset.square().sum(0, keepdim=True).clamp_min(0.01)
    azimuth = torch.atan2(offset[1:2], offset[:1]) - lamp.heading_rad
    azimuth = torch.atan2(torch.sin(azimuth), torch.cos(azimuth))
    elevation = torch.atan2(offset[2:], torch.hypot(offset[:1], offset[1:2])) - lamp.tilt_rad
    cosine = -(offset * normal).sum(0, keepdim=True) / square.sqrt()
    return lamp.intensity_cd * beam_share(lamp.beam, azimuth, elevation) / square * cosine.clamp_min(GRAZING)


def _draw_lamps(rgb: Tensor, lamps: Sequence[Lamp], view: SceneView, night: Night) -> None:
    """Lamps in the picture that nothing hides, in place."""
    size = (rgb.shape[-2], rgb.shape[-1])
    for lamp in lamps:
        seen = lamp_in_view(lamp, size, view.camera, night)
        if seen is None or float(view.depth_m[0, seen.rows, seen.columns].max()) < seen.depth_m - 0.5:
            continue
        tint = torch.tensor(lamp.colour) / max(lamp.colour)
        ring, core = RING * tint, torch.where(torch.tensor(min(lamp.colour) > WHITE_FROM), torch.ones(3), tint)
        for reach, light in ((1, ring), (0, core)):
            for down in range(-reach, reach + 1):
                for aside in range(-reach, reach + 1):
                    rows = torch.from_numpy(seen.rows + down).clamp(0, size[0] - 1)
                    columns = torch.from_numpy(seen.columns + aside).clamp(0, size[1] - 1)
                    rgb[:, rows, columns] = torch.maximum(rgb[:, rows, columns], light[:, None])
