"""Physical numbers of a frame's weather: expected particles and coverage beside the rendered ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.particles.population import Population
from torchweather.camera.particles.veil import ParticleVeil
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.explain import explain
from torchweather.physics import extinction_per_m

__all__ = ["TARGET_DISTANCES_M", "Path", "falling_numbers", "light_path", "mean_over_bins", "weather_numbers"]

Array = NDArray[np.float64]

TARGET_DISTANCES_M = (28.0, 56.0)  # the cars of the embedded test track, and D3.4's targets
FLOOR = 1e-30  # keeps logarithms finite where nothing is listed
GREEN = 1  # index of the green (or clear) band


@dataclass(frozen=True)
class Path:
    """Extinction of a transform's weather along the path of the light.

    Args:
        fog_per_m: extinction of the fog per band, 1/m; zeros without fog.
        veil_per_m: share of the light that particles cover per metre of way, ``(pi/4) int D^2 N dD``.
        near_m, far_m: where particles begin and end.
    """

    fog_per_m: tuple[float, float, float]
    veil_per_m: float
    near_m: float
    far_m: float

    def veil_depth(self, depth_m: Array, ray_per_depth: Array | float = 1.0) -> Array:
        """Optical depth of the particles nearer than a depth along the axis, seen along rays longer by a factor."""
        return self.veil_per_m * np.clip(depth_m - self.near_m, 0.0, self.far_m - self.near_m) * ray_per_depth

    def optical_depth(self, distance_m: float) -> float:
        """Optical depth of all the weather to a target on the axis, green."""
        return self.fog_per_m[GREEN] * distance_m + float(self.veil_depth(np.array(distance_m)))


def light_path(transform: BayerWeather) -> Path:
    """The extinctions of a transform's weather as the camera sees them.

    Note:
        A camera loses to a drop or flake only the light that falls on its outline (efficiency 1). The equally large
        share that is diffracted around it stays within a blur of the pixel. Fog droplets take both (efficiency 2).
    """
    fog = transform.chain.stages.get("extinction_and_airlight")
    per_band = (0.0, 0.0, 0.0)
    if isinstance(fog, ExtinctionAndAirlight):
        red, green, blue = (float(v) for v in fog.extinction_per_m(1)[0])
        per_band = (red, green, blue)
    parts = populations(transform)
    veil = sum(_outline_per_m(part) for part in parts)
    return Path(per_band, veil, min((p.near_m for p in parts), default=0.0), max((p.far_m for p in parts), default=0.0))


def populations(transform: BayerWeather) -> list[Population]:
    """The kinds of particle that a transform draws; none for fog."""
    veil = transform.chain.stages.get("particle_veil")
    return veil.parts if isinstance(veil, ParticleVeil) else []


def _outline_per_m(part: Population) -> float:
    distribution = part.weather.distribution(float(part.rate_mm_per_h))
    return float(extinction_per_m(distribution, 550.0, q_ext=1.0)) if float(part.rate_mm_per_h) > 0 else 0.0


def falling_numbers(transform: BayerWeather, depth_m: Tensor) -> dict[str, float]:
    """Number of particles between the camera and the scene, and the share of them that is drawn one by one.

    Expected values, from the size distribution and the tables of the renderer; those drawn one by one are the ones
    whose mark peaks above the transform's ``cut`` where they do not crowd.

    Args:
        transform: with rain or snow; the camera's lens distortion is left aside.
        depth_m: ``(1, H, W)``, metres along the axis; infinity is sky.

    Returns:
        ``particles_in_view``, ``particles_drawn_one_by_one``, ``share_drawn_one_by_one`` (of the particles) and
        ``share_of_optical_depth_drawn_one_by_one``, ``mask_mean_expected``.
    """
    depth = depth_m.double().flatten().numpy()
    total = listed = coverage = haze = 0.0
    for part in populations(transform):
        rate = float(part.rate_mm_per_h)
        if rate <= 0:
            continue
        seen = np.clip(depth, part.near_m, part.far_m)
        per_m3 = float(part.weather.distribution(rate).total_per_m3)
        volume = float((seen**3 - part.near_m**3).sum()) / (3 * part.camera.fx * part.camera.fy)
        total += per_m3 * volume
        coverage += _outline_per_m(part) * float((seen - part.near_m).mean())
        listed += float(_listed_per_px(part, seen, rate).sum())
        haze += float(_haze_depth(part, seen).mean())
    path = light_path(transform)
    ray_per_depth = transform.camera.ray_directions(*depth_m.shape[-2:]).norm(dim=0).double().flatten().numpy()
    return {
        "particles_in_view": total,
        "particles_drawn_one_by_one": listed,
        "share_drawn_one_by_one": listed / total if total > 0 else 0.0,
        "share_of_optical_depth_drawn_one_by_one": max(0.0, 1 - haze / coverage) if coverage > 0 else 0.0,
        "mask_mean_expected": float(-np.expm1(-path.veil_depth(depth, ray_per_depth)).mean()),
    }


def _nodes(part: Population) -> tuple[Array, Array]:
    """The table's footprints, ln(m/px), and the depths that belong to them, m."""
    t = part.tables
    log_foot = t.log_footprint_low + t.log_footprint_step * np.arange(t.haze_depth.shape[1])
    return np.asarray(log_foot, np.float64), np.asarray(np.exp(log_foot) * part.focal_px, np.float64)


