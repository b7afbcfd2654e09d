"""Size, colours and words that all pictures of effects share, and the file that each becomes."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.io import atomic_write
from torchweather.stages import EFFECTS

__all__ = ["MAP_TITLE", "SIZE_INCH", "STRONG", "WEAK", "WITHOUT", "save", "setting_text", "weather_text"]

SIZE_INCH, DPI = (6.0, 2.6), 120
WITHOUT, WEAK, STRONG = "#b3bcc5", "#4dabf7", "#0b4f8a"
MAP_TITLE: dict[str, Any] = {"fontsize": 8, "fontweight": "normal"}  # the setting that a map shows


def weather_text(weather: Weather) -> str:
    """Weather in words: ``rain, 25 mm/h``."""
    if isinstance(weather, tw.Fog):
        return f"fog, visibility {float(weather.mor_m):g} m"
    return f"{weather.kind}, {float(weather.intensity):g} mm/h" if weather.intensity else "clear air"


def setting_text(name: str, setting: Mapping[str, Any], between: str = ", ") -> str:
    """Parameters of an effect with their units."""
    units = {parameter.name: parameter.unit.replace("1", "") for parameter in EFFECTS[name].arguments}
    return between.join(f"{key} = {_value_text(value)} {units[key]}".strip() for key, value in setting.items())


def _value_text(value: Any) -> str:
    found = ", ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"
    return found.replace("-", "−")


def save(figure: Figure, path: Path, colours: int) -> None:
    """Write a PNG of few colours, whole or not at all."""
    memory = io.BytesIO()
    figure.savefig(memory, dpi=DPI)
    image = Image.open(memory).convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    with atomic_write(path) as unfinished:
        image.save(unfinished, format="PNG", optimize=True)
