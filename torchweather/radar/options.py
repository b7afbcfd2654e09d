"""Options of the transforms of a radar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torchweather.pipeline.options import TransformOptions

__all__ = ["RadarOptions"]


@dataclass(frozen=True, kw_only=True, eq=False)
class RadarOptions(TransformOptions):
    """Keyword arguments of `RadarAttenuation`, which describes them; dB, metres a second."""

    rain_model: str | None = None
    fog_model: str | None = None
    snow_model: str | None = None
    radome_loss_db: float = 0.0
    radome_film_db: float = 0.0
    radome_film_exponent: float = 1.0 / 3.0
    clutter: bool = False
    clutter_points: int = 64
    ego_speed_m_per_s: float = 0.0
    lost: str = "zero"
    variant: str | None = None

    fixed: ClassVar[tuple[str, ...]] = ("p", "lost", "clutter", "clutter_points")