def _listed_per_px(part: Population, seen_m: Array, rate: float) -> Array:
    """Expected particles drawn one by one in the cone of a pixel down to a depth."""
    t = part.tables
    log_foot, depth = _nodes(part)
    place = (math.log(rate) - t.log_rate_low) / t.log_rate_step
    cell = int(min(max(math.floor(place), 0), len(t.tail_at_cut) - 2))
    low, high = (np.log(np.maximum(t.tail_at_cut[row], FLOOR)) for row in (cell, cell + 1))
    tail = np.exp(low + (place - cell) * (high - low))
    # A pixel's cone has g^2 dZ = f g^3 dln(g) of volume.
    density = tail * part.focal_px * np.exp(3 * log_foot)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(log_foot)
    return np.asarray(np.interp(seen_m, depth, np.concatenate([[0.0], np.cumsum(steps)])))


def _haze_depth(part: Population, seen_m: Array) -> Array:
    """Optical depth, down to a depth, of the particles that are not drawn one by one."""
    _, depth = _nodes(part)
    with torch.no_grad():
        table = part.at_rate(1).haze_depth[0].double().numpy() * part.focal_px
    return np.asarray(np.interp(seen_m, depth, table))


def weather_numbers(
    transform: BayerWeather, depth_m: Tensor, transmission: Tensor, particle_mask: Tensor
) -> dict[str, Any]:
    """The physical numbers of one rendered frame, plain values with units in their names.

    Args:
        transform: that rendered it.
        depth_m, transmission, particle_mask: ``(1, H, W)``.

    Returns:
        Those of ``torchweather.explain`` and, as the camera sees it on its axis in green, ``optical_depth_28_m``,
        ``transmission_28_m`` and so on; measured ``transmission_mean`` and ``mask_mean``; with rain or snow what
        ``falling_numbers`` gives.

    Example:
        >>> from torchweather import BayerFog, Camera, Fog
        >>> fog = BayerFog(Fog(mor_m=50), Camera.from_intrinsics(9.0, 9.0, 3.5, 3.5, 8, 8), depth=50.0, airlight=0.7)
        >>> frame, depth = torch.full((1, 8, 8), 0.2), torch.full((1, 8, 8), 50.0)
        >>> result = fog.run(frame, depth)
        >>> numbers = weather_numbers(fog, depth, result.transmission, result.particle_mask)
        >>> round(numbers["transmission_28_m"], 2)
        0.19
    """
    said = explain(transform.weather, transform.camera)
    path = light_path(transform)
    numbers: dict[str, Any] = {f"extinction_{band['name']}_per_m": band["extinction_per_m"] for band in said["bands"]}
    numbers["mor_m"] = said["mor_m"]
    numbers["particles_per_m3"] = said["particles_per_m3"]
    numbers["liquid_water_g_per_m3"] = said["liquid_water_g_per_m3"]
    for distance in TARGET_DISTANCES_M:
        optical = path.optical_depth(distance)
        numbers[f"optical_depth_{distance:g}_m"] = optical
        numbers[f"transmission_{distance:g}_m"] = math.exp(-optical)
    numbers["transmission_mean"] = float((transmission.double() * (1 - particle_mask.double())).mean())
    if populations(transform):
        numbers.update(falling_numbers(transform, depth_m))
        numbers["mask_mean"] = float(particle_mask.double().mean())
    return numbers


def ray_length_m(depth_m: Tensor, camera: Camera) -> Array:
    """Distance along each pixel's ray, metres, ``(H * W,)``; infinity is sky."""
    height, width = depth_m.shape[-2:]
    per_depth = camera.ray_directions(height, width, dtype=torch.float64).square().sum(0).sqrt()
    return np.asarray((depth_m[0].double() * per_depth).flatten().numpy())


def mean_over_bins(distance_m: Array, values: Mapping[str, Array], edges_m: Array) -> dict[str, Array]:
    """Means of pixel values over bins of distance; bins of few pixels are left out.

    Args:
        distance_m: ``(P,)``.
        values: arrays ``(P,)``.
        edges_m: rising.

    Returns:
        ``distance_m`` and the means, an entry for each bin that is left.

    Example:
        >>> distance, y = np.array([1.0, 2.0, 9.0]), np.array([4.0, 6.0, 7.0])
        >>> found = mean_over_bins(distance, {"y": y}, np.array([0.0, 5.0, 10.0]))
        >>> [float(v) for v in found["y"]]
        [5.0, 7.0]
    """
    inside = (distance_m >= edges_m[0]) & (distance_m < edges_m[-1])
    bins = np.digitize(distance_m[inside], edges_m) - 1
    count = np.bincount(bins, minlength=len(edges_m) - 1)
    keep = count > max(0, 1e-4 * len(distance_m))
    found = {}
    for name, array in {"distance_m": distance_m, **values}.items():
        total = np.bincount(bins, weights=array[inside], minlength=len(edges_m) - 1)
        found[name] = total[keep] / count[keep]
    return found
