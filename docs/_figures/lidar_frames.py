"""LiDAR frames of the pictures of effects: the embedded test track, seen by an Ouster OS1-128 with few columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from effect_curves import Array

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import lidar_view, test_track

__all__ = ["Beams", "Frames", "beams_of", "frames_of"]


@dataclass(frozen=True)
class Beams:
    """What the sensor sees of the scene in clear air; ``(N,)`` each, 0 where there is no return."""

    sensor: tw.Lidar
    points: torch.Tensor
    directions: torch.Tensor
    cos_incidence: torch.Tensor
    range_m: Array
    intensity: Array
    margin_db: Array
    azimuth_deg: Array
    elevation_deg: Array

    @property
    def hit(self) -> Array:
        """Beams that see an object."""
        found: Array = self.range_m > 0
        return found

    @property
    def incidence_deg(self) -> Array:
        """Angle of incidence on the object."""
        found: Array = np.degrees(np.arccos(self.cos_incidence.numpy()))
        return found

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of the scan."""
        assert self.sensor.columns is not None
        return len(self.range_m) // self.sensor.columns, self.sensor.columns


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, N)`` each; the kind is ``PointKind``."""

    range_m: Array
    intensity: Array
    kind: Array

    @property
    def object(self) -> Array:
        """Returns of objects."""
        found: Array = self.kind == tw.PointKind.OBJECT
        return found

    @property
    def particle(self) -> Array:
        """Returns of particles."""
        found: Array = self.kind == tw.PointKind.PARTICLE
        return found


def beams_of(columns: int) -> Beams:
    """The scene seen by the sensor. Rings without offset in azimuth, so that maps have straight columns."""
    sensor = tw.Lidar.preset("ouster-os1-128", columns=columns, intensity_unit="photons", azimuth_offsets_deg=None)
    view = lidar_view(test_track(), sensor)
    range_m = torch.linalg.vector_norm(view.points[:, :3], dim=-1)
    x, y, z = view.directions.numpy().T
    return Beams(
        sensor=sensor,
        points=view.points[:, :4],
        directions=view.directions,
        cos_incidence=view.cos_incidence,
        range_m=range_m.numpy(),
        intensity=view.points[:, 3].numpy(),
        margin_db=10.0 * np.log10(np.maximum(view.points[:, 3].numpy() / sensor.photons_at_threshold, 1e-6)),
        azimuth_deg=np.degrees(np.arctan2(y, x)),
        elevation_deg=np.degrees(np.arcsin(z)),
    )


def frames_of(beams: Beams, weather: Weather, effects: Sequence[Mapping[str, Any]], count: int) -> Frames:
    """Frames in the weather, each of a clear frame with range noise of its own; the same draws for all effects."""
    transform = tw.LidarWeather(weather, beams.sensor, effects=effects)
    noise = torch.randn(count, len(beams.points), generator=torch.Generator().manual_seed(1))
    points = beams.points[None].repeat(count, 1, 1)
    points[..., :3] += (
        beams.sensor.range_noise_m * noise[..., None] * beams.directions * torch.from_numpy(beams.hit)[:, None]
    )
    # The angle of incidence comes with the scene, not with the cloud.
    state = transform.state_of(points, beams.directions).changed(cos_incidence=beams.cos_incidence[None])
    with torch.no_grad():
        found = transform.chain(state, transform.chain.draw(state, seed=torch.arange(count)))
    range_m = torch.linalg.vector_norm(found.returns.points[..., :3], dim=-1)
    return Frames(range_m.numpy(), found.returns.points[..., 3].numpy(), found.returns.kind[..., 0].numpy())
