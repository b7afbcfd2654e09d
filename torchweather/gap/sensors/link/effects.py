"""Effects of a radar on a microwave link: a link's two covers are what one cover is to a radar, both ways.

References:
    GAP.md 2; ``physics/wet_cover.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.core.errors import InputValueError
from torchweather.gap.sensors.link.samples import LinkSamples
from torchweather.physics import wet_cover_loss_db
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects import all as effects_radar

__all__ = ["LINK_EFFECTS", "attenuation_db"]

Floats = NDArray[np.float64]


def _values(effect: Effect) -> dict[str, float]:
    return {parameter.name: float(getattr(effect, parameter.name)) for parameter in effect.arguments}


def _wet_radome(effect: Effect, samples: LinkSamples, path_db: Floats) -> Floats:
    """The covers at both ends, over dry ones: what stays in dry air as well is in the baseline of a link.

    The film is that of the last rain, and the constant dries as the film does.
    """
    given = _values(effect)
    rain, age = (torch.from_numpy(values)[:, None] for values in (samples.wet_mm_per_h, samples.since_min))
    exponent, drying = given["film_exponent"], given["drying_min"]
    film = wet_cover_loss_db(rain, age, 0.0, given["film_db"], exponent, drying).numpy()
    found: Floats = film + given["loss_db"] * np.exp(-samples.since_min / drying)
    return found


def _path_loss_scale(effect: Effect, samples: LinkSamples, path_db: Floats) -> Floats:
    return (_values(effect)["factor"] - 1.0) * path_db


LINK_EFFECTS: Mapping[str, Callable[[Effect, LinkSamples, Floats], Floats]] = {
    effects_radar.RadarWetRadome.id: _wet_radome,
    effects_radar.RadarPathLossScale.id: _path_loss_scale,
}
"""Id to the attenuation that an effect adds, dB ``(S,)``."""


def attenuation_db(samples: LinkSamples, effects: Sequence[Effect], log_rain: float = 0.0) -> Floats:
    """Attenuation of links with effects, dB ``(S,)``.

    Args:
        samples: of the links.
        effects: of ``LINK_EFFECTS``.
        log_rain: logarithm of the rain over that of the record.
    """
    path_db = samples.path_db * np.exp(samples.exponent * log_rain)
    total = path_db
    for effect in effects:
        if effect.id not in LINK_EFFECTS:
            raise InputValueError(
                f"attenuation_db: {effect.id} does nothing to a link; expected {', '.join(LINK_EFFECTS)}."
            )
        total = total + LINK_EFFECTS[effect.id](effect, samples, path_db)
    return total
