"""Light of lamps in the air in front of a camera: on fog, drops and flakes, at every depth of a coarse grid of rays.

A place at distance d from a lamp gets ``E = I(direction) / d^2 exp(-alpha d)``. The fog there adds ``E p(theta) alpha``
per metre to the radiance of the ray, a drop or flake shows ``E f(theta)``; both arrive with ``exp(-alpha R)``.
Straight back this is the LiDAR's ``E(R) beta(180) / R^2``.

Light that the fog scatters by less than a radian is not lost: on its way from a lamp it widens the beam, on its way to
the camera it blurs the veil, both by the kernel of ``torchweather.atmosphere.forward_scattering``. Against photons
traced one by one (``tests/camera/night``) the veil of a low beam is within 10 % in fog of 20 and 50 m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torchweather.atmosphere.forward_scattering import WIDTHS_RAD, ForwardScattering
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.camera.night.lamps import Lamp, beam_share
from torchweather.camera.sensor import Camera
from torchweather.physics.phase_function import mie_phase_function_per_sr
from torchweather.physics.sphere_scattering import drop_scattering_per_sr, flake_scattering_per_sr

__all__ = ["FogOptics", "LampLight", "fog_optics", "lamp_light"]

COLUMNS, DEPTHS = 64, 64  # of the grid
SUBSTEPS = 2  # of the integral along a ray, from node to node
NEAREST_M = 0.3
MOST_BRIGHTENED = 2.0  # of a surface outside of a beam, by light that the fog scatters there
LEAST_DISTANCE_M = 0.5  # from a lamp: its own size, and no ray passes through a headlamp
ANGLES = 721
SPREAD_RAD = 0.3  # of the directions of light that was scattered onward once or twice
# Table of a beam: azimuth over the whole turn, elevation, and the optical depth of the way.
BEAM_AZIMUTHS, BEAM_ELEVATIONS = 361, 181
BEAM_DEPTHS = (0.0, 0.15, 0.35, 0.7, 1.2, 2.0, 3.2, 5.0, 8.0, 14.0)


@dataclass(frozen=True)
class FogOptics:
    """Scattering of a fog.

    Args:
        extinction_per_m: of its droplets, green.
        forward: transfer of the light scattered onward; ``None`` takes all scattered light for lost.
        per_sr: ``(ANGLES,)`` phase function from onward to back.
        smooth_per_sr: the same for light whose direction is spread over some ``SPREAD_RAD``, without the glory.
    """

    extinction_per_m: float
    forward: ForwardScattering | None
    per_sr: Tensor
    smooth_per_sr: Tensor


def fog_optics(fog: Fog, mor_m: float, extinction_per_m: float, wavelength_nm: float) -> FogOptics:
    """Scattering of a fog of a visibility, by Mie theory."""
    return FogOptics(extinction_per_m, *_scattering(fog, float(f"{mor_m:.2g}"), wavelength_nm))


@lru_cache(maxsize=32)
def _scattering(fog: Fog, mor_m: float, wavelength_nm: float) -> tuple[ForwardScattering, Tensor, Tensor]:
    distribution = fog.distribution(mor_m)
    angle = torch.linspace(0.0, math.pi, ANGLES, dtype=torch.float64)
    per_sr = mie_phase_function_per_sr(distribution, wavelength_nm, angle, temperature_c=fog.temperature_c)
    spread = torch.exp(-0.5 * ((angle[:, None] - angle) / SPREAD_RAD).square()) * torch.sin(angle)
    smooth = (spread @ per_sr) / spread.sum(1)
    return ForwardScattering.of_fog(distribution, wavelength_nm, fog.temperature_c), per_sr.float(), smooth.float()


@dataclass(frozen=True)
class LampLight:
    """Light of lamps at the nodes of a grid: depths ``NEAREST_M`` to ``far_m``, evenly in their logarithm.

    Args:
        fog: ``(B, 3, K, h, w)`` light that the fog in front of each node sends to the camera, units of saturation.
        drop: ``(B, 1, K, h, w)`` luminance that a drop there shows; of all colours together.
        flake: likewise of a flake.
        on_surface: ``(B, 1, K, h, w)`` illuminance by the own headlamps in clear air, lux.
        own_fade: ``(B, 1, K, h, w)`` share of it that the fog lets through.
        colour: ``(B, 3)`` of the light on particles, of mean 1.
        far_m: depth of the last node.
    """

    fog: Tensor
    drop: Tensor
    flake: Tensor
    on_surface: Tensor
    own_fade: Tensor
    colour: Tensor
    far_m: float

    def seen(self, values: Tensor, depth_m: Tensor) -> Tensor:
        """Values ``(B, C, K, h, w)`` at each pixel's depth ``(B, 1, H, W)``; ``(B, C, H, W)``."""
        height, width = depth_m.shape[-2:]
        batch = max(len(values), len(depth_m))  # of each, or one for all
        across = torch.linspace(-1.0, 1.0, width, device=depth_m.device).to(depth_m)
        down = torch.linspace(-1.0, 1.0, height, device=depth_m.device).to(depth_m)
        place = self.place(depth_m)[:, 0] * (2.0 / (DEPTHS - 1)) - 1.0
        grid = torch.stack([one.expand(batch, height, width) for one in (across, down[:, None], place)], -1)
        volume = values.to(depth_m).expand(batch, *values.shape[1:])
        sampled: Tensor = torch.nn.functional.grid_sample(
            volume, grid[:, None], mode="bilinear", padding_mode="border", align_corners=True
        )
        return sampled[:, :, 0]

    def place(self, depth_m: Tensor) -> Tensor:
        """Place of a depth among the nodes, 0 to ``DEPTHS - 1``."""
        span = math.log(self.far_m / NEAREST_M)
        return (torch.log(depth_m.clamp(NEAREST_M, self.far_m) / NEAREST_M) * ((DEPTHS - 1) / span)).clamp(
            0.0, DEPTHS - 1.0
        )

    def at_points(
        self,
        values: Tensor,
        sample: Tensor | int | None,
        u_px: Tensor,
        v_px: Tensor,
        depth_m: Tensor,
        size: tuple[int, int],
    ) -> Tensor:
        """Values ``(B, 1, K, h, w)`` at points ``(P,)`` of the picture, linear between nodes."""
        rows, columns = values.shape[-2:]
        row, row_share = _cell(v_px * ((rows - 1) / max(size[0] - 1, 1)), rows)
        column, column_share = _cell(u_px * ((columns - 1) / max(size[1] - 1, 1)), columns)
        node, node_share = _cell(self.place(depth_m), DEPTHS)
        flat = values.to(u_px).reshape(-1)
        start = node * (rows * columns) + row * columns + column
        if sample is not None and len(values) > 1:
            start = start + sample * (DEPTHS * rows * columns)
        found = torch.zeros_like(u_px)
        for k, j, i in np.ndindex(2, 2, 2):
            weight = (
                (node_share if k else 1 - node_share)
                * (row_share if j else 1 - row_share)
                * (column_share if i else 1 - column_share)
            )
            found = found + weight * flat.index_select(0, start + k * rows * columns + j * columns + i)
        return found


