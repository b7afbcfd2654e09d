"""Words for pages: a weather, a share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torchweather.atmosphere.weather import Weather

__all__ = ["count_text", "share_text", "weather_words"]

THIN_SPACE = "\u202f"


def weather_words(weather: Weather) -> str:
    """A weather in words.

    Example:
        >>> from torchweather.atmosphere.weather import parse_weather
        >>> weather_words(parse_weather("snow:rate=1+fog:mor=200"))
        'fog of 200 m visibility and snow of 1 mm/h'
    """

    def words() -> Iterator[str]:
        for part in weather.parts:
            values = part.to_dict()
            if "mor_m" in values:
                yield f"fog of {_number(values['mor_m'])} m visibility"
            else:
                yield f"{part.kind} of {_number(values['rate_mm_per_h'])} mm/h"
        yield from (one.kind.replace("-", " ") for one in weather.conditions)

    return " and ".join(words())


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)


def share_text(part: int, whole: int) -> str:
    """A share in percent, one decimal below 10 %; never 0 % or 100 % of what is not all.

    Example:
        >>> share_text(1, 3), share_text(1, 30), share_text(1, 9999), share_text(9999, 10000), share_text(0, 5)
        ('33 %', '3.3 %', '< 0.1 %', '> 99.9 %', '0 %')
    """
    if not whole:
        return "–"
    percent = 100 * part / whole
    if 0 < percent < 0.1:
        return "< 0.1 %"
    if 99.9 < percent < 100:
        return "> 99.9 %"
    if 99.5 <= percent < 100 or 0 < percent < 10:
        return f"{percent:.1f} %"
    return f"{percent:.0f} %"


def count_text(count: int) -> str:
    """A count in groups of three digits.

    Example:
        >>> count_text(1234567) == "1\u202f234\u202f567"
        True
    """
    return f"{count:,}".replace(",", THIN_SPACE)
