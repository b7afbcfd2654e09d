"""Choice of the held-out conditions where a study names none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchweather.atmosphere.weather import Weather
from torchweather.gap.study.conditions import Condition

__all__ = ["FIT", "HOLDOUT", "SPLITS", "condition_group", "resolve_splits", "severity"]

FIT, HOLDOUT = SPLITS = ("fit", "holdout")
# One of three: two thirds to fit, and an end of the range of severities is held out only where there are two.
EVERY = 3


def severity(weather: Weather) -> float:
    """Rises with the weather: the rate in mm/h, or one over the visibility in metres.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> severity(Fog(mor_m=50.0)) > severity(Fog(mor_m=200.0))
        True
    """
    intensity = float(weather.intensity)
    return 1.0 / intensity if weather.intensity_name == "mor_m" else intensity


def resolve_splits(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """The conditions with a split each: as stated, else by this rule, which depends on nothing but the conditions.

    Held out means another condition (another scene or another rate), never only other frames of one. So conditions of
    the same scene and the same weather go together, and follow the one of them that states its split. Where a
    condition is stated as held out, all others without a statement are fitted. Else the groups of each kind of weather
    are sorted by severity, then by scene, and every third of them is held out, beginning with the second. Clear air is
    fitted.

    Args:
        conditions: with ``split`` ``fit``, ``holdout``, or empty for none stated.
    """
    stated = {condition_group(one): one.split for one in reversed(conditions) if one.split}
    chosen = dict(stated)
    if HOLDOUT not in stated.values():
        groups: dict[str, set[tuple[float, str, tuple[str, str]]]] = {}
        for one in conditions:
            group = condition_group(one)
            if one.weather is not None and group not in stated:
                groups.setdefault(one.weather.kind, set()).add((severity(one.weather), one.scene, group))
        for ordered in map(sorted, groups.values()):
            chosen |= {group: HOLDOUT for _, _, group in ordered[1::EVERY]}
    return tuple(one if one.split else replace(one, split=chosen.get(condition_group(one), FIT)) for one in conditions)


def condition_group(condition: Condition) -> tuple[str, str]:
    """Key by which two conditions are the same one: scene and weather, as text."""
    weather = condition.weather
    return condition.scene, "" if weather is None else repr(sorted(weather.to_dict().items()))
