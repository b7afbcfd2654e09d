"""Agreement of simulation and measurement on scores that get worse with the weather."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.evaluation.validation.comparison import Comparison
from torchweather.evaluation.validation.link_scores import LinkClass
from torchweather.gap.study.splits import severity
from torchweather.metrics.trends import SceneTrends, Trend, expected_trends

__all__ = ["TrendComparison", "class_trends", "compared_trends", "knob_value", "weather_label"]

# A verdict that so few of the bootstrap samples share, or all but so few, is not a coin flip.
SURE = 0.95
UNITS = {"rate_mm_per_h": "mm/h", "mor_m": "m"}


@dataclass(frozen=True)
class TrendComparison:
    """Trends of the scores over one weather of one scene, in order of rising severity.

    Args:
        scene, weather: of the levels.
        knob: what rises or falls, with its unit in the name.
        values: of the knob.
        measured, simulated: how each score goes.
    """

    scene: str
    weather: str
    knob: str
    values: tuple[float, ...]
    measured: SceneTrends
    simulated: SceneTrends

    def agreement(self, name: str) -> bool | None:
        """Check whether a score gets worse at every step in both, or in neither; None where that is too close to call.

        Too close: one does and the other does not, but frames drawn anew would turn one of them in more than 5 % of
        the draws.
        """
        both = [trends.metrics[name] for trends in (self.measured, self.simulated)]
        if any(trend.verdict == "unjudged" for trend in both):
            return None
        if (both[0].verdict == "expected") == (both[1].verdict == "expected"):
            return True
        return False if all(_sure(trend) for trend in both) else None

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "scene": self.scene,
            "weather": self.weather,
            "knob": self.knob,
            "values": list(self.values),
            "measured_expected": self.measured.expected,
            "simulated_expected": self.simulated.expected,
            "out_of": self.measured.out_of,
            "scores": {
                name: {
                    "measured": asdict(self.measured.metrics[name]),
                    "simulated": asdict(self.simulated.metrics[name]),
                    "agree": self.agreement(name),
                }
                for name in self.measured.metrics
            },
        }


def _sure(trend: Trend) -> bool:
    if trend.confidence is None:
        return False
    share = trend.confidence if trend.verdict == "expected" else 1.0 - trend.confidence
    return share >= SURE


def knob_value(weather: Weather) -> float:
    """The knob of a single weather as a number."""
    knob = weather.intensity
    return float(knob.mean()) if isinstance(knob, Tensor) else float(knob)


def weather_label(weather: Weather | None) -> str:
    """A weather in words.

    Example:
        >>> from torchweather.atmosphere.weather import Fog, Mixture, Rain
        >>> weather_label(Mixture(Rain(25.0), Fog(mor_m=100.0))), weather_label(None)
        ('fog 100 m + rain 25 mm/h', 'clear')
    """
    if weather is None:
        return "clear"
    words = [f"{part.kind} {knob_value(part):g} {UNITS[part.intensity_name]}" for part in weather.parts]
    return " + ".join([*words, *(one.kind for one in weather.conditions)])


def compared_trends(
    conditions: Sequence[tuple[str, Weather | None, Sequence[Comparison]]], seed: int
) -> list[TrendComparison]:
    """Trends over the conditions of each scene that have one kind of weather in two strengths or more.

    Args:
        conditions: scene, weather and scores.
        seed: of the bootstrap.
    """
    groups: dict[tuple[str, str, str], list[tuple[Weather, Sequence[Comparison]]]] = {}
    for scene, weather, scores in conditions:
        if weather is not None:
            groups.setdefault((scene, weather.kind, weather.intensity_name), []).append((weather, scores))
    found = []
    for (scene, kind, knob), members in groups.items():
        members.sort(key=lambda member: severity(member[0]))
        levels = [(knob_value(weather), scores) for weather, scores in members]
        found += _trends(scene, kind, knob, levels, seed)
    return found


def class_trends(series: str, classes: Sequence[LinkClass], seed: int) -> list[TrendComparison]:
    """The trend of the mean attenuation of links over the classes of rain, where there are two or more.

    Args:
        series: name of the condition.
        classes: from light to heavy rain.
        seed: of the bootstrap.
    """
    levels = [(each.low_mm_per_h, [replace(each.score, name="attenuation_db")]) for each in classes]
    return _trends(series, "rain", "rate_mm_per_h", levels, seed)


def _trends(
    scene: str, kind: str, knob: str, levels: Sequence[tuple[float, Sequence[Comparison]]], seed: int
) -> list[TrendComparison]:
    """Levels in order of rising severity; those of one value count as one. Empty where only one is left."""
    values = list(dict.fromkeys(value for value, _ in levels))
    if len(values) < 2:
        return []
    first = levels[0][1]
    direction = {score.name: "up" if score.meaning.higher_is_better else "down" for score in first}
    trends = []
    for which in ("measured", "simulated"):
        scores: dict[str, list[list[float]]] = {name: [] for name in direction}
        for value in values:
            for place, name in enumerate(direction):
                frames = [getattr(own[place], which).scores for each, own in levels if each == value]
                scores[name].append([score for sample in frames for score in sample])
        trends.append(expected_trends({scene: scores}, direction, seed=seed)[scene])
    return [TrendComparison(scene, kind, knob, tuple(values), *trends)]