def _cell(place: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    place = place.clamp(0.0, nodes - 1.0)
    cell = place.floor().clamp_max(nodes - 2.0)
    return cell.long(), place - cell


def lamp_light(
    camera: Camera,
    scene_depth_m: Tensor,
    far_m: float,
    own: Sequence[Lamp],
    others: Sequence[Lamp],
    in_view: Sequence[Lamp],
    fog: FogOptics | None,
    rain: Rain | None,
    snow: Snow | None,
    saturation_cd_per_m2: float,
) -> LampLight:
    """Light of lamps in front of one frame.

    Args:
        camera: that takes it.
        scene_depth_m: ``(H, W)`` of what the pixels show; behind it there is no fog.
        far_m: depth of the last node.
        own: headlamps of the own car.
        others: lamps outside of the picture.
        in_view: lamps in the picture, whose light on the fog the picture's own blur holds already; they light particles
            alone.
        fog: ``None`` is clear air.
        rain, snow: what falls.
        saturation_cd_per_m2: luminance that saturates the camera.
    """
    size = (scene_depth_m.shape[-2], scene_depth_m.shape[-1])
    rays, depth_m = _grid(camera, size, far_m)  # (h, w, 3) forward, left, up per metre of depth; (K',)
    length = torch.linalg.vector_norm(rays, dim=-1)
    place = depth_m[:, None, None, None] * rays + torch.tensor([0.0, 0.0, camera.height_m])
    ray_m = depth_m[:, None, None] * length
    alpha = 0.0 if fog is None else fog.extinction_per_m
    to_camera = torch.exp(-alpha * ray_m)
    zero = torch.zeros_like(ray_m)
    straight, spread = [zero] * 3, [zero] * 3
    drop, flake, surface, faded = zero, zero, zero, zero
    colour, weight = torch.zeros(3), 0.0
    groups = {"own": own, "other": others, "view": in_view}
    for lamp, group in ((lamp, group) for group, lamps in groups.items() for lamp in lamps):
        clear_lux, lux, direct_lux, angle = _illuminance(lamp, place, rays / length[..., None], fog)
        if fog is not None and group != "view":
            cell, share = _cell(angle * ((ANGLES - 1) / math.pi), ANGLES)
            sharp, smooth = (torch.lerp(p[cell], p[cell + 1], share) for p in (fog.per_sr, fog.smooth_per_sr))
            once = alpha * (direct_lux * sharp + (lux - direct_lux) * smooth)
            straight = [one + tint * once for one, tint in zip(straight, lamp.colour, strict=True)]
            spread = [one + tint * alpha * lux * smooth for one, tint in zip(spread, lamp.colour, strict=True)]
        if rain is not None:
            drop = drop + lux * to_camera * drop_scattering_per_sr(angle).to(angle)
        if snow is not None:
            back = snow.reflectivity_at(550.0)
            flake = flake + lux * to_camera * flake_scattering_per_sr(angle, snow.albedo, back).to(angle)
        if group == "own":
            surface, faded = surface + clear_lux, faded + lux
        colour += lamp.intensity_cd * torch.tensor(lamp.colour)
        weight += lamp.intensity_cd
    scale = 1.0 / saturation_cd_per_m2
    rows, columns = (torch.linspace(0, n - 1, k).round().long() for n, k in zip(size, length.shape, strict=True))
    there = depth_m[:, None, None] < scene_depth_m.cpu()[rows[:, None], columns]
    straight, spread = ([torch.where(there, one, 0.0) for one in colours] for colours in (straight, spread))
    pairs = zip(straight, spread, strict=True)
    veil = torch.stack([_at_camera(*pair, ray_m, depth_m, rays, fog)[::SUBSTEPS] for pair in pairs])
    drop, flake, surface, faded = (one[::SUBSTEPS] for one in (drop, flake, surface, faded))
    tint = colour / weight if weight > 0 else torch.ones(3)
    ratio = torch.where(surface > 0, faded / surface.clamp_min(1e-12), 1.0).clamp_max(MOST_BRIGHTENED)
    return LampLight(
        fog=(veil * scale)[None],
        drop=(drop * scale)[None, None],
        flake=(flake * scale)[None, None],
        on_surface=surface[None, None],
        own_fade=ratio[None, None],
        colour=tint[None],
        far_m=far_m,
    )


def _grid(camera: Camera, size: tuple[int, int], far_m: float) -> tuple[Tensor, Tensor]:
    """Rays ``(h, w, 3)`` in the vehicle's frame per metre of depth, and depths, the nodes' and those between them."""
    height, width = size
    rows = max(2, round(COLUMNS * height / width))
    u = torch.linspace(0.0, width - 1.0, COLUMNS)
    v = torch.linspace(0.0, height - 1.0, rows)[:, None]
    cx, cy = camera.principal_point_px
    x, y = ((u - cx) / camera.fx).expand(rows, COLUMNS), ((v - cy) / camera.fy).expand(rows, COLUMNS)
    x, y = camera.undistort(x, y)
    rotation = torch.tensor(camera.camera_from_vehicle())
    rays = torch.stack([x, y, torch.ones_like(x)], -1) @ rotation  # the rows' transpose turns back
    depth_m = torch.exp(torch.linspace(math.log(NEAREST_M), math.log(far_m), (DEPTHS - 1) * SUBSTEPS + 1))
    return rays, depth_m


def _illuminance(
    lamp: Lamp, place: Tensor, direction: Tensor, fog: FogOptics | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Lux at places ``(K, h, w, 3)`` in clear air, in fog, and in fog straight from the lamp, and the angle of
    scattering towards the camera."""
    offset = place - torch.tensor(lamp.position_m)
    distance_m = torch.linalg.vector_norm(offset, dim=-1).clamp_min(LEAST_DISTANCE_M)
    forward, left, up = offset.unbind(-1)
    azimuth = torch.atan2(left, forward) - lamp.heading_rad
    azimuth = torch.atan2(torch.sin(azimuth), torch.cos(azimuth))
    elevation = torch.atan2(up, torch.hypot(forward, left)) - lamp.tilt_rad
    at_1_m = lamp.intensity_cd / distance_m.square()
    clear = at_1_m * beam_share(lamp.beam, azimuth, elevation)
    lux = direct = clear
    if fog is not None:
        direct = clear * torch.exp(-fog.extinction_per_m * distance_m)
        lux = at_1_m * _through_fog(lamp.beam, azimuth, elevation, distance_m, fog)
    # The light goes along the offset, and on to the camera against the ray.
    cosine = -(offset * direction).sum(-1) / torch.linalg.vector_norm(offset, dim=-1).clamp_min(1e-6)
    return clear, lux, direct, torch.acos(cosine.clamp(-1.0, 1.0))


def _through_fog(beam: str, azimuth: Tensor, elevation: Tensor, distance_m: Tensor, fog: FogOptics) -> Tensor:
    """Share of a beam's intensity that arrives in a direction behind a way through fog."""
    depth = fog.extinction_per_m * distance_m
    if fog.forward is None:
        return beam_share(beam, azimuth, elevation) * torch.exp(-depth)
    table = _beam_in_fog(beam, fog.forward)
    node = torch.tensor(BEAM_DEPTHS)
    cell = (torch.bucketize(depth, node, right=True) - 1).clamp(0, len(node) - 2)
    level = cell + ((depth - node[cell]) / (node[cell + 1] - node[cell])).clamp_max(1.0)
    grid = torch.stack(
        [
            azimuth / math.pi,
            elevation.clamp(-math.pi / 2, math.pi / 2) * (2.0 / math.pi),
            level * (2.0 / (len(node) - 1)) - 1.0,
        ],
        -1,
    )
    found = torch.nn.functional.grid_sample(
        table[None, None], grid[None], mode="bilinear", padding_mode="border", align_corners=True
    )
    return found[0, 0]


@lru_cache(maxsize=16)
def _beam_in_fog(beam: str, forward: ForwardScattering) -> Tensor:
    """A beam's pattern behind each of ``BEAM_DEPTHS``: straight, and widened by light scattered onward."""
    azimuth = torch.linspace(-math.pi, math.pi, BEAM_AZIMUTHS)
    elevation = torch.linspace(-math.pi / 2, math.pi / 2, BEAM_ELEVATIONS)
    pattern = beam_share(beam, azimuth, elevation[:, None]).expand(BEAM_ELEVATIONS, BEAM_AZIMUTHS)
    step = math.pi / (BEAM_ELEVATIONS - 1)
    wider = torch.stack([_blurred(pattern, width / step) for width in WIDTHS_RAD])
    depth = torch.tensor(BEAM_DEPTHS)
    weight = forward.weights(depth).float()
    return torch.exp(-depth)[:, None, None] * pattern + torch.einsum("dk,kea->dea", weight, wider)


def _blurred(image: Tensor, width: float) -> Tensor:
    """An image ``(..., h, w)`` blurred by a Gaussian of a width in samples; beyond its edges it goes on as it ends."""
    rows, columns = (_weights(size, width) for size in image.shape[-2:])
    return rows @ image @ columns.T


def _weights(size: int, width: float) -> Tensor:
    """Band matrix ``(size, size)`` of a Gaussian, integrated over each sample; what lies outside counts at the edge."""
    edge = torch.arange(size + 1, dtype=torch.float64) - 0.5
    below = 0.5 * (1.0 + torch.erf((edge - torch.arange(size)[:, None]) / (width * math.sqrt(2.0))))
    below[:, 0], below[:, -1] = 0.0, 1.0
    return below.diff(dim=1).float()


def _at_camera(
    straight: Tensor, spread: Tensor, ray_m: Tensor, depth_m: Tensor, rays: Tensor, fog: FogOptics | None
) -> Tensor:
    """Light that arrives from the fog up to each node, ``(K, h, w)``.

    What is scattered onward on its way arrives blurred: each slice by the kernel of its own optical depth.

    Args:
        straight: ``(K, h, w)`` radiance that the fog adds per metre, as far as it arrives straight.
        spread: likewise, as far as it is scattered onward on the way.
        ray_m: ``(K, h, w)`` length of the rays.
        depth_m: ``(K,)`` depth of the nodes.
        rays: ``(h, w, 3)`` per metre of depth.
        fog: its scattering.
    """
    if fog is None or not bool(straight.any()):
        return torch.zeros_like(straight)
    lengths_m = ray_m[1:] - ray_m[:-1]
    middle_m = 0.5 * (ray_m[1:] + ray_m[:-1])
    steps = 0.5 * (straight[1:] + straight[:-1]) * lengths_m
    found = torch.cumsum(steps * torch.exp(-fog.extinction_per_m * middle_m), 0)
    if fog.forward is not None:
        # Radians from one sample of the grid to the next, on the axis.
        step_rad = float((rays[0, 1] - rays[0, 0]).norm())
        axial_m = 0.5 * (depth_m[1:] + depth_m[:-1])
        weight = fog.forward.weights(fog.extinction_per_m * axial_m).float()
        steps = 0.5 * (spread[1:] + spread[:-1]) * lengths_m
        for number, width in enumerate(WIDTHS_RAD):
            found = found + _blurred(torch.cumsum(steps * weight[:, number, None, None], 0), width / step_rad)
    return torch.cat([torch.zeros_like(straight[:1]), found])


def stacked(lights: Sequence[LampLight]) -> LampLight:
    """The light of several frames, one after the other."""
    names = ("fog", "drop", "flake", "on_surface", "own_fade", "colour")
    together = {name: torch.cat([getattr(light, name) for light in lights]) for name in names}
    return LampLight(**together, far_m=lights[0].far_m)
