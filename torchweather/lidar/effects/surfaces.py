"""Effects of LiDAR on the surfaces that beams meet: snow on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import GROUND_VARIATE, ground_noise, uneven
from torchweather.core.random import Variate
from torchweather.lidar.intensity import reflectivity_from_intensity
from torchweather.lidar.state import LidarState
from torchweather.physics.snow_pack import snow_share
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind

__all__ = ["LidarSnowCover"]

OBJECT = int(PointKind.OBJECT)
HALF_BLIND = 0.5  # near-range response below which a signal says little of its object
BLACK = 1e-3  # least reflectivity of an object


class LidarSnowCover(Effect):
    """Snow lies on the ground and on objects: what faces up reflects as snow does, bright at 905 nm, dark at 1550 nm.

    ``X (1 - s + s rho cos i / rho_o)`` with the share s of the surface that snow covers (``physics.snow_share``), its
    reflectivity rho as a Lambertian surface at the incidence i, and rho_o of the object as its signal or, where the
    receiver is half blind in the near range, its intensity shows it. Where the normal or the incidence is not known,
    surfaces are taken to face up, and the beam.

    Args:
        depth_mm: of the snow on level ground, 0 to 1000 mm.
        reflectivity: of the snow at the laser's wavelength, 0 to 1 (``physics.snow_pack_albedo``).
        uneven: spread of the logarithm of the depth, 0 to 2.

    Note:
        Ranges stay, and a beam that had no return gets none, though snow at 905 nm is seen farther than asphalt.
    """

    id: ClassVar[str] = "lidar.snow_cover"
    title: ClassVar[str] = "snow lies on the ground and on objects"
    term: ClassVar[str] = "snow cover (reflectivity of snow)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("depth_mm", "mm", 0.0, 1000.0, scale=10.0, identity=0.0),
        Parameter("reflectivity", "1", 0.0, 1.0, scale=0.2, default=0.85),
        Parameter("uneven", "1", 0.0, 2.0, scale=0.5, default=0.5),
    )
    after: ClassVar[str] = "extinction"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("up", "incidence", "kind")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.wet_target": "intensity of level ground: snow sets it to one value, water lowers each by a share"
    }
    of_the_air: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.clear_signal", "scene.cos_incidence", "scene.points_in", "scene.up"),
        *("returns.kind", "returns.signal"),
        "receiver.sensor",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """Variates of the snow's depth."""
        return (GROUND_VARIATE,)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals of what lies under snow."""
        assert state.receiver.sensor is not None
        range_m = state.scene.clear_range_m
        x_m, y_m, _ = state.scene.points_in[..., :3].unbind(-1)
        field = ground_noise(noise["ground"].to(range_m), x_m, y_m)
        depth_mm = self.value("depth_mm", field) * uneven(field, self.value("uneven", field))
        up = torch.ones_like(field) if state.scene.up is None else state.scene.up.to(field)
        share = torch.where(range_m > 0, snow_share(depth_mm, up), 0.0)
        white = self.value("reflectivity", field)
        if state.scene.cos_incidence is not None:
            white = white * state.scene.cos_incidence.abs().to(field)
        gain = torch.lerp(torch.ones_like(share), white / self._reflectivity(state), share)
        signal = state.returns.signal
        return {"signal": torch.where(state.returns.kind == OBJECT, signal * gain[..., None], signal)}

    def _reflectivity(self, state: LidarState) -> Tensor:
        """Apparent reflectivity of what each beam meets, ``(B, N)``."""
        sensor = state.receiver.sensor
        assert sensor is not None
        range_m, clear = state.scene.clear_range_m, state.scene.clear_signal
        response = sensor.near_response(range_m)
        by_signal = clear * math.pi * range_m.square() / response.clamp_min(HALF_BLIND)
        if sensor.intensity_unit == "photons":
            return by_signal.clamp_min(BLACK)
        intensity = state.scene.points_in[..., 3]
        by_intensity = reflectivity_from_intensity(intensity, sensor.intensity_unit, sensor.assumed_reflectivity)
        return torch.where(response >= HALF_BLIND, by_signal, by_intensity).clamp_min(BLACK)
