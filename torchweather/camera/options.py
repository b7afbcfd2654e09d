"""Options of the transforms of a camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from torchweather.camera.exposure import ExposureControl
from torchweather.camera.night.lamps import Night
from torchweather.pipeline.options import TransformOptions

__all__ = ["RENAMED", "CameraOptions"]

RENAMED = {"cut": "min_listed_coverage", "crowding": "max_listed_density", "drop_view": "drop_radiance"}
"""Old name of an option to its name now."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraOptions(TransformOptions):
    """Keyword arguments of `BayerWeather`, which describes them; metres, metres a second, mm/h."""

    depth: object = None
    airlight: Sequence[float] | float | str | Mapping[str, float] | None = None
    layer_top_m: float = 200.0
    sky: str | None = None
    night: Night | Mapping[str, Any] | bool | None = None
    exposure_control: str | ExposureControl | Mapping[str, Any] | None = None
    extinction: str = "mie"
    scattering: str = "single"
    near_m: float = 0.5
    far_m: float = 200.0
    min_listed_coverage: float = 1 / 1024
    max_listed_density: float = 0.25
    ego_speed_m_per_s: float = 0.0
    drop_radiance: str = "frame"
    rate_capacity_mm_per_h: float | None = None
    variant: str | None = None
    quality: Any = "exact"

    fixed: ClassVar[tuple[str, ...]] = (
        *("p", "near_m", "far_m"),
        *("min_listed_coverage", "max_listed_density", "rate_capacity_mm_per_h", "quality"),
    )
