"""Options of weather on radar power maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from torchweather.pipeline.options import TransformOptions
from torchweather.radar.power_map.power_map import MapAxes
from torchweather.radar.power_map.scale import PowerScale

__all__ = ["RadarMapOptions"]


@dataclass(frozen=True, kw_only=True, eq=False)
class RadarMapOptions(TransformOptions):
    """Keyword arguments of `RadarMapWeather`, which describes them; dB, metres a second."""

    axes: MapAxes
    scale: PowerScale
    noise_floor_db: float | Sequence[float] | None = None
    looks: int = 1
    oversampling: float | None = None
    rain_model: str = "p838"
    fog_model: str = "p840"
    snow_model: str = "dsd_mie"
    radome_loss_db: float = 0.0
    radome_film_db: float = 0.0
    radome_film_exponent: float = 1.0 / 3.0
    clutter: bool = True
    clutter_share: float = 1.0
    ego_speed_m_per_s: float = 0.0

    fixed: ClassVar[tuple[str, ...]] = ("p", "axes", "scale", "looks", "oversampling")
