"""Severities of one weather from one line of text, in order of worsening."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from torchweather.atmosphere.named_weather import ALIASES
from torchweather.atmosphere.weather import WEATHERS, Weather, parse_weather
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError

__all__ = ["Level", "parse_levels"]

OWNER = "parse_levels"
EXAMPLE = "such as rain:rate=1,5,10,25,50"
# Worse is more of the one and less of the other.
RISES = {"rate_mm_per_h": True, "mor_m": False}
UNITS = {"rate_mm_per_h": "mm/h", "mor_m": "m"}


@dataclass(frozen=True)
class Level:
    """One severity of a weather.

    Args:
        name: of the weather in all its severities: its kind, with what else was given, such as ``rain`` or
            ``rain+fog:mor=200``.
        kind: of the part that varies: ``rain``, ``fog`` or ``snow``.
        knob: ``rate_mm_per_h`` or ``mor_m``.
        value: of the knob.
        severity: 1 is the lightest.
        weather: the whole.
    """

    name: str
    kind: str
    knob: str
    value: float
    severity: int
    weather: Weather

    @property
    def unit(self) -> str:
        """Of the value."""
        return UNITS[self.knob]

    @property
    def text(self) -> str:
        """The level in words, such as ``Rain 25 mm/h``."""
        return f"{self.kind.capitalize()} {self.value:g} {self.unit}"


def parse_levels(text: str) -> list[Level]:
    """The severities of a weather, lightest first.

    Args:
        text: as ``parse_weather`` takes it, with two or more values of one part's knob: ``rain:rate=1,5,10``,
            ``fog:mor=400,100,30``, ``snow:rate=0.5,1,size_distribution=gunn-marshall``, ``rain:rate=5,25+fog:mor=200``.

    Returns:
        One level a value: rates rise, visibilities fall.

    Raises:
        ValueError: no list, more than one, a list of something else than a knob, a value that is no weather or stands
            there twice.

    Example:
        >>> [(level.severity, level.value) for level in parse_levels("fog:mor=30,400,100")]
        [(1, 400.0), (2, 100.0), (3, 30.0)]
    """
    check_arguments("parse_levels(text: str)", text)
    parts = [_Part(part) for part in text.split("+")]
    lists = [(part, key) for part in parts for key, values in part.arguments.items() if len(values) > 1]
    if not lists:
        raise InputValueError(
            f"{OWNER}: expected two or more values of a rate or a visibility, {EXAMPLE}; got {text!r}."
        )
    if len(lists) > 1:
        raise InputValueError(
            f"{OWNER}: expected one list of values, of one part of the weather; got {len(lists)} in {text!r}. Sweep "
            "one after the other."
        )
    part, key = lists[0]
    knob = ALIASES.get(key, key)
    if part.kind not in WEATHERS or knob != WEATHERS[part.kind].intensity_name:
        wanted = (
            f"{WEATHERS[part.kind].intensity_name} of {part.kind}" if part.kind in WEATHERS else "a rate or visibility"
        )
        raise InputValueError(f"{OWNER}: a list must be of {wanted}, {EXAMPLE}; got one of {key!r} in {text!r}.")
    values = sorted((_number(value, text) for value in part.arguments[key]), reverse=not RISES[knob])
    twice = next((low for low, high in pairwise(values) if low == high), None)
    if twice is not None:
        raise InputValueError(f"{OWNER}: expected levels that differ; got {twice:g} twice in {text!r}.")
    if not 0.0 < min(values) <= max(values) < float("inf"):
        raise InputValueError(
            f"{OWNER}: a level must be above 0 and finite; got {text!r}. Clear air is the reference and needs no level."
        )
    name = "+".join(other.without(key) if other is part else other.text for other in parts)
    return [
        Level(name, part.kind, knob, value, severity, _weather(parts, part, key, value))
        for severity, value in enumerate(values, 1)
    ]


class _Part:
    """One weather of a text: its kind, and the values of each argument."""

    def __init__(self, text: str) -> None:
        self.text = text.strip()
        self.kind, _, arguments = self.text.partition(":")
        self.arguments: dict[str, list[str]] = {}
        last = ""
        for piece in filter(None, (piece.strip() for piece in arguments.split(","))):
            key, equals, value = piece.partition("=")
            if equals:
                last = key.strip()
                if last in self.arguments:
                    raise InputValueError(f"{OWNER}: expected {last!r} once; got it twice in {self.text!r}.")
                self.arguments[last] = [value.strip()]
            elif last:
                self.arguments[last].append(piece)  # a value more of the argument before it
            else:
                raise InputValueError(f"{OWNER}: expected key=value, {EXAMPLE}; got {piece!r} in {self.text!r}.")

    def without(self, key: str, extra: Iterable[str] = ()) -> str:
        """The text without an argument, with others."""
        kept = [f"{name}={value}" for name, (value, *_) in self.arguments.items() if name != key]
        found = ",".join([*extra, *kept])
        return f"{self.kind}:{found}" if found else self.kind


def _weather(parts: list[_Part], varied: _Part, key: str, value: float) -> Weather:
    return parse_weather(
        "+".join(part.without(key, [f"{key}={value!r}"]) if part is varied else part.text for part in parts)
    )


def _number(value: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputValueError(f"{OWNER}: expected numbers in the list, {EXAMPLE}; got {value!r} in {text!r}.") from None
