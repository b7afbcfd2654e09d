"""Radar: a millimetre-wave radar, as far as the attenuation of weather needs to know it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from torchweather.errors import check_between, check_one_of
from torchweather.sensors.base import Sensor

__all__ = ["Radar"]


@dataclass(frozen=True)
class Radar(Sensor):
    """A millimetre-wave radar: what the attenuation of weather needs to know of it.

    Args:
        frequency_ghz: carrier frequency.
        polarisation: ``h`` or ``v``.
        elevation_rad: elevation of the path.
    """

    kind: ClassVar[str] = "radar"

    frequency_ghz: float = 77.0
    polarisation: str = "h"
    elevation_rad: float = 0.0

    def __post_init__(self) -> None:
        check_between("frequency_ghz", self.frequency_ghz, 1.0, 1000.0, unit="GHz", owner=self)
        check_one_of("polarisation", self.polarisation, ("h", "v"), owner=self)
        check_between("elevation_rad", self.elevation_rad, -math.pi / 2, math.pi / 2, unit="rad", owner=self)
