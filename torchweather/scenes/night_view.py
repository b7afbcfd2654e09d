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
from torchweather.camera.sensor import Camera
from torchweather.scenes.scene import Scene, SceneView

__all__ = ["lit_by_lamps", "night_view"]

SKY_CD_PER_M2 = 0.01  # of a suburb's night sky, order of magnitude
GRAZING = 0.05  # least cosine of incidence: headlamps light a rough road even at grazing incidence
WHITE_FROM = 0.3  # least of a lamp's colours with which all of them saturate
RING = 0.5  # of saturation, in the ring of a lamp's pixels, where a lens spreads its light


def night_view(scene: Scene, view: SceneView, night: Night) -> SceneView:
    """View of a scene by a camera at night in clear air, from its view by day.

    Each surface keeps its reflectance, the share of the day's light that it shows, and is lit by the own headlamps, by
    the lamps given, and by a faint sky, as by ``lit_by_lamps``.

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
    sky = torch.isinf(view.depth_m)
    rgb = lit_by_lamps(torch.where(sky, 0.0, view.rgb / by_day), view.depth_m, view.normal, sky, view.camera, night)
    return replace(view, rgb=rgb, bayer=mosaic(rgb, view.camera.bayer_pattern))


def lit_by_lamps(
    reflectance: Tensor, depth_m: Tensor, normal: Tensor, sky: Tensor, camera: Camera, night: Night
) -> Tensor:
    """Surfaces in the light of the own headlamps, of the lamps given and of a faint sky, ``(3, H, W)``, saturation 1.

    Lamps cast no shadows. A lamp in the picture that nothing hides shows the light that it sends to the camera, up to
    saturation.

    Args:
        reflectance: ``(3, H, W)`` of the surfaces, 0..1.
        depth_m: along the optical axis, ``(1, H, W)``; ``inf`` is sky.
        normal: unit normals in the vehicle frame, ``(3, H, W)``.
        sky: share of each pixel that shows the sky, ``(1, H, W)``.
        camera: that looks.
        night: lamps, ``Night(lamps=[...])``, and the exposure.
    """
    light = torch.zeros_like(reflectance)
    place = _places(depth_m, camera)
    for lamp in (*night.own_lamps, *night.given_lamps):
        light = light + torch.tensor(lamp.colour)[:, None, None] * _lux(lamp, place, normal)
    level = (light / math.pi + SKY_CD_PER_M2) * reflectance
    level = torch.lerp(level, torch.full_like(level, SKY_CD_PER_M2), sky.to(level))
    rgb = (level / night.saturation_cd_per_m2).clamp(0.0, 1.0)
    _draw_lamps(rgb, night.given_lamps, depth_m, camera, night)
    return rgb


def _places(depth_m: Tensor, camera: Camera) -> Tensor:
    """Forward, left, up of every pixel's surface, ``(3, H, W)``."""
    rotation = torch.tensor(camera.camera_from_vehicle())
    direction = camera.ray_directions()
    along = direction / direction[2:]
    depth_m = torch.where(torch.isfinite(depth_m), depth_m, 1e4)
    place = torch.einsum("ji,jhw->ihw", rotation, along) * depth_m
    return place + torch.tensor([0.0, 0.0, camera.height_m])[:, None, None]


def _lux(lamp: Lamp, place: Tensor, normal: Tensor) -> Tensor:
    """Illuminance of every pixel's surface, ``(1, H, W)``."""
    offset = place - torch.tensor(lamp.position_m)[:, None, None]
    square = offset.square().sum(0, keepdim=True).clamp_min(0.01)
    azimuth = torch.atan2(offset[1:2], offset[:1]) - lamp.heading_rad
    azimuth = torch.atan2(torch.sin(azimuth), torch.cos(azimuth))
    elevation = torch.atan2(offset[2:], torch.hypot(offset[:1], offset[1:2])) - lamp.tilt_rad
    cosine = -(offset * normal).sum(0, keepdim=True) / square.sqrt()
    return lamp.intensity_cd * beam_share(lamp.beam, azimuth, elevation) / square * cosine.clamp_min(GRAZING)


def _draw_lamps(rgb: Tensor, lamps: Sequence[Lamp], depth_m: Tensor, camera: Camera, night: Night) -> None:
    """Lamps in the picture that nothing hides, in place."""
    size = (rgb.shape[-2], rgb.shape[-1])
    for lamp in lamps:
        seen = lamp_in_view(lamp, size, camera, night)
        if seen is None or float(depth_m[0, seen.rows, seen.columns].max()) < seen.depth_m - 0.5:
            continue
        if max(lamp.colour) == 0.0:
            continue
        tint = torch.tensor(lamp.colour) / max(lamp.colour)
        ring, core = RING * tint, torch.where(torch.tensor(min(lamp.colour) > WHITE_FROM), torch.ones(3), tint)
        ring, core = (torch.minimum(one, torch.tensor(seen.signal)) for one in (ring, core))
        for reach, light in ((1, ring), (0, core)):
            for down in range(-reach, reach + 1):
                for aside in range(-reach, reach + 1):
                    rows = torch.from_numpy(seen.rows + down).clamp(0, size[0] - 1)
                    columns = torch.from_numpy(seen.columns + aside).clamp(0, size[1] - 1)
                    rgb[:, rows, columns] = torch.maximum(rgb[:, rows, columns], light[:, None])
