"""A recipe of kind suite: weathers and effects of several severities, that a detector of one sensor is tested in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

from torchweather.atmosphere.weather import CLEAR_AIR, WEATHERS, Weather, weather_from_dict, weather_kind, weather_names
from torchweather.core.errors import TorchweatherError
from torchweather.core.schema import MAPPING, ROWS, TEXT, check_keys, check_value, one_of, refuse_unknown
from torchweather.pipeline.effect import effect_from_dict
from torchweather.recipes.files import name_of
from torchweather.recipes.options import OPTIONS, current_names
from torchweather.recipes.transform import refuse_overrides, sensor_keys
from torchweather.sensors import SENSOR_CLASSES

__all__ = ["SEVERITIES", "Condition", "SuiteRecipe", "checked_suite"]

SEVERITIES = 5
MIXTURE = "mixture"
# Worse is less of the visibility, and more of a rate or an amount.
FALLS = ("mor_m",)
UNITS = {"rate_mm_per_h": "mm/h", "mor_m": "m", "water_mm": "mm", "depth_mm": "mm"}


@dataclass(frozen=True)
class Condition:
    """One weather or effect in one severity.

    Args:
        name: of the weather or effect in the suite.
        kind: of what gets heavier: ``rain``, ``fog`` or ``snow``, in a mixture of the first part that does; of an
            effect its id.
        knob: ``rate_mm_per_h``, ``mor_m``, or the amount or parameter that varies.
        value: of it.
        severity: 1 is the lightest.
        weather: the whole; clear air of an effect.
        effects: plain values of the effects beside the weather.
    """

    name: str
    kind: str
    knob: str
    value: float
    severity: int
    weather: Weather
    effects: tuple[Mapping[str, Any], ...] = ()

    @property
    def unit(self) -> str:
        """Of the value; empty of a share or a factor."""
        if not self.effects:
            return UNITS.get(self.knob, "")
        (varied,) = [one for one in effect_from_dict(self.effects[0]).arguments if one.name == self.knob]
        return "" if varied.unit == "1" else varied.unit

    @property
    def text(self) -> str:
        """The condition in words, such as ``Rain 25 mm/h``."""
        named = self.name.capitalize() if self.effects else self.kind.capitalize()
        return f"{named} {self.value:g} {self.unit}".rstrip()


@dataclass(frozen=True)
class SuiteRecipe:
    """Weathers and effects of five severities, or of another number, as their file states them.

    Args:
        name: path below the recipes' folder without its ending, such as ``camera/robustness``; for a file of one's
            own, its name.
        title: what it tests.
        sensor: ``kind``, and ``preset`` or fields where it belongs to one sensor.
        weathers: by name, plain values with a list of the severities in the place of a number.
        options: keyword arguments of the sensor's transform.
        path: the file.
        effects: by name, plain values of an effect with a list of the severities in the place of one parameter.
        severities: how many.
    """

    kind: ClassVar[str] = "suite"
    name: str
    title: str
    sensor: Mapping[str, Any]
    weathers: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    severities: int = SEVERITIES

    @property
    def sensor_kind(self) -> str:
        """``camera``, ``lidar`` or ``radar``."""
        return str(self.sensor["kind"])

    def build(self, **overrides: Any) -> SuiteRecipe:
        """The suite itself; it has no overrides."""
        refuse_overrides(overrides, (), "load_recipe")
        return self

    def conditions(self) -> list[Condition]:
        """Every weather and effect in every severity, those of one together, lightest first.

        Example:
            >>> from torchweather.recipes import load_recipe
            >>> [(c.name, c.severity, c.value) for c in load_recipe("camera/robustness").conditions()][:2]
            [('rain', 1, 2.5), ('rain', 2, 10.0)]
        """
        severities = range(1, self.severities + 1)
        weathers = [_condition(name, fields, one) for name, fields in self.weathers.items() for one in severities]
        effects = [_of_effect(name, fields, one) for name, fields in self.effects.items() for one in severities]
        return [*weathers, *effects]


def checked_suite(values: Mapping[str, Any], path: Path) -> SuiteRecipe:
    """The suite of a file's values, whose keys are of the schema.

    Raises:
        TorchweatherError: with the file and the key.
    """
    file, sensor = str(path), dict(values["sensor"])
    options = current_names(values.get("options") or {}, f"{file}: options")
    check_value(sensor.get("kind"), one_of(SENSOR_CLASSES), file, "sensor.kind")
    check_keys(sensor, sensor_keys(sensor["kind"]), file, "sensor")
    refuse_unknown(options, OPTIONS[sensor["kind"]], "options", file)
    number = int(values.get("severities", SEVERITIES))
    weathers = {name: _weather(name, fields, file, number) for name, fields in (values.get("weathers") or {}).items()}
    effects = {
        name: _effect(name, fields, file, number, sensor["kind"])
        for name, fields in (values.get("effects") or {}).items()
    }
    if not (weathers or effects):
        raise TorchweatherError(f"{file}: weathers or effects is missing; expected keys with values.")
    if twice := sorted(set(weathers) & set(effects)):
        raise TorchweatherError(f"{file}: effects.{twice[0]}: expected a name that no weather has.")
    suite = SuiteRecipe(name_of(path), str(values["title"]), sensor, weathers, options, path, effects, number)
    try:
        if len(sensor) > 1:
            SENSOR_CLASSES[suite.sensor_kind].from_values(sensor)
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: sensor: {error}") from error
    for name, fields in weathers.items():
        try:
            conditions = [_condition(name, fields, severity) for severity in range(1, number + 1)]
        except (TypeError, ValueError, KeyError) as error:
            raise TorchweatherError(f"{path}: weathers.{name}: {error}") from error
        for before, after in pairwise(conditions):
            if not (after.value < before.value if after.knob in FALLS else after.value > before.value):
                raise TorchweatherError(
                    f"{path}: weathers.{name}: severities must get heavier, lightest first (rates rise, visibilities "
                    f"fall); got {before.value:g} before {after.value:g}."
                )
    return suite


def _effect(name: str, fields: Any, file: str, number: int, sensor: str) -> dict[str, Any]:
    """The fields of an effect, one of which is a list of the severities."""
    at = f"{file}: effects.{name}"
    check_value(fields, MAPPING, file, f"effects.{name}")
    check_value(fields.get("effect"), TEXT, file, f"effects.{name}.effect")
    lists = [key for key, value in fields.items() if isinstance(value, list)]
    if len(lists) != 1 or len(fields[lists[0]]) != number:
        raise TorchweatherError(f"{at}: expected one parameter with a list of {number} values; got {dict(fields)!r}.")
    if str(fields["effect"]).partition(".")[0] != sensor:
        raise TorchweatherError(f"{at}.effect: expected an effect of a {sensor}; got {fields['effect']!r}.")
    for severity in range(1, number + 1):
        try:
            effect_from_dict(_of_effect(name, fields, severity).effects[0])
        except (TypeError, ValueError) as error:
            raise TorchweatherError(f"{at}: {error}") from error
    return dict(fields)


def _of_effect(name: str, fields: Mapping[str, Any], severity: int) -> Condition:
    (varied,) = [key for key, value in fields.items() if isinstance(value, list)]
    value = fields[varied][severity - 1]
    effects = ({**fields, varied: value},)
    return Condition(name, fields["effect"], varied, float(value), severity, CLEAR_AIR, effects)


def _weather(name: str, fields: Any, file: str, number: int) -> dict[str, Any]:
    """The fields of a weather, its kind among them."""
    at = f"weathers.{name}"
    check_value(fields, MAPPING, file, at)
    found = dict(fields)
    found.setdefault("kind", MIXTURE if "parts" in found else name)
    parts = found.get("parts", [found])
    check_value(parts, ROWS, file, f"{at}.parts")
    for part in parts:
        check_value(part.get("kind"), one_of(weather_names()), file, f"{at}.kind")
        if part["kind"] in WEATHERS and _intensity(part) not in part:
            raise TorchweatherError(f"{file}: {at}.{_intensity(part)} is missing; expected a number or {number}.")
    varied = [part[_intensity(part)] for part in parts if isinstance(part.get(_intensity(part)), list)]
    if not varied or any(len(values) != number for values in varied):
        intensities = ", ".join(dict.fromkeys(_intensity(part) for part in parts))
        raise TorchweatherError(
            f"{file}: {at}: expected {number} severities, a list of {number} values of {intensities}; got "
            f"{[len(values) for values in varied] or 'no list'}."
        )
    return found


def _intensity(fields: Mapping[str, Any]) -> str:
    return str(weather_kind(fields["kind"]).intensity_name)


def _condition(name: str, fields: Mapping[str, Any], severity: int) -> Condition:
    parts = fields.get("parts", [fields])
    varied = next(part for part in parts if isinstance(part.get(_intensity(part)), list))
    weather = weather_from_dict(_at(fields, severity))
    return Condition(
        name, varied["kind"], _intensity(varied), float(varied[_intensity(varied)][severity - 1]), severity, weather
    )


def _at(fields: Mapping[str, Any], severity: int) -> dict[str, Any]:
    """The fields in one severity."""
    if "parts" in fields:
        return {**fields, "parts": [_at(part, severity) for part in fields["parts"]]}
    intensity = fields.get(_intensity(fields))
    return {**fields, _intensity(fields): intensity[severity - 1]} if isinstance(intensity, list) else dict(fields)
