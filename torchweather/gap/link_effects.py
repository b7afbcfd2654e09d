"""What the radar's effects do to a microwave link: a link's two covers are what one cover is to a radar, both ways.

References:
    GAP.md 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.link_samples import LinkSamples
from torchweather.stages.effects import Effect

__all__ = ["LINK_EFFECTS", "attenuation_db"]

Floats = NDArray[np.float64]


def _values(effect: Effect) -> dict[str, float]:
    return {parameter.name: float(getattr(effect, parameter.name)) for parameter in effect.arguments}


def _wet_radome(effect: Effect, samples: LinkSamples, path_db: Floats) -> Floats:
    """The covers at both ends: a loss while they are wet, and a film that grows with the rain; both dry."""
    given = _values(effect)
    drying = given["drying_min"]
    wet = np.exp(-samples.since_min / drying) if drying > 0 else (samples.since_min == 0).astype(np.float64)
    film: Floats = given["film_db"] * samples.wet_mm_per_h ** given["film_exponent"]
    return wet * (given["loss_db"] + film)


def _path_loss_scale(effect: Effect, samples: LinkSamples, path_db: Floats) -> Floats:
    return (_values(effect)["factor"] - 1.0) * path_db


LINK_EFFECTS: Mapping[str, Callable[[Effect, LinkSamples, Floats], Floats]] = {
    "radar.wet_radome": _wet_radome,
    "radar.path_loss_scale": _path_loss_scale,
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
            raise ValueError(f"attenuation_db: {effect.id} does nothing to a link; wanted {', '.join(LINK_EFFECTS)}.")
        total = total + LINK_EFFECTS[effect.id](effect, samples, path_db)
    return total
