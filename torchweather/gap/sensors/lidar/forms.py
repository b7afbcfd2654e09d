"""Effects of LiDAR in the form in which they are searched for: structure of snow, with fewer parameters that say where.

Each parameter more must be worth its place in the misfit (``effect_forms.A_PARAMETER``), as one more can explain noise.

References:
    ``effect_forms.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.effect_forms import SearchForm, counted_form
from torchweather.lidar.effects.receiver import LidarBlindZone
from torchweather.lidar.effects.structure import (
    LidarParticleDensityAzimuth,
    LidarParticleDensityElevation,
    LidarParticleSizes,
    LidarSharedParticles,
)
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["LIDAR_FORMS", "BlindForm", "ElevationForm", "SharedForm", "WakeForm"]

WAKE = LidarParticleDensityAzimuth.arguments[:3]


class WakeForm(SearchForm, LidarParticleDensityAzimuth):
    """The lobe alone: a wide one stands for wind, as four frames do not tell a lobe from a lobe and a harmonic.

    Example:
        >>> form = WakeForm(amplitude=2.0, azimuth_rad=3.0, width_rad=0.5).to_dict()
        >>> form["wind_amplitude"], form["amplitude"]
        (0.0, 2.0)
    """

    arguments: ClassVar[tuple[Parameter, ...]] = WAKE
    complexity_penalty: ClassVar[float] = METHOD.parameter_penalty * (len(WAKE) - 1)
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {"width_rad": (0.5, 2.5)}
    wind_amplitude: Tensor
    wind_azimuth_rad: Tensor

    def __init__(self, **values: float | Sequence[float] | Tensor) -> None:
        super().__init__(**values)
        for one in LidarParticleDensityAzimuth.arguments[3:]:
            self.register_buffer(one.name, torch.tensor(one.value))

    def to_dict(self) -> dict[str, Any]:
        """As the catalogue's effect."""
        wind = {one.name: one.value for one in LidarParticleDensityAzimuth.arguments[3:]}
        return {**super().to_dict(), **wind}


class ElevationForm(SearchForm, LidarParticleDensityElevation):
    """As the catalogue's, begun at three elevations and two widths."""

    complexity_penalty: ClassVar[float] = METHOD.parameter_penalty * (len(LidarParticleDensityElevation.arguments) - 1)
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {
        "elevation_rad": (-0.15, 0.0, 0.15),
        "width_rad": (0.1, 0.4),
        "steepness": (1.0,),
    }


class SharedForm(SearchForm, LidarSharedParticles):
    """As the catalogue's, begun at the sensor's own width."""

    complexity_penalty: ClassVar[float] = METHOD.parameter_penalty
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {"width_factor": (1.0,)}


class BlindForm(SearchForm, LidarBlindZone):
    """As the catalogue's, begun with a loss at which the nearest flakes are still seen."""

    complexity_penalty: ClassVar[float] = METHOD.parameter_penalty
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {"loss_db": (30.0,)}


LIDAR_FORMS: Mapping[str, type[Effect]] = {
    BlindForm.id: BlindForm,
    WakeForm.id: WakeForm,
    ElevationForm.id: ElevationForm,
    LidarParticleSizes.id: counted_form(LidarParticleSizes),
    SharedForm.id: SharedForm,
}
"""Id to the class that a search of LiDAR frames moves; what is not here is searched for as it is."""
