"""Training quality in `Compose`: banks rendered before workers start, and one transform for all rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchweather.atmosphere.weather import Weather
from torchweather.camera.particles.bank import DrawBank
from torchweather.camera.particles.bank_veil import BankVeil
from torchweather.camera.rgb import AsBayer

__all__ = ["prepared_banks", "weather_at_any_rate", "with_any_airlight"]

BY_RATE = ("rain", "snow")
ANY_AIRLIGHT = 0.5


def prepared_banks(transform: Any, weather: Weather) -> list[DrawBank]:
    """Banks of a transform of training quality, with the storms of all rates that a weather may have.

    Args:
        transform: of any sensor and quality; of exact quality it has none.
        weather: whose rates may be distributions.
    """
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    found = []
    for stage in inner.chain.stages.values():
        if isinstance(stage, BankVeil):
            stage.prepare(weather)
            found += stage.banks
    return found


def weather_at_any_rate(weather: Mapping[str, Any]) -> dict[str, Any] | None:
    """The values of rain or snow at a rate of 1 mm/h: its transform serves all rates; ``None`` of another weather."""
    if weather.get("kind") not in BY_RATE:
        return None
    return {**weather, "rate_mm_per_h": 1.0}


def with_any_airlight(drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Values of nuisances with one airlight in place of a drawn one: its transform serves all airlights."""
    return {name: ANY_AIRLIGHT if name == "airlight" else value for name, value in drawn.items()}
